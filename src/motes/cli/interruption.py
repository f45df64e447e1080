"""Ctrl-C ends the command at once, whatever it does: a thread of its own hears it.

A Python handler runs only between two steps of the main thread, which can be in compiled code for minutes, or asleep there for good; an
exception that a handler raises can be lost in a destructor or in somebody's callback; and threads of XLA that still compute while Python
tears down around them end in a segmentation fault. So nothing is torn down. What is kept on disk is written whole or not at all.
"""

import os
import signal
import sys
import threading
import time
from typing import NoReturn

from motes.io.unfinished import remove_unfinished

CODE = 130
SHOW_CURSOR = "\x1b[?25h\n"

_ending = threading.Lock()
_kept = ""


def heed(name: str) -> None:
    """End this process with one line and exit code 130 when it is interrupted.

    Args:
        name: what was interrupted, for the line.
    """
    if threading.current_thread() is not threading.main_thread() or signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        # a shell has interruptions of what it starts in its background ignored
        return
    # lines that were printed are out when it ends
    sys.stdout.reconfigure(line_buffering=True)  # type: ignore[union-attr]
    reader, writer = os.pipe()
    os.set_blocking(writer, False)
    signal.signal(signal.SIGINT, lambda *about: _end(name))
    signal.set_wakeup_fd(writer, warn_on_full_buffer=False)
    threading.Thread(target=_listen, args=(reader, name), name="interruption", daemon=True).start()


def keeps(where: str) -> None:
    """Have the line say from now on that what was done is kept, and where."""
    global _kept
    _kept = f"; what was done is kept in {where}, and the same command goes on from there"


def _listen(reader: int, name: str) -> None:
    while os.read(reader, 1) != bytes([signal.SIGINT]):
        pass
    _end(name)


def _end(name: str) -> None:
    if not _ending.acquire(blocking=False):
        return
    remove_unfinished()
    # not by way of Python's streams, whose locks the main thread may hold
    line = (SHOW_CURSOR if os.isatty(2) else "") + f"{name}: interrupted{_kept}\n"
    try:
        os.write(2, line.encode())
    finally:
        os._exit(CODE)


def leave(code: int) -> NoReturn:
    """End this process with an exit code, without tearing Python down."""
    while _ending.locked():
        time.sleep(1)
    for stream in (sys.stdout, sys.stderr):
        stream.flush()
    os._exit(code)
