"""Processes on one machine or many that work as one: who started them, how they find each other, what they agree on.

JAX connects them and lets their devices exchange arrays. What it does not know are some launchers, two steps of one Slurm job at a time,
and what to say where a variable is missing.
"""

import os
import re
import sys
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from motes.core import checks

ADDRESS, COUNT, NUMBER = "JAX_COORDINATOR_ADDRESS", "JAX_NUM_PROCESSES", "JAX_PROCESS_ID"
"""Variables that a user sets, and so do we for processes that we start."""
PORTS = range(61_440, 65_536)
"""Among which a port is chosen that follows from the job, so that all of its processes know it."""
APART = 977
"""Ports between two steps of one job."""


class Joined(NamedTuple):
    """A process among others.

    Attributes:
        launcher: what started them.
        coordinator: address of process 0, host:port.
        count: number of processes.
        number: of this one, from 0.
    """

    launcher: str
    coordinator: str
    count: int
    number: int


class Launcher(NamedTuple):
    """What a launcher tells its processes, by names of variables.

    Attributes:
        name: of the launcher.
        number: of this process.
        count: number of processes.
        needed: further variables.
        coordinator: gives host and port of process 0 from all variables, unless a user has set it; ValueError where they make no sense.
        start: how it is called so that nothing is missing.
    """

    name: str
    number: str
    count: str
    needed: tuple[str, ...]
    coordinator: Callable[[Mapping[str, str]], str]
    start: str

    @property
    def tells(self) -> tuple[str, ...]:
        """All its variables."""
        return (self.number, self.count, *self.needed)


def _of_torchrun(told: Mapping[str, str]) -> str:
    # its own store listens on the port that it tells
    return f"{told['MASTER_ADDR']}:{int(told['MASTER_PORT']) + ('TORCHELASTIC_RUN_ID' in told)}"


def _of_orte(told: Mapping[str, str]) -> str:
    """From such as 1531576320.0;tcp://10.96.0.1,10.148.0.1:34911 or ...;tcp6://[fe80::1,2620::2]:43370."""
    job, four, six = _matched(r"(\d+)\..*?(?:tcp://([^,:]+)|tcp6://\[([^,\]]+)).*", told["OMPI_MCA_orte_hnp_uri"])
    # numbers of jobs are multiples of 4 096
    return f"{four or f'[{six}]'}:{_port(int(job) // len(PORTS))}"


def _of_prte(told: Mapping[str, str]) -> str:
    """From such as prterun-node01-2211@1: host and process of the launcher, and the number of its job."""
    host, process, job = _matched(r"(?:prterun|prte)-(.+)-(\d+)@(\d+)", told["PMIX_NAMESPACE"])
    return f"{host}:{_port(int(process) + APART * int(job))}"


def _of_slurm(told: Mapping[str, str]) -> str:
    """From such as node[001-015,20],other2: the first of the nodes; two steps of a job get different ports."""
    prefix, number = _matched(r"([^,\[]+)(?:\[([^,\-\]]+))?.*", told["SLURM_STEP_NODELIST"])
    return f"{prefix}{number or ''}:{_port(int(told['SLURM_JOB_ID']) + APART * int(told['SLURM_STEP_ID']))}"


def _matched(pattern: str, text: str) -> tuple[Any, ...]:
    found = re.fullmatch(pattern, text)
    if found is None:
        raise ValueError(text)
    return found.groups()


def _port(number: int) -> int:
    return PORTS[number % len(PORTS)]


# within an allocation of Slurm the variables of mpirun and torchrun are the nearer ones
LAUNCHERS = (
    Launcher("a start by hand", NUMBER, COUNT, (ADDRESS,), lambda told: told[ADDRESS], f"set {ADDRESS}, {COUNT} and {NUMBER}"),
    Launcher("torchrun", "RANK", "WORLD_SIZE", ("MASTER_ADDR", "MASTER_PORT"), _of_torchrun,
             "torchrun --nnodes N --nproc-per-node 1 --rdzv-endpoint HOST:PORT --no-python motes ..."),
    Launcher("Open MPI", "OMPI_COMM_WORLD_RANK", "OMPI_COMM_WORLD_SIZE", ("OMPI_MCA_orte_hnp_uri",), _of_orte, "mpirun motes ..."),
    Launcher("Open MPI 5", "OMPI_COMM_WORLD_RANK", "OMPI_COMM_WORLD_SIZE", ("PMIX_NAMESPACE",), _of_prte, "mpirun motes ..."),
    Launcher("Slurm", "SLURM_PROCID", "SLURM_NTASKS", ("SLURM_STEP_NODELIST", "SLURM_JOB_ID", "SLURM_STEP_ID"), _of_slurm,
             "srun motes ... (within sbatch, too)"),
    Launcher("Kubernetes", "JOB_COMPLETION_INDEX", COUNT, (ADDRESS,), lambda told: told[ADDRESS],
             f"set {COUNT} to the job's completions and {ADDRESS} to JOB-0.SERVICE:PORT in the indexed job"),
)  # fmt: skip


