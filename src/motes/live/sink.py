"""Where results go, step by step: what a sink is, and how its failures are told once while the filter goes on."""

import json
import math
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from typing import Any

from motes.live.counts import LOG

AGAIN = 10.0
"""Seconds after which a sink that failed is tried again."""
IN_USE = ("one that no other run writes to", "one in use", "Name another, or end the other run.")
"""How a file or a folder of another run is refused: what is expected, what was given, what to do."""


class Sink(ABC):
    """Where the record of each step goes.

    Attributes:
        name: as the user gave it.
        ends: tells whether the run is to end: nobody is waited for then.
    """

    name: str
    ends: Callable[[], bool] = staticmethod(lambda: False)

    @property
    def place(self) -> str:
        """What a checkpoint knows it by, however its name is spelled and wherever the command is given."""
        return self.name

    @property
    def unwritten(self) -> int:
        """Number of records that were taken and are not written yet."""
        return 0

    @abstractmethod
    def write(self, record: dict[str, Any]) -> None:
        """Take the record of a step: numbers, truth values and None by name.

        Raises:
            OSError: it cannot be written.
        """

    def secure(self) -> None:  # noqa: B027 (some have nothing that could be lost)
        """See to it that all that was written is safe.

        Raises:
            OSError: it cannot be.
        """

    def kept(self) -> Any:
        """Return how far was written, safe or not, as JSON can hold it; None where nothing is kept."""
        return None

    def go_on(self, kept: Any, cut: bool) -> None:  # noqa: B027 (most keep nothing)
        """Begin where a checkpoint was; with `cut` leave out what was written after it, since it comes again."""

    def close(self) -> None:  # noqa: B027 (some have nothing to close)
        """Write what is left, and give back what is open."""


class Guarded:
    """A sink whose failures are told in one line, counted, and never reach the filter.

    Attributes:
        sink: the sink.
        lost: records that it did not take.
    """

    def __init__(self, sink: Sink):
        """Guard a sink."""
        self.sink, self.lost = sink, 0
        self._until, self._missing, self._fails = 0.0, 0, False

    def write(self, record: dict[str, Any]) -> None:
        """Hand on a record, unless the sink failed a moment ago."""
        if self._missing and time.monotonic() < self._until:
            self._missing, self.lost = self._missing + 1, self.lost + 1
            return
        try:
            self.sink.write(record)
        except BrokenPipeError:
            # nobody reads any more
            raise
        except Exception as reason:
            # libraries raise nearly anything, and none of it is to end the run
            self._failed(reason)
            self._missing, self.lost = self._missing + 1, self.lost + 1
            return
        if self._missing:
            LOG.warning("sink %s: works again; %d records are missing.", self.sink.name, self._missing)
            self._missing, self._fails = 0, False

    def kept(self) -> Any:
        """Return how far was written, after seeing to it that all of it is safe: where that fails, too, nothing is to come twice."""
        kept = self.sink.kept()
        try:
            self.sink.secure()
        except Exception as reason:
            self._failed(reason)
            return kept
        if kept is not None and not self._missing:
            # nothing was lost: what fails next is told anew
            self._fails = False
        return kept

    def close(self) -> None:
        """Close the sink, and say how many records it did not take."""
        try:
            self.sink.close()
        except Exception as reason:
            self._failed(reason)
            self.lost += self.sink.unwritten
        if self.lost:
            LOG.warning("sink %s: %d records are missing.", self.sink.name, self.lost)

    def _failed(self, reason: Exception) -> None:
        if not self._fails:
            LOG.warning("sink %s: %s; the filter goes on, and it is tried again every %g s.", self.sink.name,
                        getattr(reason, "strerror", None) or str(reason).rstrip("."), AGAIN)  # fmt: skip
        self._until, self._fails = time.monotonic() + AGAIN, True


def write_to_all(sinks: Sequence[Guarded], record: dict[str, Any]) -> None:
    """Write a record to all sinks, also where one that nobody reads any more ends the run.

    Raises:
        BrokenPipeError: one did.
    """
    left: BrokenPipeError | None = None
    for sink in sinks:
        try:
            sink.write(record)
        except BrokenPipeError as reason:
            left = reason
    if left is not None:
        raise left


def line_of(record: dict[str, Any]) -> bytes:
    """Return a record as one line of JSON, without its end; numbers that are not finite become null."""
    found = {name: None if isinstance(value, float) and not math.isfinite(value) else value for name, value in record.items()}
    return json.dumps(found, allow_nan=False).encode()
