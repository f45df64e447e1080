"""Threads that work while the one that asked waits, so that Ctrl-C is heard at once.

Code that XLA compiled cannot be stopped, and Python hears no signal while its main thread is in it. When an interruption leaves the `with`
block of these workers, what they are at gets a moment to end; then they are left behind. Where one is still at work when Python ends, the
process ends without being torn down, which would be a segmentation fault.
"""

import atexit
import os
import sys
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future
from contextlib import suppress
from contextvars import copy_context
from queue import SimpleQueue
from typing import Any, Self

PATIENCE = 0.5
"""Seconds that work gets to end after an interruption."""
INTERRUPTED = 130

_left_behind: list[threading.Event] = []


class Workers:
    """A number of threads; use them in a `with` block, at whose end they have ended or are left behind."""

    def __init__(self, count: int):
        """Start so many threads."""
        self._tasks: SimpleQueue[Callable[[], None] | None] = SimpleQueue()
        self._ended = [threading.Event() for _ in range(count)]
        for ended in self._ended:
            # what they hold must not hold them: a reference to this object would keep it from ending
            threading.Thread(target=_work, args=(self._tasks, ended), daemon=True).start()

    def submit(self, function: Callable[..., Any], *arguments: Any) -> Future[Any]:
        """Have a function called by the next thread that is free."""
        future: Future[Any] = Future()
        context = copy_context()

        def task() -> None:
            if not future.set_running_or_notify_cancel():
                return
            try:
                future.set_result(context.run(function, *arguments))
            except BaseException as reason:
                future.set_exception(reason)

        self._tasks.put(task)
        return future

    def __enter__(self) -> Self:
        """Begin."""
        return self

    def __exit__(self, kind: type[BaseException] | None, *reason: object) -> None:
        """Wait until the threads have ended; after an interruption not for long."""
        for _ in self._ended:
            self._tasks.put(None)
        try:
            until = None if kind is None or not issubclass(kind, KeyboardInterrupt) else time.monotonic() + PATIENCE
            for ended in self._ended:
                ended.wait(None if until is None else max(0.0, until - time.monotonic()))
        finally:
            _left_behind.extend(ended for ended in self._ended if not ended.is_set())


def _work(tasks: SimpleQueue[Callable[[], None] | None], ended: threading.Event) -> None:
    try:
        while (task := tasks.get()) is not None:
            task()
    finally:
        ended.set()


@atexit.register
def _leave() -> None:
    if all(ended.is_set() for ended in _left_behind):
        return
    for stream in (sys.stdout, sys.stderr):
        with suppress(Exception):
            stream.flush()
    os._exit(INTERRUPTED)
