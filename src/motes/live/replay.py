"""Measurements that were recorded, one by one: at their own speed, faster, or as fast as they are taken."""

import hashlib
import time
from collections.abc import Sequence
from typing import Any

import jax
import numpy as np

from motes.filters.data import steps_of
from motes.live.message import Message
from motes.live.source import Source
from motes.models.state_space import at_step

TOGETHER = 100
"""Messages that are handed on at a time where nothing sets the pace."""


class Replay(Source):
    """The rows of a recording, whatever file they were read from."""

    waits = is_over = repeats = True
    was_read = "the recording that was taken up to row"

    def __init__(self, name: str, ys: Any, inputs: Any = None, times: Any = None, speed: float = 1.0):
        """Take measurements and inputs, time axis first.

        Args:
            name: of what was recorded.
            ys: measurements.
            inputs: of the model, or None.
            times: seconds, `(t,)`; None where steps are only numbered, and nothing sets the pace.
            speed: how many times as fast; 0 for as fast as they are taken.
        """
        super().__init__(name)
        self._rows = jax.tree.map(np.asarray, (ys, inputs))
        self._steps = steps_of(ys)
        self._times = None if times is None else np.asarray(times, np.float64)
        self._speed, self._at = (0.0 if times is None else speed), 0
        self._began: float | None = None
        self._leaves = jax.tree.leaves((self._rows, self._times))
        self._begin_digests()

    def understood(self, received: int) -> Message:
        """Return the message of a row."""
        self.position = received + 1
        return self.message(received)

    def message(self, content: Any) -> Message:
        """Return the message of a row."""
        row = int(content)
        y, u = at_step(self._rows, row)
        return Message(row, y, u, None if self._times is None else float(self._times[row]), digest=row)

    def receive(self, timeout: float) -> Sequence[int] | None:
        """Return the rows whose time has come."""
        if self._at >= self._steps:
            return None
        begin = self._at
        if self._times is None or self._speed == 0:
            self._at = min(self._steps, begin + TOGETHER)
        else:
            now = time.monotonic()
            began = now - self._times[begin] / self._speed if self._began is None else self._began
            self._began, due = began, began + self._times / self._speed
            self._at = max(begin, int(np.searchsorted(due, now, "right")))
            if self._at == begin:
                time.sleep(min(timeout, max(0.0, due[begin] - now)))
                return []
        return range(begin, self._at)

    def mark(self, position: int) -> str:
        """Return a digest of all rows before a position; rows that were digested before are not read again."""
        if position < self._digested:
            self._begin_digests()
        for digest, leaf in zip(self._digests, self._leaves, strict=True):
            digest.update(leaf[self._digested : position].tobytes())
        self._digested = position
        return hashlib.sha256(b"".join(digest.digest() for digest in self._digests)).hexdigest()[:16]

    def _begin_digests(self) -> None:
        self._digests, self._digested = [hashlib.sha256() for _ in self._leaves], 0

    def go_on(self, position: int) -> None:
        """Begin at a row."""
        self._at = position
