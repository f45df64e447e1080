"""What an application is: a folder here with `settings.py` and `job.py`, found by its name.

`settings.py` has `Settings`, a frozen dataclass whose fields all have defaults: the tables of a TOML file and the flags of a command are
its fields, and their help is its docstring. It imports no JAX, so that `--help` answers at once. `job.py` has `load(settings, seed)`, which
gives a `Job`: it reads the user's files where the settings name some, and otherwise makes a world of its own from the seed.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from motes.core.findings import Diagnosis
from motes.diagnostics.diagnose import diagnose
from motes.filters import frames, notices
from motes.filters import keep as keeping
from motes.filters.data import checked_data, steps_of
from motes.filters.history import History
from motes.filters.interface import Filter
from motes.filters.keep import Keep
from motes.filters.run import run, run_in_chunks
from motes.filters.stream import Stream
from motes.io.clocks import Clock
from motes.io.result_table import Table, track_table
from motes.laws.circular import wrap
from motes.models.interface import Model
from motes.plotting.plot import plot
from motes.report.scene import Scene, scene_of

DRAWN = 200
"""Particles that are kept for pictures."""


class Score(NamedTuple):
    """One number that judges a run.

    Attributes:
        name: such as "final error".
        value: None where there is none.
        unit: such as "m"; "" where it has none.
        digits: after the point, in tables.
    """

    name: str
    value: float | None
    unit: str = ""
    digits: int = 2


class Moment(NamedTuple):
    """What comes in at one step.

    Attributes:
        y: the measurement; None where there is none.
        u: inputs of the step.
        time: seconds; NaN where steps are only numbered.
        picture: what was seen, uint8 `(height, width, 3)`, or None.
    """

    y: Any
    u: Any = None
    time: float = float("nan")
    picture: Any = None


@dataclass(frozen=True, eq=False, kw_only=True)
class Job:
    """A model with its measurements, ready for filters, and what is told of their runs; applications of more to tell derive from it.

    Attributes:
        model: the model.
        ys: measurements, time axis first; None of a job that is only planned or studied. Those that do not fit into memory: a function of a
            step, by default 0, that gives an iterator of the measurements from there on, and prints as what they are.
        inputs: of the model, time axis first; or None.
        truth: true states `(t, x)`, NaN where they are not known; None where none are.
        times: of the steps, seconds since `start`, `(t,)`; None where steps are only numbered.
        start: time 0 of `times` in the user's file, seconds (of dates Unix seconds).
        clock: how the times of the user's file are written.
        filters: those that run where the user names none, by name; the pictures show the first.
        keep: what is kept of each step, with mean and covariance at least.
        counted: states of one unit that a plan counts; all if none is named.
        blocks: states that a study tells errors of together, as in `Experiment`.
        lost: when a study counts a run as lost, as in `Experiment`.
    """

    goes_on: ClassVar[bool] = True
    """Whether a run can go on from a history; not where one piece is all there is."""
    model: Model
    ys: Any = None
    inputs: Any = None
    truth: Any = None
    times: Any = None
    start: float = 0.0
    clock: Clock = Clock()
    filters: Mapping[str, Filter] = field(default_factory=dict)
    keep: Keep = keeping.moments
    counted: tuple[str, ...] = ()
    blocks: Mapping[str, tuple[str, ...]] | None = None
    lost: tuple[str, float] | None = None

    def worn(self, filter: Filter) -> Filter:
        """Return what runs in place of a filter that was named: the filter, with what the job puts around it."""
        return filter

    def pieces(
        self, seed: int, filter: Filter, ys: Any, inputs: Any, keep: Keep, chunk: int, after: History | None = None
    ) -> Iterator[History]:
        """Run a filter, from the end of a history on where one is given; yield the histories of parts of so many steps."""
        return run_in_chunks(seed, filter, self.model, ys, inputs, keep, chunk, after)

    def news(self) -> Callable[[History], Sequence[str]]:
        """Return, for one run, what says of each piece as it comes what is to be said at once; nothing by default."""
        return lambda piece: ()

    def piece(self, seed: int, filter: Filter, ys: Any, keep: Keep, after: History | None) -> History:
        """Run a filter over a piece of measurements that do not fit into memory, from where the piece before ended."""
        return run(seed, filter, self.model, ys, None, keep, after)

    def moments(self) -> Iterator[Moment]:
        """Give what comes in, step by step, for filters that are watched while they work.

        Raises:
            MotesError: the measurements do not fit the model.
        """
        if callable(self.ys):
            yield from map(Moment, self.ys())  # type: ignore[reportArgumentType]
            return
        ys, inputs = jax.tree.map(np.asarray, checked_data(self.model, self.ys, self.inputs))
        for step in range(steps_of(ys)):
            y, u = jax.tree.map(lambda leaf, step=step: leaf[step], (ys, inputs))
            yield Moment(y, u, float("nan") if self.times is None else float(self.times[step]))

    def streamed(self, seed: int, filter: Filter, inputs: Any) -> Stream:
        """Return a filter at work on line, which stands before the first moment.

        Args:
            seed: of the filter.
            filter: the filter.
            inputs: of step 0.
        """
        return Stream(seed, self.worn(filter), self.model, inputs)

    def scene(self) -> Scene:
        """Return where a page draws the law, and what it draws with it; the first two states by default."""
        truth = self.truth if np.shape(self.truth)[1:] == (self.model.size,) else None
        return scene_of(tuple(self.model.names), truth, tuple(self.model.circular))

    def simulated(self) -> Model:
        """Return the model from which plans and studies draw measurements; of one that is not to be planned, refuse in one line."""
        return self.model

    def length(self) -> int | None:
        """Return how many measurements there are of those that come one after the other, as far as is known."""
        return None

    def told(self) -> str:
        """Return what tells its runs from others of the same filter and measurements, so that a killed one goes on from its own alone."""
        return ""

    def about(self) -> str:
        """Return what is to be said before filters run; "" for nothing."""
        return ""

    def title(self, steps: int) -> str:
        """Return what stands over the table of runs."""
        return f"{steps} steps" + ("; errors are root mean squares" if self.truth is not None else "")

    def scores(self, history: History) -> tuple[Score, ...]:
        """Judge a run."""
        if self.truth is None:
            return ()
        errors = np.asarray(wrap((history.mean - jnp.asarray(self.truth)).T, self.model.circular))
        return tuple(Score(f"rms {name}", float(np.sqrt(np.nanmean(errors[place] ** 2))), digits=4)
                     for place, name in enumerate(history.names))  # fmt: skip

    def verdict(self, history: History) -> str:
        """Return what is said of a run after the table; "" for nothing."""
        return str(history)

    def pictures(self, histories: Mapping[str, History]) -> dict[str, Any]:
        """Return matplotlib figures of runs by the name of their file."""
        return {"states.png": plot(next(iter(histories.values())), truth=self.truth)}

    def track(self, history: History) -> Table | None:
        """Return the way that a run found, a row for each step, in the coordinates and times of the user's files; None where there is none.

        Unless an application knows better: means and standard deviations of all states.
        """
        spreads = frames.deviations(np.asarray(history.cov, np.float64))
        return self.way(history, dict(zip(history.names, np.asarray(history.mean, np.float64).T, strict=True)),
                        dict(zip(history.names, spreads.T, strict=True)))  # fmt: skip

    def way(self, history: History, places: Mapping[str, Any], spreads: Mapping[str, Any]) -> Table:
        """Return places `(t,)` and their standard deviations with times as the user writes them, and what is said of each step."""
        return track_table(self.stamps(history), places, spreads, flags(history))

    def stamps(self, history: History) -> tuple[str, list[Any]]:
        """Return the name of the column of times, and the time of each step as the user's file would have it; its number where none is."""
        count = np.shape(history.info.ess)[0]
        if self.times is None:
            return "step", list(range(int(history.start), int(history.start) + count))
        return "time", self.clock.written(self.start + np.asarray(self.times, np.float64)[:count])

    def diagnosed(self, history: History) -> Diagnosis:
        """Judge in words whether a run can be trusted."""
        return diagnose(history)

    def tables(self, history: History) -> dict[str, Table]:
        """Return what is told of a run in tables, by what their files are called after its name."""
        return {}

    def written(self, folder: Path, settings: Any) -> Any:
        """Write what was made up as a user's own files would come, and return the settings that name them by their full paths."""
        return settings


