"""What a study gives."""

from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np

from motes.core import checks
from motes.core.record import record, static
from motes.io import archive
from motes.io.result_table import Table
from motes.laws.circular import wrap
from motes.studies.experiment import Blocks, Experiment, places
from motes.studies.store import Memory, Store
from motes.studies.tables import study_table
from motes.studies.work import TRUTH

KEPT = ("estimates", "nees", "ess", "log_likelihood", "collapsed")


@record
class StudyResult:
    """Runs of several filters over the same tracks and measurements; the axes are filter, run, time, state or block.

    Attributes:
        truth: true states, `(run, t, x)`.
        estimates: filtered means, `(filter, run, t, x)`.
        nees: e' P^-1 e of each block with the filter's own covariance P, `(filter, run, t, block)`.
        ess: smallest effective sample size of each run, `(filter, run)`; infinite for filters without weights.
        log_likelihood: of all measurements of a run, `(filter, run)`; NaN for filters without.
        collapsed: first step at which all weights vanished, `(filter, run)`; -1 for none.
        filters: names of the filters.
        labels: the filters, as they print.
        gives_up: for each filter whether a run in which all weights vanish is lost (on_collapse="raise").
        states: names of the states.
        angles: places of the states that are angles.
        blocks: name and states of each block.
        lost_beyond: block and largest final error of the rule for lost runs, or None.
        seed: of the experiment.
        provenance: name and value of what made the runs.
    """

    truth: np.ndarray
    estimates: np.ndarray
    nees: np.ndarray
    ess: np.ndarray
    log_likelihood: np.ndarray
    collapsed: np.ndarray
    filters: tuple[str, ...] = static()
    labels: tuple[str, ...] = static()
    gives_up: tuple[bool, ...] = static()
    states: tuple[str, ...] = static()
    angles: tuple[int, ...] = static()
    blocks: Blocks = static()
    lost_beyond: tuple[str, float] | None = static()
    seed: int = static()
    provenance: tuple[tuple[str, str], ...] = static()

    def __str__(self) -> str:
        """Print the table."""
        return str(self.table())

    def _repr_markdown_(self) -> str:
        return self.table().to_markdown()

    @classmethod
    def load(cls, store: str | Path) -> "StudyResult":
        """Read a store: of the filters of the study that used it last, the runs that all of them have, which is what can be compared.

        Args:
            store: the folder; a study may be writing to it.

        Raises:
            FileError: the folder is no store, is damaged, or holds no run of all filters yet.
        """
        with Store(Path(store), write=False) as found:
            found.verify(repair=False)
            notes, entries = found.notes(), found.parts()
            parts = list(notes["gives_up"])
            runs = min(_unbroken(found.done(part)) for part in (TRUTH, *parts))
            if not runs:
                checks.refuse(str(store), "a store with runs of all its filters", "none yet", "Let the study go on.", checks.FileError)
            return cls.read(found, parts, runs, notes | {"labels": {part: entries[part][1].shown for part in parts}})

    @classmethod
    def read(cls, kept: Store | Memory, parts: list[str], runs: int, notes: dict[str, Any]) -> "StudyResult":
        """Put the first runs of some filters together; `notes` is what `notes_of` gives, with `labels` by name."""
        truth = _joined(kept, TRUTH, runs)["truth"]
        found = [_joined(kept, part, runs) for part in parts]
        lost = notes["lost"]
        arrays = {name: np.stack([piece[name] for piece in found]) for name in KEPT}
        return cls(
            truth=truth,
            **arrays,
            filters=tuple(parts),
            labels=tuple(notes["labels"][part] for part in parts),
            gives_up=tuple(bool(notes["gives_up"][part]) for part in parts),
            states=tuple(notes["states"]),
            angles=tuple(notes["angles"]),
            blocks=tuple((name, tuple(states)) for name, states in notes["blocks"]),
            lost_beyond=None if lost is None else (lost[0], lost[1]),
            seed=int(notes["seed"]),
            provenance=tuple(notes["provenance"].items()),
        )

    def errors(self, block: str) -> np.ndarray:
        """Return estimates minus truth of a block in float64, `(filter, run, t, states of the block)`; angles are wrapped.

        Raises:
            MotesError: there is no such block.
        """
        differences = self.estimates - self.truth
        if self.angles:
            differences = np.moveaxis(np.asarray(wrap(jnp.moveaxis(jnp.asarray(differences), -1, 0), self.angles)), 0, -1)
        return differences[..., places(self.states, self.block(block))].astype(np.float64)

    def block(self, name: str) -> tuple[str, ...]:
        """Return the states of a block.

        Raises:
            MotesError: there is no such block.
        """
        known = dict(self.blocks)
        if name not in known:
            checks.refuse("block", "one of " + ", ".join(known), repr(name))
        return known[name]

    def squared_errors(self, block: str) -> np.ndarray:
        """Return the squared 2-norm of the error of a block, `(filter, run, t)`, in squared units of the block."""
        return np.square(self.errors(block)).sum(axis=-1)

    @property
    def lost(self) -> np.ndarray:
        """Which runs are lost, `(filter, run)`: weights vanished, estimates not finite, or final error beyond the rule's limit."""
        lost = ~np.isfinite(self.estimates).all(axis=(2, 3)) | ((self.collapsed >= 0) & np.array(self.gives_up)[:, None])
        if self.lost_beyond is not None:
            block, limit = self.lost_beyond
            lost |= ~(np.sqrt(self.squared_errors(block)[..., -1]) <= limit)
        return lost

    def rmse_over_time(self, block: str) -> np.ndarray:
        """Return the RMSE of a block at each step over the runs that are not lost, `(filter, t)`; NaN where all are."""
        kept = ~self.lost[..., None]
        count = kept.sum(axis=1)
        total = np.where(kept, self.squared_errors(block), 0).sum(axis=1)
        return np.sqrt(np.where(count > 0, total / np.maximum(count, 1), np.nan))

    def bound_over_time(self, block: str, bound: Any) -> np.ndarray:
        """Return what a bound says of the RMSE of a block at each step, `(t,)`: the root of the trace of the block.

        Args:
            block: name of the block.
            bound: with `cov` `(t, x, x)`.

        Raises:
            MotesError: the bound has another shape, or there is no such block.
        """
        _, steps, states = self.truth.shape
        checks.shape("bound.cov", bound.cov, (steps, states, states), "(steps, states, states)")
        variances = np.diagonal(np.asarray(bound.cov, np.float64), axis1=1, axis2=2)
        return np.sqrt(variances[:, places(self.states, self.block(block))].sum(axis=1))

    def table(self, bound: Any = None, seconds: dict[str, float] | None = None) -> Table:
        """Return the table of the study; see `study_table` for its columns.

        Args:
            bound: a bound on the covariance of errors, with `cov` `(t, x, x)`.
            seconds: seconds per step by name of the filter, measured elsewhere.

        Raises:
            MotesError: the bound has another shape, or a name is unknown.
        """
        return study_table(self, bound, seconds)

    def to_xarray(self) -> Any:
        """Return an `xarray.Dataset` with dimensions filter, run, time, state and block; needs the extra `results`."""
        xarray = checks.need("xarray", "results")
        per_run = ("filter", "run")
        data = {
            "truth": (("run", "time", "state"), self.truth),
            "estimates": ((*per_run, "time", "state"), self.estimates),
            "nees": ((*per_run, "time", "block"), self.nees),
        }
        data |= {name: (per_run, getattr(self, name)) for name in ("ess", "log_likelihood", "collapsed", "lost")}
        runs, steps = self.truth.shape[:2]
        coordinates = {"filter": list(self.filters), "run": np.arange(runs), "time": np.arange(steps), "state": list(self.states),
                       "block": [name for name, _ in self.blocks], "label": ("filter", list(self.labels))}
        return xarray.Dataset(data, coords=coordinates, attrs=dict(self.provenance) | {"seed": self.seed})

    def save(self, path: str | Path) -> Path:
        """Write what `to_xarray` gives to a NetCDF file (`.nc`), whole or not at all.

        Raises:
            FileError: the ending is another, or the file cannot be written.
        """
        path = Path(path)
        if path.suffix != ".nc":
            checks.refuse(str(path), "a name that ends in .nc", path.suffix or "no ending", "A table() is saved as csv, md or tex.",
                          checks.FileError)
        return archive.write_dataset(path, self.to_xarray())


def notes_of(experiment: Experiment, engine: str) -> dict[str, Any]:
    """Return what a result tells of its experiment besides numbers, as JSON can hold it."""
    filters = {name: experiment.assumed(name)[0] for name in experiment.filters}
    return {
        "states": list(experiment.model.names),
        "angles": list(experiment.angles),
        "blocks": [[name, list(states)] for name, states in experiment.blocks],
        "lost": experiment.lost,
        "seed": experiment.seed,
        "gives_up": {name: filter.on_collapse == "raise" for name, filter in filters.items()},
        "provenance": archive.provenance() | {"engine": engine},
    }


def _unbroken(blocks: list[tuple[int, int]]) -> int:
    """Return how many runs from the first on there are."""
    have = 0
    for start, stop in blocks:
        if start > have:
            break
        have = stop
    return have


def _joined(kept: Store | Memory, part: str, runs: int) -> dict[str, np.ndarray]:
    pieces = [kept.get(part, start, stop) for start, stop in kept.done(part) if start < runs]
    return {name: np.concatenate([piece[name] for piece in pieces])[:runs] for name in pieces[0]}
