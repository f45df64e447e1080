"""Executors of other processes and machines: what they must be able to do, how much they are handed, and what is said of lost workers."""

import time
from collections.abc import Callable
from typing import Any

from motes.core import checks

WINDOW = 1_000
"""Blocks that are handed out at a time: more than a cluster has threads, fewer than a scheduler minds."""
EVERY = 1.0
"""Seconds between two looks at who is there."""
DEAD = ("KilledWorker", "BrokenProcessPool", "BrokenExecutor")
"""Names of what is raised where a block was lost together with those who worked on it."""


def check_executor(experiment: Any, executor: Any) -> None:
    """Refuse what cannot take work, and work that cannot travel.

    Raises:
        MotesError: one of these.
    """
    if not callable(getattr(executor, "submit", None)):
        checks.refuse("study executor", "what has submit(function, *arguments), such as a ProcessPoolExecutor", type(executor).__name__)
    if not isinstance(experiment, str):
        checks.refuse("study experiment", "the name of a function that makes it, 'module:function', where an executor is given",
                      type(experiment).__name__, "Functions of a model cannot travel to other processes.")
    context = getattr(executor, "_mp_context", None)
    if context is not None and context.get_start_method() == "fork":
        checks.refuse("study executor", "processes that are spawned", "forked ones, in which JAX hangs",
                      "Give ProcessPoolExecutor mp_context=multiprocessing.get_context('spawn').")


def result_of(future: Any) -> Any:
    """Return what a worker found.

    Raises:
        MotesError: the block was lost, time and again, with the processes that worked on it.
    """
    try:
        return future.result()
    except Exception as reason:
        if type(reason).__name__ in DEAD:
            checks.refuse("study executor", "processes that live until their work is done", f"{type(reason).__name__}: {reason}"[:300],
                          "Is there memory for them? The same call goes on from what a store has.")  # fmt: skip
        raise


def absences(executor: Any) -> Callable[[], None]:
    """Return what is to be called now and then, and warns of each worker that is gone.

    A Dask scheduler gives what such a worker had at hand to the others by itself; other executors do not tell who works for them.
    """
    if not callable(getattr(executor, "scheduler_info", None)):
        return lambda: None
    known, seen = set[str](), [-EVERY]

    def look() -> None:
        if time.monotonic() - seen[0] < EVERY:
            return
        seen[0] = time.monotonic()
        there = set(executor.scheduler_info(n_workers=-1)["workers"])
        for name in sorted(known - there):
            checks.warn(f"study: worker {name} is gone; what it had at hand is done again ({len(there)} workers are there).")
        known.clear()
        known.update(there)

    return look


def client(address: str) -> Any:
    """Connect to a Dask scheduler.

    Args:
        address: such as tcp://host:8786.

    Raises:
        MissingExtraError: distributed is not installed.
        MotesError: no scheduler answers there.
    """
    distributed = checks.need("distributed", "studies")
    try:
        distributed.comm.get_address_host_port(address)  # a client that fails at this stays the default of everything else in Dask
        return distributed.Client(address, timeout="10s")
    except (OSError, ValueError, TypeError) as reason:
        told = str(reason).splitlines()[0][:200] if str(reason) else type(reason).__name__
        checks.refuse("scheduler", "the address of a Dask scheduler, such as tcp://127.0.0.1:8786", f"{address!r} ({told})",
                      "Is `dask scheduler` running there?")  # fmt: skip
