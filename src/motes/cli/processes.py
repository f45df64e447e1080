"""One run of the command on several processes: started here by `--processes`, or elsewhere by a launcher and joined by `--hosts`.

Process 0 prints and writes. Where one ends before its time the others cannot go on: those that were started here are ended with it, in one
line that says how far the run had come and where it is kept; so are they where we are ended ourselves.
"""

import os
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

from motes.cli import interruption
from motes.cli.options import refuse

if TYPE_CHECKING:
    from motes.filters.interface import Filter

ELEMENTS = 8
"""Of each filter, where nothing else is asked for."""
MOST = 512
"""Processes that are started on one machine at most."""
LAUNCHER = "MOTES_STARTED_BY"
"""Variable that tells a process which process started it."""
LOST = 70
"""Exit code of a process that lost another one."""
LOOK = 0.05
PATIENCE = 5.0
"""Seconds between two looks at who is there; for which the others wait to be ended."""


def started(command: str, words: Sequence[str], settings: Any) -> bool:
    """Start processes that run the command together and wait for them, where several are asked for.

    Args:
        command: such as "run".
        words: after the command.
        settings: of the command.

    Returns:
        Whether it was so.

    Raises:
        MotesError: a number that cannot be.
        SystemExit: a process failed; it has been told.
    """
    count = settings.processes
    if not 1 <= count <= MOST:
        refuse("processes", f"a whole number from 1 to {MOST}", count)
    if settings.hosts and count != 1 and LAUNCHER not in os.environ:
        refuse("processes", "none beside --hosts, where a launcher has started them", count, "Leave out one of the two.")
    if count == 1 or settings.hosts:
        return False
    from motes.cli.running import check_folder

    check_folder(settings.out)
    code = _worked_off(command, words, count, settings.out)
    if code:
        sys.exit(code)
    return True


def distributed(filters: "dict[str, Filter]", settings: Any) -> "dict[str, Filter]":
    """Return filters in elements, where that is asked for, or where processes share the work.

    Raises:
        MotesError: a filter cannot be cut into as many.
    """
    from motes.filters.distributed import Distributed

    count = ELEMENTS if settings.elements is None and settings.hosts else settings.elements
    return {name: one if count is None or isinstance(one, Distributed) else Distributed(one, count) for name, one in filters.items()}


def _worked_off(command: str, words: Sequence[str], count: int, out: str) -> int:
    told = {"JAX_COORDINATOR_ADDRESS": f"127.0.0.1:{_free_port()}", "JAX_NUM_PROCESSES": str(count), LAUNCHER: str(os.getpid())}
    asked = [sys.executable, "-m", "motes.cli.main", command, *words, "--hosts"]
    with tempfile.TemporaryFile() as said:
        children = [subprocess.Popen(asked, env=os.environ | told | {"JAX_PROCESS_ID": str(number)}, stdin=subprocess.DEVNULL,
                                     stdout=None if number == 0 else subprocess.DEVNULL, stderr=None if number == 0 else said)
                    for number in range(count)]  # fmt: skip
        interruption.instead(lambda heard: [child.send_signal(heard) for child in children if child.poll() is None])
        try:
            first = _first_to_fail(children)
        finally:
            for child in children:
                if child.poll() is None:
                    child.kill()
            for child in children:
                child.wait()
        if first is None:
            return 0
        number, code = first
        if code < 0:
            print(f"motes {command}: process {number} of {count} was ended by {signal.Signals(-code).name}{_kept(out)}", file=sys.stderr)
            return LOST
        if number > 0 and code not in interruption.CODES.values():
            said.seek(0)
            lines = said.read().decode(errors="replace").strip().splitlines() or [f"motes {command}: exit code {code}"]
            print(f"{lines[-1]} (process {number} of {count})", file=sys.stderr)
        return code


def _first_to_fail(children: Sequence[subprocess.Popen[bytes]]) -> tuple[int, int] | None:
    """Wait until all have ended well, or one has not: its number and exit code. Process 0 says what is wrong with all."""
    while True:
        codes = [child.poll() for child in children]
        failed = [(number, code) for number, code in enumerate(codes) if code]
        if failed and all(code > 0 for _, code in failed) and codes[0] is None:
            # what all refuse is told by process 0
            until = time.monotonic() + PATIENCE
            while children[0].poll() is None and time.monotonic() < until:
                time.sleep(LOOK)
            codes = [child.poll() for child in children]
            failed = [(number, code) for number, code in enumerate(codes) if code]
        if failed:
            # one that lost another is not the one to be named
            return min(failed, key=lambda one: (one[1] == LOST, one[1] > 0, one[0]))
        if all(code == 0 for code in codes):
            return None
        time.sleep(LOOK)


def _kept(out: str) -> str:
    """Say how far a run had come, and where that is kept."""
    from motes.cli.long_runs import kept_in

    found = kept_in(Path(out))
    if found is None:
        return "; nothing of the run was kept yet"
    steps, path = found
    return f"; {steps} steps are kept in {path}, and the same command goes on from there"


def _free_port() -> int:
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        return one.getsockname()[1]


@contextmanager
def at_work(settings: Any) -> Iterator[None]:
    """Work as one with the other processes in a `with` block, where the command is to; all devices share the elements of filters out.

    Raises:
        MotesError: the others are not found.
    """
    if not settings.hosts:
        yield
        return
    from motes.core.checks import MotesError
    from motes.core.devices import devices
    from motes.core.hosts import is_first, join

    found = join()
    _with_parent()
    import jax

    if not is_first():
        sys.stdout = open(os.devnull, "w")  # noqa: SIM115 (until the process ends)
    try:
        with devices(jax.device_count()):
            yield
    except MotesError:
        raise
    except (RuntimeError, ValueError) as reason:
        _lost(reason, found.number, settings.out)
    # none leaves before process 0 has written what there is to write
    jax.distributed.shutdown()


def _with_parent() -> None:
    """End with the process that started this one."""
    parent = os.environ.get(LAUNCHER)
    if parent is None:
        return

    def watch() -> None:
        while str(os.getppid()) == parent:
            time.sleep(10 * LOOK)
        os._exit(LOST)

    threading.Thread(target=watch, name="parent", daemon=True).start()


def _lost(reason: Exception, number: int, out: str) -> NoReturn:
    """End this process, which cannot reach another one any more, without waiting for it."""
    text = " ".join(str(reason).split())[:200]
    if LAUNCHER in os.environ:
        # who started us says it
        time.sleep(PATIENCE)
    else:
        os.write(2, f"motes: process {number} lost another process ({text}){_kept(out)}\n".encode())
    os._exit(LOST)
