"""Checkpoints of a live run: one file with all that it takes to go on, written whole or not at all.

The law is that of before the steps that a late message may still go back to; these are kept as messages and taken again.
"""

import hashlib
import os
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any, NamedTuple, NoReturn

from motes.core import checks
from motes.core.checks import FileError
from motes.filters.interface import Filter
from motes.filters.stream import Stream
from motes.io.archive import durable_folder, read_tree, write_tree
from motes.io.files import label, lock
from motes.io.unfinished import remove_leftovers
from motes.live.counts import LOG


class Kept(NamedTuple):
    """What a checkpoint gives back.

    Attributes:
        stream: as it was; None where the run was killed before its first checkpoint.
        beside: what was kept with it.
    """

    stream: Stream | None
    beside: dict[str, Any]


class Checkpoint:
    """The file of a run's checkpoints; what goes wrong with it is told in one line, and the filter goes on."""

    def __init__(self, path: Path, identity: dict[str, str], inputs: Any = None):
        """Take the file, and what tells the run from others; inputs are an example of those of one step, where they are no dictionary."""
        self.path, self._identity, self._inputs = path, identity, inputs
        self._failed = False
        self.step: int | None = None

    @contextmanager
    def locked(self) -> Iterator[None]:
        """Have no other process use the file inside of a `with` block, or until this one ends, however it ends.

        Raises:
            FileError: another uses it.
        """

        def refused() -> NoReturn:
            checks.refuse(f"checkpoint {label(self.path)}", "one that no other run uses", "one in use",
                          "Wait for that run, end it, or give this one another folder with --out.", FileError)  # fmt: skip

        with ExitStack() as held:
            # where nothing can be written nothing can be spoilt
            with suppress(OSError):
                durable_folder(self.path.parent.absolute())
                held.callback(lock(self.path.with_suffix(".lock"), refused).release)
            yield

    def begin(self, beside: dict[str, Any]) -> bool:
        """Write what is to be known of a run that is killed before its first checkpoint, and tell whether it is there."""
        texts = {"beside": {**beside, "identity": self._identity, "begun": True}}
        return self._written(lambda: write_tree(self.path, {}, texts, "checkpoint"))

    def forget(self) -> None:
        """Remove what tells of a run that began and took nothing; a checkpoint stays."""
        if self.step is None:
            with suppress(OSError):
                self.path.unlink(missing_ok=True)

    def save(self, stream: Stream, beside: dict[str, Any], back: int) -> bool:
        """Write a checkpoint, and tell whether it is there."""
        texts = {**beside, "identity": self._identity, "n": stream.filter.fixed_count}
        there = self._written(lambda: stream.save(self.path, texts, back))
        self.step = stream.t if there else self.step
        return there

    def _written(self, write: Callable[[], object]) -> bool:
        try:
            durable_folder(self.path.parent.absolute())
            write()
        except (OSError, FileError) as reason:
            if not self._failed:
                said = f"{label(self.path)}: {reason.strerror}" if isinstance(reason, OSError) else str(reason).rstrip(".")
                LOG.warning("checkpoint: %s; the filter goes on%s.", said, "" if self.step is None else f", step {self.step} is kept")
            self._failed = True
            return False
        if self._failed:
            LOG.warning("checkpoint: %s can be written again.", label(self.path))
        self._failed = False
        return True

    def load(self, filter: Filter, model: Any, lag: int) -> Kept | None:
        """Read the checkpoint, if there is one; of the same filter, but for its number of particles.

        Raises:
            FileError: it is damaged, or of another filter, model or run.
        """
        remove_leftovers(self.path)
        if not os.path.exists(self.path):
            return None
        hint = f"Move it away, or set resume = false (--live.no-resume) to begin anew: {label(self.path)}"
        try:
            beside = read_tree(self.path, "checkpoint")[1].get("beside")
            beside = beside if isinstance(beside, dict) else {}
            kept = beside.get("identity")
            other = [name for name, one in self._identity.items() if not isinstance(kept, dict) or kept.get(name) != one]
            if other and beside.get("begun"):
                # nothing was kept of it that could be lost
                return None
            if other:
                checks.refuse(f"checkpoint {label(self.path)}", "one of this run", f"one of another {', '.join(other)}", hint, FileError)
            if beside.get("begun"):
                return Kept(None, beside)
            n = beside.get("n")
            if n is not None and filter.fixed_count is not None:
                filter = filter.with_particles(n)
            stream = Stream.load(self.path, filter, model, self._inputs, lag)
        except FileError as reason:
            if hint in str(reason):
                raise
            raise FileError(f"{str(reason)[:300]} {hint}") from None
        self.step = stream.t
        return Kept(stream, beside)


def identity(**parts: Any) -> dict[str, str]:
    """Return what tells a run from others, of each of its parts, whose names are words with "_" for spaces."""
    return {name.replace("_", " "): hashlib.sha256(repr(part).encode()).hexdigest()[:16] for name, part in parts.items()}
