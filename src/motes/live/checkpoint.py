"""Checkpoints of a live run: one file with all that it takes to go on, written whole or not at all.

The law is that of before the steps that a late message may still go back to; these are kept as messages and taken again.
"""

import hashlib
from pathlib import Path
from typing import Any, NamedTuple

from motes.core import checks
from motes.core.checks import FileError
from motes.filters.interface import Filter
from motes.filters.resized import size_of
from motes.filters.stream import Stream
from motes.io.archive import read_tree
from motes.io.files import label
from motes.io.unfinished import remove_leftovers
from motes.live.counts import LOG


class Kept(NamedTuple):
    """What a checkpoint gives back.

    Attributes:
        stream: as it was.
        beside: what was kept with it.
    """

    stream: Stream
    beside: dict[str, Any]


class Checkpoint:
    """The file of a run's checkpoints; what goes wrong with it is told in one line, and the filter goes on."""

    def __init__(self, path: Path, identity: str, inputs: Any = None):
        """Take the file, and what tells the run from others; inputs are an example of those of one step, where they are no dictionary."""
        self.path, self._identity, self._inputs = path, identity, inputs
        self._failed = False
        self.step: int | None = None

    def save(self, stream: Stream, beside: dict[str, Any], back: int) -> bool:
        """Write a checkpoint, and tell whether it is there."""
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            stream.save(self.path, {**beside, "identity": self._identity, "n": size_of(stream.filter)}, back)
        except (OSError, FileError) as reason:
            if not self._failed:
                said = str(reason).rstrip(".")
                LOG.warning("checkpoint: %s; the filter goes on%s.", said, "" if self.step is None else f", step {self.step} is kept")
            self._failed = True
            return False
        if self._failed:
            LOG.warning("checkpoint: %s can be written again.", label(self.path))
        self._failed, self.step = False, stream.t
        return True

    def load(self, filter: Filter, model: Any, lag: int) -> Kept | None:
        """Read the checkpoint, if there is one; of the same filter, but for its number of particles.

        Raises:
            FileError: it is damaged, or of another filter, model or run.
        """
        remove_leftovers(self.path)
        if not self.path.exists():
            return None
        hint = f"Move it away, or set resume = false to begin anew: {label(self.path)}"
        try:
            beside = read_tree(self.path, "checkpoint")[1].get("beside")
            if not isinstance(beside, dict) or beside.get("identity") != self._identity:
                checks.refuse(f"checkpoint {label(self.path)}", "one of this run (source, seed, names and rules for messages)",
                              "one of another", hint, FileError)  # fmt: skip
            n = beside.get("n")
            if n is not None and size_of(filter) is not None:
                filter = filter.with_particles(n)
            stream = Stream.load(self.path, filter, model, self._inputs, lag)
        except FileError as reason:
            if hint in str(reason):
                raise
            raise FileError(f"{str(reason)[:300]} {hint}") from None
        self.step = stream.t
        return Kept(stream, beside)


def identity(*parts: Any) -> str:
    """Return what tells a run from others."""
    return hashlib.sha256(repr(parts).encode()).hexdigest()[:16]
