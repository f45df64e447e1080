"""One target that a radar follows, also where it is blind to it."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from motes.applications.aircraft.pictures import plane
from motes.applications.interface import Score
from motes.applications.target_tracking.shared import LOST, RadarJob
from motes.applications.target_tracking.world import range_rate
from motes.core.record import replace as with_policy
from motes.filters.frames import deviations
from motes.filters.history import History
from motes.filters.run import run
from motes.io.named_tables import own_unit
from motes.io.result_table import Table
from motes.io.units import back_to
from motes.models.state_space import StateSpaceModel
from motes.report.scene import Scene


@dataclass(frozen=True, eq=False, kw_only=True)
class TrackingJob(RadarJob):
    """A target that a radar follows.

    Attributes:
        unaware: the same model with a detection that is the same everywhere.
    """

    unaware: StateSpaceModel

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
        """Tell of scans and plots, and when the track begins."""
        return f"{super().about()}; the track begins at {self.times[0]:g} s."

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

    def track(self, history: History) -> Table:
        """Return the places that a run found, also as plots have them; standard deviations in meters."""
        east, north = np.asarray(history.mean, np.float64)[:, :2].T
        polar = {"range": back_to(np.hypot(east, north), own_unit(self.data, "range"), "m"),
                 "azimuth": back_to(np.degrees(np.arctan2(east, north)) % 360, own_unit(self.data, "azimuth"), "deg")}  # fmt: skip
        spreads = deviations(np.asarray(history.cov, np.float64))
        return self.way(history, polar | {"east, m": east, "north, m": north}, {"east, m": spreads[:, 0], "north, m": spreads[:, 1]})

    def scene(self) -> Scene:
        """Return the plane in kilometers, with the radar."""
        return plane(tuple(self.model.names), None if self.truth is None else np.asarray(self.truth), "Radar")

    def pictures(self, histories: Mapping[str, History]) -> dict[str, Any]:
        """Draw the plane, range rate and errors, once as a picture and once as an animation."""
        from motes.applications.target_tracking.pictures import track_animation, track_figure

        history = next(iter(histories.values()))
        return {"track.png": track_figure(history, self), "track.gif": track_animation(history, self)}
