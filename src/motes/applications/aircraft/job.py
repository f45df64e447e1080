"""The airliner as an application: `motes demo aircraft`, and `motes run`, `motes plan` and `motes study` of its settings."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from motes.applications.aircraft import scenario
from motes.applications.aircraft.model import Flight, Radar, jumping
from motes.applications.aircraft.pictures import plane, track_figure
from motes.applications.aircraft.reports import REPORT, Reports
from motes.applications.aircraft.settings import Settings
from motes.applications.aircraft.world import flown_reports
from motes.applications.interface import Job, Score
from motes.core import checks
from motes.filters import keep
from motes.filters.frames import deviations
from motes.filters.history import History
from motes.filters.interacting_multiple_model import InteractingMultipleModel
from motes.filters.jump_markov import JumpMarkovFilter
from motes.io.dialect import NamedDialect
from motes.io.named_tables import own_unit
from motes.io.result_table import Table
from motes.io.units import back_to
from motes.laws.observed import value_of
from motes.plotting.plot import plot
from motes.report.scene import Scene

FILE = "reports.csv"


def load(settings: Settings, seed: int) -> "AircraftJob":
    """Read the recording that the settings name, or make a flight up, and draw radar plots along it.

    Args:
        settings: of the application.
        seed: of the plots, and of a flight that is made up.

    Raises:
        FileError: the file cannot be used.
        MotesError: a setting cannot be used.
    """
    for name in ("distance", "azimuth", "farthest"):
        checks.above_zero(f"plots {name}", getattr(settings.plots, name))
    asked = settings.plots
    checks.above_zero("plots detection", asked.detection, 1)
    if not 0 <= asked.false < 1_000:
        checks.refuse("plots false", "a number of false plots from 0 to 1000", asked.false)
    site = (settings.site.east, settings.site.north)
    radar = Radar(asked.distance, asked.azimuth, asked.detection, asked.false, asked.farthest)
    reports = None if settings.data.file else flown_reports(seed, settings.duration)
    if reports is None:
        path = scenario.read_path(settings.data.file, settings.begin, settings.duration, site, settings.aircraft, settings.data)
    else:
        path = scenario.path_of(reports, site)
    track = scenario.track(path, seed, settings.plots.steps, radar)
    times = np.cumsum(np.asarray(track.dt, np.float64))
    # beyond the end of the flight there is neither plot nor truth
    flown = times <= path.times[-1] - times[0]
    kept = ("ys", "dt", "truth", "scored")
    track = replace(track, **{name: jax.tree.map(lambda leaf: leaf[flown], getattr(track, name)) for name in kept})
    return AircraftJob(
        model=jumping(track.start, Flight(), radar), ys=jax.tree.map(jnp.asarray, track.ys), inputs=jnp.asarray(track.dt),
        plots=track, path=path, reports=reports, times=times[flown], start=path.start, clock=path.clock, keep=keep.modes,
        data=settings.data,
        filters={"jump_markov": JumpMarkovFilter(n=200, sampled=("turn",)), "interacting": InteractingMultipleModel()},
        counted=("east", "north"), blocks={"position": ("east", "north"), "velocity": ("v_east", "v_north")},
        lost=("position", scenario.LOST),
    )  # fmt: skip


@dataclass(frozen=True, eq=False, kw_only=True)
class AircraftJob(Job):
    """A flight seen by radar.

    Attributes:
        plots: what the tracker gets, and the truth.
        path: that was flown.
        reports: those of a flight that was made up; otherwise None.
        data: how the recording is written.
    """

    plots: scenario.Track
    path: scenario.Path
    reports: Reports | None
    data: NamedDialect

    def title(self, steps: int) -> str:
        """Return how many plots there were."""
        seen = int((~np.isnan(np.asarray(value_of(self.ys))).any(axis=-1)).sum())
        return f"{seen} plots in {steps} steps over {self.times[-1]:.0f} s; errors at the plots after the first {scenario.UNSCORED}"

    def scores(self, history: History) -> tuple[Score, ...]:
        """Judge a run by the true path."""
        found = scenario.score(jnp.asarray(history.mean), self.plots)
        return (Score("position", float(found.position), "m", 1), Score("velocity", float(found.velocity), "m/s", 2),
                Score("worst", float(found.worst), "m", 0))  # fmt: skip

    def verdict(self, history: History) -> str:
        """Say nothing: the table tells all."""
        return ""

    def track(self, history: History) -> Table:
        """Return the places that a run found as the recording tells them; standard deviations in meters."""
        east, north = np.asarray(history.mean, np.float64)[:, :2].T
        places = dict(zip(("latitude", "longitude"), self.path.placed(east, north), strict=True))
        spreads = deviations(np.asarray(history.cov, np.float64))
        places = {name: back_to(place, own_unit(self.data, name), "deg") for name, place in places.items()}
        return self.way(history, places, {"east, m": spreads[:, 0], "north, m": spreads[:, 1]})

    def scene(self) -> Scene:
        """Return the plane in kilometers, with the radar; the states can be chosen, too."""
        return plane(tuple(self.model.names), np.asarray(self.plots.truth), "Aircraft")

    def pictures(self, histories: Mapping[str, History]) -> dict[str, Any]:
        """Draw the plane with error and turns, and the states."""
        history = next(iter(histories.values()))
        return {"track.png": track_figure(history, self.plots), "states.png": plot(history)}

    def written(self, folder: Path, settings: Settings) -> Settings:
        """Write the reports of a flight that was made up."""
        if self.reports is None:
            return settings
        Table(REPORT, tuple(map(tuple, np.stack(self.reports, axis=1).tolist()))).save(folder / FILE)
        return replace(settings, data=replace(settings.data, file=str(folder / FILE)))