def flags(history: History) -> list[str]:
    """Return what is to be said of each step of a run, in words; "" for nothing."""
    info = history.info
    scarce = np.asarray(history.ess, np.float64) < min(notices.SCARCE, 0.2 * history.particles)
    told = {"collapsed": info.collapsed, "alarm": info.alarm, "gated": np.asarray(info.gated) > 0, "few particles": scarce,
            "recovered": np.asarray(info.recovered) > 0, "off the grid": np.asarray(info.lost) > notices.GONE}  # fmt: skip
    there = np.stack([np.asarray(flag, bool) for flag in told.values()], axis=1)
    return ["; ".join(name for name, is_so in zip(told, row, strict=True) if is_so) for row in there]


def with_cloud(law: Any) -> dict[str, jax.Array]:
    """Keep mean and covariance, and some particles `(x, 200)` evenly along their weights, where the law has some."""
    found = law.weighted_points()
    if found is None:
        return keeping.moments(law)
    points, log_weights = found
    sums = jnp.cumsum(jnp.exp(log_weights))
    places = jnp.searchsorted(sums, (jnp.arange(DRAWN, dtype=sums.dtype) + 0.5) / DRAWN * sums[-1])
    return {**keeping.moments(law), "cloud": points[:, jnp.clip(places, 0, points.shape[1] - 1)]}
