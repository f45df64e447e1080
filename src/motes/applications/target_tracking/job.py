"""The tracker as an application: `motes demo notch`, and `motes run`, `motes plan` and `motes study` of its settings."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np

from motes.applications.interface import Job, Score, with_cloud
from motes.applications.target_tracking import scans as reading
from motes.applications.target_tracking.model import Motion, jumping, scanned
from motes.applications.target_tracking.settings import Radar, Settings
from motes.applications.target_tracking.world import World, made_up, range_rate
from motes.core import checks
from motes.core.record import replace as with_policy
from motes.filters.history import History
from motes.filters.particle import ParticleFilter
from motes.filters.run import run
from motes.io.result_table import Table
from motes.laws.cluttered import room_for
from motes.laws.gaussian import Gaussian
from motes.laws.scans import plots
from motes.models.state_space import StateSpaceModel

LOST = 1e3
"""A track is lost when it is further off at a scan in which the radar is not blind to the target, meters."""
PLOTS, TRUTH = "plots.csv", "truth.csv"


def load(settings: Settings, seed: int) -> "TrackingJob":
    """Read the plots that the settings name, or make a flight up, and begin a track.

    Args:
        settings: of the application.
        seed: of a flight that is made up.

    Raises:
        FileError: a file cannot be used.
        MotesError: a setting cannot be used, or no track begins.
    """
    radar = settings.radar
    for name in ("distance", "azimuth", "rate", "edge", "false", "farthest", "fastest"):
        checks.above_zero(f"radar {name}", getattr(radar, name))
    checks.above_zero("radar detection", radar.detection, 1)
    world = None if settings.data else made_up(seed, settings.scans, settings.period, radar)
    if world is None:
        times, scans = reading.read_scans(settings.data, settings.period)
        truth = reading.read_truth(settings.truth, times) if settings.truth else None
    else:
        times, scans, truth = world.times, world.scans, world.states
    begin = reading.begun(times, scans, radar)
    if begin.scan == len(scans) - 1:
        checks.refuse("data", "scans after those with which a track begins", f"none after {len(scans)}")
    left = slice(begin.scan, None)
    # the plots that the track begins with are in its first law
    ys = plots([None, *scans[left][1:]])
    room = max(len(scan) for scan in scans) + 1
    dt = np.diff(times[left], prepend=times[begin.scan])
    return TrackingJob(
        model=tracker(begin, radar, room).as_state_space(), unaware=tracker(begin, radar, room, knows=False).as_state_space(),
        ys=ys, inputs={"dt": jnp.asarray(dt, float)}, truth=None if truth is None else truth[left], times=times[left] - times[0],
        radar=radar, world=world, filters={"particle": ParticleFilter(n=2_000)}, keep=with_cloud, counted=("east", "north"), seed=seed,
    )  # fmt: skip


def tracker(begin: reading.Beginning, radar: Radar, room: int, knows: bool = True) -> Any:
    """Build the jump-Markov model of a track that has begun; `scanned` says what room and knows are."""
    return jumping(Gaussian(begin.mean, begin.cov), Motion(), scanned(radar, max(room, room_for(radar.false)), knows))


@dataclass(frozen=True, eq=False, kw_only=True)
class TrackingJob(Job):
    """A target that a radar follows.

    Attributes:
        radar: its numbers.
        unaware: the same model with a detection that is the same everywhere.
        world: what was made up, or None.
        seed: of the run of the unaware tracker.
    """

    radar: Radar
    unaware: StateSpaceModel
    world: World | None
    seed: int

    @cached_property
    def hidden(self) -> np.ndarray:
        """Whether the radar is blind to the target, `(t,)`, where the truth is known."""
        return np.abs(range_rate(np.asarray(self.truth))) < self.radar.notch

    @cached_property
    def without(self) -> History:
        """What the first filter finds that takes the detection to be the same everywhere."""
        # a tracker that is sure of the wrong place may find a scan that it holds for impossible
        filter = with_policy(next(iter(self.filters.values())), on_collapse="predict")
        return run(self.seed, filter, self.unaware, self.ys, self.inputs, keep=self.keep)

    def about(self) -> str:
        """Tell of scans and plots."""
        scans = np.asarray(self.ys.value)[np.asarray(self.ys.there)]
        count = (~np.isnan(scans).all(axis=2)).sum()
        return f"{len(scans)} scans with {count / max(1, len(scans)):.1f} plots each; the track begins at {self.times[0]:g} s."

    def title(self, steps: int) -> str:
        """Return how many scans there were, and in how many the radar was blind."""
        if self.truth is None:
            return f"{steps} scans"
        return f"{steps} scans, in {int(self.hidden.sum())} of which the radar is blind to the target; errors of the position"

    def scores(self, history: History) -> tuple[Score, ...]:
        """Judge a run by the true path."""
        if self.truth is None:
            return ()
        error, known = self.errors(history), ~np.isnan(np.asarray(self.truth)).any(axis=1)

        def rms(rows: np.ndarray) -> float | None:
            return float(np.sqrt(np.mean(error[rows] ** 2))) if rows.any() else None

        seen = known & ~self.hidden
        return (Score("while hidden", rms(known & self.hidden), "m", 0), Score("else", rms(seen), "m", 0),
                Score("worst", float(np.max(error[seen], initial=0)), "m", 0))  # fmt: skip

    def errors(self, history: History) -> np.ndarray:
        """Distance from the true place, `(t,)`."""
        return np.hypot(*(np.asarray(history.mean)[:, :2] - np.asarray(self.truth)[:, :2]).T)

    def verdict(self, history: History) -> str:
        """Tell what knowing the notch is worth."""
        if self.truth is None or not self.hidden.any():
            return ""
        found = [self.scores(one) for one in (history, self.without)]
        said = [f"{scores[0].value:.0f} m off while hidden, {'lost' if (scores[2].value or 0) > LOST else 'not lost'}" for scores in found]
        return (f"The radar hears nothing of a target whose range rate is below {self.radar.notch:g} m/s. "
                f"A tracker that knows it: {said[0]}. One that expects {self.radar.detection:g} everywhere: {said[1]}.")  # fmt: skip

    def pictures(self, histories: Mapping[str, History]) -> dict[str, Any]:
        """Draw the plane, range rate and errors, once as a picture and once as an animation."""
        from motes.applications.target_tracking.pictures import track_animation, track_figure

        history = next(iter(histories.values()))
        return {"track.png": track_figure(history, self), "track.gif": track_animation(history, self)}

    def written(self, folder: Path, settings: Settings) -> Settings:
        """Write scans and truth of a flight that was made up."""
        if self.world is None:
            return settings
        reading.written_scans(folder / PLOTS, self.world.times, self.world.scans)
        rows = np.column_stack([self.world.times, self.world.states])
        Table(reading.STATE, tuple(map(tuple, rows.tolist()))).save(folder / TRUTH)
        return replace(settings, data=str(folder / PLOTS), truth=str(folder / TRUTH), period=0.0)
