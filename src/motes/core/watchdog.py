"""A watch over long work: after a while without progress it says on the error stream where the work stands."""

import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

SILENCE = 120.0
"""Seconds without progress until something is said; again after twice as long, and so on."""
ASLEEP = 0.01
"""Share of a processor below which a process that should compute is called asleep."""


@contextmanager
def watched(name: str, standing: Callable[[], str], hint: str = "", here: bool = True) -> Iterator[Callable[[], None]]:
    """Watch over the work in a `with` block.

    Args:
        name: of what works, such as "sample".
        standing: says how far it has come, such as "3 of 20 pieces".
        hint: what becomes of the work when it is interrupted.
        here: whether it is this process that computes.

    Returns:
        What the work calls whenever it has come further.
    """
    moved, ended = threading.Event(), threading.Event()

    def said(seconds: float, cpu: float) -> str:
        state = "" if not here else " The process is asleep." if cpu < ASLEEP * seconds else " The process is computing."
        return f"{name}: no progress for {seconds:.0f} s at {standing()}.{state} Ctrl-C ends it{hint}."

    threading.Thread(target=_watch, args=(moved, ended, said), daemon=True).start()
    try:
        yield moved.set
    finally:
        ended.set()
        moved.set()


def _watch(moved: threading.Event, ended: threading.Event, said: Callable[[float, float], str]) -> None:
    silence, since, used = SILENCE, time.monotonic(), time.process_time()
    while True:
        heard = moved.wait(silence)
        if ended.is_set():
            return
        now, cpu = time.monotonic(), time.process_time()
        if heard:
            moved.clear()
            silence, since, used = SILENCE, now, cpu
        else:
            print(said(now - since, cpu - used), file=sys.stderr, flush=True)
            silence = now - since