def launched(told: Mapping[str, str]) -> Joined:
    """Return what the variables of an environment say of this process.

    Raises:
        MotesError: no launcher is known by them, or one left out what is needed; the text names it.
    """
    heard = [one for one in LAUNCHERS if any(name in told for name in one.tells)]
    if not heard:
        checks.refuse("join", "a process started by srun, mpirun or torchrun, or in an indexed job of Kubernetes, or the variables "
                      f"{ADDRESS}, {COUNT} and {NUMBER}", "none of their variables", "motes run X.toml --processes 2 starts two here.")
    one = next((one for one in heard if all(name in told for name in one.tells)), heard[0])
    missing = [name for name in one.tells if name not in told]
    if missing:
        checks.refuse("join", f"all variables of {one.name}", f"none by the name of {' and '.join(missing)}", f"Start it by: {one.start}.")
    count, number = (_natural(name, told[name]) for name in (one.count, one.number))
    try:
        coordinator = told.get(ADDRESS) or one.coordinator(told)
    except ValueError:
        shown = ", ".join(f"{name}={told[name][:80]!r}" for name in one.needed)
        checks.refuse("join", f"an address from the variables of {one.name}", shown, f"Set {ADDRESS}=HOST:PORT, {COUNT} and {NUMBER}.")
    return _checked(Joined(one.name, coordinator, count, number))


def _natural(name: str, text: str) -> int:
    if not re.fullmatch(r"\d{1,9}", text):
        checks.refuse(f"join: {name}", "a whole number", repr(text[:80]))
    return int(text)


def _checked(joined: Joined) -> Joined:
    if joined.count < 1 or not 0 <= joined.number < joined.count:
        checks.refuse("join", "a process with a number from 0 to below the number of processes", f"{joined.number} of {joined.count}")
    if not re.fullmatch(r".+:\d{1,5}", joined.coordinator):
        checks.refuse("join coordinator", "an address of process 0, HOST:PORT", repr(joined.coordinator[:80]))
    return joined


def join(
    coordinator: str | None = None, processes: int | None = None, process: int | None = None, heartbeat: int = 10, patience: int = 120
) -> Joined:
    """Work as one with the processes that a launcher started, on this machine or on others; to be called before anything is computed.

    Afterwards `jax.devices()` are those of all processes, and `mo.devices` shares the elements of a `Distributed` filter out over them. All
    processes call the same functions with the same arguments. Slurm, Open MPI 4 and 5, torchrun and indexed jobs of Kubernetes are known;
    for others set JAX_COORDINATOR_ADDRESS, JAX_NUM_PROCESSES and JAX_PROCESS_ID, or say it here.

    Args:
        coordinator: address of process 0, "host:port"; found if not given.
        processes: how many there are; found if not given.
        process: number of this one, from 0; found if not given.
        heartbeat: seconds without a sign of life after which a process counts as dead.
        patience: seconds to wait for the others at first.

    Raises:
        MotesError: no launcher is known by its variables, one is missing, the others did not come, or JAX has computed something already.
    """
    given = {ADDRESS: coordinator, COUNT: processes, NUMBER: process}
    for name, value in (("heartbeat", heartbeat), ("patience", patience)):
        checks.positive_integer(f"join {name}", value)
    own = {name: str(value) for name, value in given.items() if value is not None}
    joined = launched({**os.environ, **own})
    if joined.count > 1:
        # with JAX's service a process that is told to end would not hear of it
        jax.config.update("jax_enable_preemption_service", False)
        try:
            jax.distributed.initialize(joined.coordinator, joined.count, joined.number, heartbeat_timeout_seconds=heartbeat,
                                       initialization_timeout=patience, cluster_detection_method="deactivate")  # fmt: skip
        except RuntimeError as reason:
            told = str(reason).splitlines()[0][:200]
            checks.refuse("join", f"{joined.count} processes that find {joined.coordinator} within {patience} s, once and before anything "
                          "is computed", told)  # fmt: skip
        _connect()
    return joined


def _connect() -> None:
    """Exchange a first number; what the library that does it on CPUs prints of it goes nowhere."""
    from jax.experimental import multihost_utils

    sys.stdout.flush()
    kept, nowhere = os.dup(1), os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 1)
        multihost_utils.sync_global_devices("motes")
    finally:
        os.dup2(kept, 1)
        os.close(kept)
        os.close(nowhere)


def are_several() -> bool:
    """Tell whether there are other processes."""
    return jax.process_count() > 1


def is_first() -> bool:
    """Tell whether this process is the one that prints and writes."""
    return jax.process_index() == 0


def agreed(value: Any) -> Any:
    """Return what process 0 says, a number or an array; all processes ask."""
    if not are_several():
        return value
    from jax.experimental import multihost_utils

    return np.asarray(multihost_utils.broadcast_one_to_all(np.asarray(value)))


def one_of_all(said: bool) -> bool:
    """Tell whether one of the processes says so; all processes ask."""
    if not are_several():
        return said
    from jax.experimental import multihost_utils

    return bool(np.any(multihost_utils.process_allgather(np.asarray(said))))


def brought_together(tree: Any) -> Any:
    """Return arrays with the parts that other processes hold; all processes ask."""
    if not are_several():
        return tree
    from jax.experimental import multihost_utils

    def complete(leaf: Any) -> Any:
        if not isinstance(leaf, jax.Array) or leaf.is_fully_addressable:
            return leaf
        if jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key):
            return jax.random.wrap_key_data(complete(jax.random.key_data(leaf)), impl=jax.random.key_impl(leaf))
        if leaf.is_fully_replicated:
            return np.asarray(leaf.addressable_data(0))
        return multihost_utils.process_allgather(leaf, tiled=True)

    return jax.tree.map(complete, tree)
