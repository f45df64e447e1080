"""Runs piece by piece, also over measurements that do not fit into memory: kept on disk while they last, so that a killed one goes on.

What is kept of a run has a name that tells filter, seed, measurements, model or what the job says of itself: another never goes on from it.
"""

import glob
import hashlib
import math
import time
from collections.abc import Callable, Iterator
from functools import cache, partial
from itertools import chain
from pathlib import Path
from typing import Any

import jax

from motes.applications.interface import Job
from motes.cli import interruption
from motes.core import checks, hosts
from motes.core.checks import FileError, MotesError
from motes.core.memory import give_back
from motes.core.record import replace
from motes.filters.data import steps_of
from motes.filters.history import History, joined
from motes.filters.interface import Filter
from motes.filters.keep import Keep
from motes.filters.pieces import gathered
from motes.filters.setup import canonical_parts
from motes.io.archive import provenance
from motes.io.files import label
from motes.models.canonical import canonical, one_of
from motes.tracing.fingerprint import fingerprint

EVERY = 5.0
"""Seconds after which a run is kept once more."""
CHUNKS = 20
"""Pieces of a run over measurements that are all there."""
ENDING = ".unfinished.npz"
LONGEST = 100
"""Letters of a filter's name that the name of a file takes."""
END = object()
"""In place of a measurement after the last one."""

_kept: set[Path] = set()
"""Files of the runs of this process, to be removed once they are finished."""


def long_run(seed: int, filter: Filter, job: Job, keep: Keep, path: Path) -> Iterator[History]:
    """Run a filter, and yield the history of each piece; where a run was killed, first of all that it had kept.

    Args:
        seed: of the filter.
        filter: the filter.
        job: model, and measurements that come one after the other.
        keep: what to keep of each step.
        path: where the run is kept, to which more is added.

    Raises:
        MotesError: what `run` raises, and a file that cannot be read or written.
    """
    def further(after: History | None) -> Iterator[History]:
        measurements = job.ys(0 if after is None else int(after.last.step) + 1)
        first = next(measurements, END)
        if after is not None and first is END:
            return
        measurements = measurements if first is END else chain([first], measurements)
        for piece, _ in gathered(job.model, measurements, None):
            after = job.piece(seed, filter, piece, keep, after)
            jax.block_until_ready(after)
            give_back()
            yield after

    def told() -> str:
        # what a job says of itself stands for its model; of any other job the model is compared
        digest = job.told() or digest_of(lambda: canonical(job.model, None))
        return _spelled(keep, seed, filter, job.ys, digest) if digest else ""

    return _kept_run(path, told, further)


def whole_run(seed: int, filter: Filter, job: Job, ys: Any, inputs: Any, keep: Keep, path: Path) -> Iterator[History]:
    """Run a filter over measurements that are all there, and yield the history of each piece; a killed run goes on where it was.

    What was kept is known by the traced programs and numbers of filter and model, and by all data; where a function cannot be compared in
    this way nothing is kept.

    Args:
        seed: of the filter.
        filter: the filter that runs.
        job: the model.
        ys: measurements, time axis first.
        inputs: of the model, time axis first.
        keep: what to keep of each step.
        path: see `long_run`.
    """
    steps = steps_of(ys)
    chunk = math.ceil(steps / CHUNKS)
    if not job.goes_on:
        return job.pieces(seed, filter, ys, inputs, keep, chunk)

    def further(after: History | None) -> Iterator[History]:
        done = 0 if after is None else int(after.last.step) + 1
        rows, u = jax.tree.map(lambda leaf: leaf[done:], (ys, inputs))
        return job.pieces(seed, filter, rows, u, keep, chunk, after) if done < steps else iter(())

    def told() -> str:
        shapes = jax.tree.map(one_of, (inputs, ys))
        digest = digest_of(lambda: (canonical_parts(filter, job.model, *shapes), jax.tree.leaves((ys, inputs))))
        return _spelled(keep, seed, digest) if digest else ""

    return _kept_run(path, told, further)


def digest_of(known: Callable[[], Any]) -> str:
    """Return a digest of functions and numbers; "" where a function cannot be compared by its traced program."""
    try:
        return fingerprint("run", known())
    except MotesError:
        return ""


def _spelled(keep: Keep, *rest: Any) -> str:
    """Spell what tells a run from others; "" where something of the user's own is kept of each step."""
    kept = keep.func if isinstance(keep, partial) else keep
    if not getattr(kept, "__module__", "").startswith("motes."):
        return ""
    name = f"{kept.__module__}.{kept.__qualname__}"
    return repr((*rest, name, getattr(keep, "args", ()), getattr(keep, "keywords", {}), sorted(provenance().items())))


def _kept_run(path: Path, told: Callable[[], str], further: Callable[[History | None], Iterator[History]]) -> Iterator[History]:
    """Yield the pieces of a run, first of all what was kept of it, and keep it every few seconds.

    Args:
        path: where it is kept, to which more is added.
        told: what tells the run from others; "" where that is not known, and nothing is kept. Asked where it matters.
        further: gives the pieces after a history, or from the beginning.
    """
    stem = f".{path.name[:LONGEST]}."

    @cache
    def named() -> Path | None:
        text = told()
        return path.with_name(f"{stem}{hashlib.sha256(text.encode()).hexdigest()[:16]}{ENDING}") if text else None

    # to tell a run apart takes a while: most are over before
    there = any(path.parent.glob(f"{glob.escape(stem)}*{ENDING}"))
    found = _read(named()) if hosts.one_of_all(there) else []
    steps = len(found) and int(found[0].last.step)
    if hosts.one_of_all(steps != hosts.agreed(steps)):
        checks.refuse(f"{path.parent}", "what was kept of the run on every machine", "other files on another one",
                      "Give --out a folder that all of them share.", FileError)  # fmt: skip
    yield from found
    since = time.monotonic()

    def kept() -> None:
        nonlocal found
        file = named()
        if file is not None:
            found = [joined(found)]
            if hosts.is_first():
                file.parent.mkdir(parents=True, exist_ok=True)
                found[0].save(file)
            _kept.add(file)
            interruption.keeps(label(file.parent))

    with interruption.saving():
        for part in map(hosts.brought_together, further(found[-1] if found else None)):
            jax.block_until_ready(part)
            yield part
            found[-1:] = [replace(one, last=None) for one in found[-1:]] + [part]
            # what one process is told all of them do; the clock is that of the first
            ends = hosts.one_of_all(interruption.is_asked())
            if ends or hosts.agreed(time.monotonic() - since > EVERY):
                kept()
                since = time.monotonic()
            if ends:
                interruption.end()


def _read(file: Path | None) -> list[History]:
    """Read what was kept, if there is something; what is damaged is begun anew."""
    if file is None or not file.exists():
        return []
    try:
        found = [History.load(file)]
    except FileError as reason:
        checks.warn(f"{reason} The run is begun anew.")
        return []
    _kept.add(file)
    return found


def kept_in(folder: Path) -> tuple[int, Path] | None:
    """Return how many steps of a run are kept in a folder, and in which file; of several the one that was written last."""
    files = sorted(folder.glob(f".*{ENDING}"), key=lambda file: file.stat().st_mtime)
    found = _read(files[-1]) if files else []
    return (int(found[0].last.step) + 1, files[-1]) if found else None


def forget() -> None:
    """Remove what was kept of the runs of this process, once they are finished; others' may still be needed."""
    while _kept:
        _kept.pop().unlink(missing_ok=True)
