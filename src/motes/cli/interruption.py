"""Ctrl-C ends the command at once, whatever it does: a thread of its own hears it. SIGTERM lets a run that is kept save itself first.

So does SIGHUP, which comes where a terminal is closed.

A Python handler runs only between two steps of the main thread, which can be in compiled code for minutes, or asleep there for good; an
exception that a handler raises can be lost in a destructor or in somebody's callback; and threads of XLA that still compute while Python
tears down around them end in a segmentation fault. So nothing is torn down. What is kept on disk is written whole or not at all.
"""

import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import NoReturn

from motes.io.unfinished import remove_unfinished

CODES: dict[int, int] = {signal.SIGINT: 130, signal.SIGTERM: 143}
WORDS: dict[int, str] = {signal.SIGINT: "interrupted", signal.SIGTERM: "ended by SIGTERM"}
HANGUP: int | None = getattr(signal, "SIGHUP", None)
if HANGUP is not None:
    CODES[HANGUP], WORDS[HANGUP] = 129, "ended by SIGHUP"
SHOW_CURSOR = "\x1b[?25h\n"

_ending = threading.Lock()
_asked = threading.Event()
_asked_by: int = signal.SIGTERM
_name = "motes"
_kept = ""
_saves: tuple[int, ...] = ()
_instead: Callable[[int], object] | None = None


def heed(name: str) -> None:
    """End this process with one line and exit code 130, 143 or 129 when it is interrupted, or told to end.

    Args:
        name: what was interrupted, for the line.
    """
    # a shell has interruptions of what it starts in its background ignored
    heard = [number for number in CODES if signal.getsignal(number) in (signal.default_int_handler, signal.SIG_DFL)]
    if threading.current_thread() is not threading.main_thread() or not heard:
        return
    global _name
    _name = name
    # lines that were printed are out when it ends
    if sys.stdout is not None:
        sys.stdout.reconfigure(line_buffering=True)  # type: ignore[union-attr]
    reader, writer = os.pipe()
    os.set_blocking(writer, False)
    for number in heard:
        # the thread hears of it in any case; Python asks for a handler
        signal.signal(number, lambda *about: None)
    signal.set_wakeup_fd(writer, warn_on_full_buffer=False)
    threading.Thread(target=_listen, args=(reader,), name="interruption", daemon=True).start()


def keeps(where: str) -> None:
    """Have the line say from now on that what was done is kept, and where."""
    global _kept
    _kept = f"; what was done is kept in {where}, and the same command goes on from there"


@contextmanager
def saving(interrupts: bool = False) -> Iterator[None]:
    """Let the first SIGTERM or SIGHUP only ask the work in a `with` block to end.

    That looks at `is_asked` now and then, saves, and calls `end`.

    Args:
        interrupts: whether the first Ctrl-C asks, too.
    """
    global _saves
    _saves = tuple(number for number in CODES if interrupts or number != signal.SIGINT)
    try:
        yield
    finally:
        _saves = ()


def is_asked() -> bool:
    """Tell whether the work was asked to end."""
    return _asked.is_set()


def end() -> NoReturn:
    """End this process as the signal asked for."""
    _end(_asked_by)
    # another thread is at it
    leave(CODES[_asked_by])


def instead(heard: Callable[[int], object]) -> None:
    """Have this called with the number of the signal from now on, in place of all else."""
    global _instead
    _instead = heard


def _listen(reader: int) -> None:
    global _asked_by
    while True:
        heard = os.read(reader, 1)[0]
        if heard not in CODES:
            continue
        if _instead is not None:
            _instead(heard)
        elif heard in _saves and not _asked.is_set():
            _asked_by = heard
            _asked.set()
        elif heard in _saves and heard == HANGUP:
            # the system and the shell both send it
            continue
        else:
            _end(heard)


def _end(number: int) -> None:
    if not _ending.acquire(blocking=False):
        return
    remove_unfinished()
    # not by way of Python's streams, whose locks the main thread may hold
    line = (SHOW_CURSOR if os.isatty(2) else "") + f"{_name}: {WORDS[number]}{_kept}\n"
    try:
        os.write(2, line.encode())
    finally:
        os._exit(CODES[number])


def leave(code: int) -> NoReturn:
    """End this process with an exit code, without tearing Python down."""
    while _ending.locked():
        time.sleep(1)
    for stream in (sys.stdout, sys.stderr):
        # None where a shell closed it
        if stream is not None:
            stream.flush()
    os._exit(code)
