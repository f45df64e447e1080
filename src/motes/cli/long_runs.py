"""Runs over measurements that do not fit into memory: piece by piece, and kept on disk while they last, so that a killed one goes on.

What is kept of a run has a name that tells filter, seed, measurements and what the job says of itself: another never goes on from it.
"""

import hashlib
import time
from collections.abc import Iterator
from itertools import chain
from pathlib import Path

import jax

from motes.applications.interface import Job
from motes.cli.interruption import keeps
from motes.core.memory import give_back
from motes.core.record import replace
from motes.filters.history import History, joined
from motes.filters.interface import Filter
from motes.filters.keep import Keep
from motes.filters.pieces import gathered
from motes.io.files import label

EVERY = 5.0
"""Seconds after which a run is kept once more."""
ENDING = ".unfinished.npz"
END = object()
"""In place of a measurement after the last one."""


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
    told = repr((seed, filter, job.ys, getattr(keep, "__name__", ""), job.told()))
    path = path.with_name(f".{path.name}.{hashlib.sha256(told.encode()).hexdigest()[:16]}{ENDING}")
    found = [History.load(path)] if path.exists() else []
    yield from found
    measurements = job.ys(int(found[0].last.step) + 1 if found else 0)
    first = next(measurements, END)
    if found and first is END:
        return
    measurements = measurements if first is END else chain([first], measurements)
    since = time.monotonic()
    for piece, _ in gathered(job.model, measurements, None):
        part = job.piece(seed, filter, piece, keep, found[-1] if found else None)
        jax.block_until_ready(part)
        give_back()
        yield part
        found[-1:] = [replace(one, last=None) for one in found[-1:]] + [part]
        if time.monotonic() - since > EVERY:
            path.parent.mkdir(parents=True, exist_ok=True)
            found = [joined(found)]
            found[0].save(path)
            keeps(label(path.parent))
            since = time.monotonic()


def forget(folder: Path) -> None:
    """Remove what was kept of runs that are finished."""
    for path in folder.glob(f".*{ENDING}"):
        path.unlink(missing_ok=True)
