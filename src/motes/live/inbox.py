"""Messages on their way from a source to the filter: they wait here as they came, which takes less memory than what they say."""

import threading
from collections import deque
from collections.abc import Sequence
from typing import Any

from motes.live.source import Source

POLL = 0.2
"""Seconds after which is looked at whether the run is to end, while nothing comes."""
TOGETHER = 100
"""Messages that are handed to the filter at a time."""
QUEUE = 200_000
"""Messages that may wait for the filter."""


class Inbox:
    """Messages of a source; those that do not wait where they come from are read by a thread."""

    def __init__(self, source: Source):
        """Begin to listen."""
        self._source = source
        self._queue: deque[Any] = deque()
        self._came, self._ended = threading.Event(), threading.Event()
        self._over = False
        self._failure: BaseException | None = None
        self._thread = None if source.waits else threading.Thread(target=self._listen, name="source", daemon=True)
        if self._thread is not None:
            self._thread.start()

    def _listen(self) -> None:
        try:
            while not self._ended.is_set():
                found = self._source.receive(POLL)
                if found is None:
                    break
                if len(self._queue) + len(found) > QUEUE:
                    self._source.counts.add("overrun", f"{self._source.name}: messages come faster than the filter takes them; some are "
                                            "lost.", len(found))  # fmt: skip
                    continue
                self._queue.extend(found)
                if found:
                    self._came.set()
        except BaseException as reason:
            self._failure = reason
        self._over = True
        self._came.set()

    def take(self, timeout: float) -> Sequence[Any] | None:
        """Return what came as it came, waiting so many seconds at most; None where nothing will come any more."""
        if self._thread is None:
            if self._queue:
                found = list(self._queue)
                self._queue.clear()
                return found
            return self._source.receive(timeout)
        # what came before the source was over is here by now
        over = self._over
        if not self._queue and not over:
            self._came.wait(timeout)
        self._came.clear()
        # few at a time: those that are handed out and not taken yet would be held beside all that come meanwhile
        found = [self._queue.popleft() for _ in range(min(len(self._queue), TOGETHER))]
        if over and not found:
            if self._failure is not None:
                raise self._failure
            return None
        return found

    def put_back(self, received: Sequence[Any]) -> None:
        """Put back what was not taken."""
        self._queue.extendleft(reversed(received))

    def close(self) -> None:
        """End the thread, and count what was read and not taken, unless it can be read again."""
        self._ended.set()
        if self._thread is not None:
            self._thread.join(2 * POLL)
        if self._queue and not self._source.repeats:
            self._source.counts.add("left", number=len(self._queue))
