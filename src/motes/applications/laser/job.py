"""The robot with a laser as an application: `motes demo laser`, and `motes run` of its settings."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np

from motes.applications.interface import Job, Score, with_cloud
from motes.applications.laser.grid import Grid, read_grid, write_grid
from motes.applications.laser.model import LikelihoodField, laser_model, poses_of, seeking, usual
from motes.applications.laser.pictures import building_animation, building_figure, floor
from motes.applications.laser.scans import Scans, check_reach, read_scan_topics, read_scans, write_scans
from motes.applications.laser.settings import Settings
from motes.applications.laser.world import driven
from motes.applications.robot.kidnapping import found_after
from motes.core import checks
from motes.filters.adaptive_size import AdaptiveSize
from motes.filters.history import History
from motes.filters.particle import ParticleFilter
from motes.filters.recovering import Recovering
from motes.io.bags import is_bag
from motes.report.scene import Scene

MAP, SCANS = "map.yaml", "scans.csv"
SIZES, CELLS = (2_000, 10_000, 50_000), (0.5, 0.5, 0.2)
"""Numbers of particles, by how many cells of so many meters and radians they lie in."""
FAST = 0.3
"""Share of the present evidence in its fast mean: a scan tells much."""


def load(settings: Settings, seed: int) -> "LaserJob":
    """Read map and scans that the settings name, or make both up.

    Raises:
        FileError: a file cannot be used.
        MotesError: a setting cannot be used, or only one of the two files is named.
    """
    file = settings.data.file
    if bool(settings.map) != bool(file):
        checks.refuse("map, data", "both or none", "data alone" if file else "map alone", "Name the other file.")
    if file:
        grid = read_grid(settings.map)
        scans = read_scan_topics(file, settings.topics) if is_bag(file) else read_scans(file, settings.data)
        check_reach(file[-160:], scans, grid.resolution * float(np.hypot(*grid.occupied.shape)), settings.data.units)
    else:
        grid, scans = driven(seed, settings.seconds, settings.kidnap, settings.outliers)
    inputs = {"forward": jnp.asarray(scans.forward, float), "turn": jnp.asarray(scans.turn, float)}
    field, poses = LikelihoodField.of(grid, scans.bearings), poses_of(grid)
    recovering = Recovering(ParticleFilter(n=SIZES[-1], on_collapse="predict"), seeking(field, poses), fast=FAST, usual=usual)
    return LaserJob(
        model=laser_model(field, poses), ys=jnp.asarray(scans.ranges, float), inputs=inputs, truth=scans.poses,
        times=scans.times, filters={"recovering": AdaptiveSize(recovering, SIZES, CELLS)},
        keep=with_cloud, counted=("px", "py"), grid=grid, scans=scans, kidnap=0.0 if file else settings.kidnap,
        start=scans.start, clock=scans.clock,
    )  # fmt: skip


@dataclass(frozen=True, eq=False, kw_only=True)
class LaserJob(Job):
    """A robot in a building.

    Attributes:
        grid: the map.
        scans: what was measured.
        kidnap: seconds after which the robot is carried elsewhere; 0 for never, or where nobody says.
    """

    grid: Grid
    scans: Scans
    kidnap: float

    def errors(self, history: History) -> np.ndarray:
        """Distance of the estimated from the true place, `(t,)`, meters."""
        return np.hypot(*(np.asarray(history.mean, np.float64)[:, :2] - np.asarray(self.truth)[:, :2]).T)

    def scores(self, history: History) -> tuple[Score, ...]:
        """Judge a run: when the robot is found, and the error from then on; the same after a kidnapping."""
        if self.truth is None:
            return ()
        error, at = self.errors(history), int(np.searchsorted(self.times, self.kidnap)) if self.kidnap else len(self.times)
        told: list[Score] = []
        for begin, end, what in ((0, at, "found"), (at, len(self.times), "found again")):
            if begin < end:
                seconds = found_after(self.times[:end], error[:end], begin)
                later = error[begin:end][self.times[begin:end] >= self.times[begin] + seconds]
                none = not np.isfinite(seconds)
                told += [Score(f"{what} after", None if none else seconds, "s", 1),
                         Score(f"rms once {what}", None if none else float(np.sqrt(np.mean(later**2))), "m")]  # fmt: skip
        return tuple(told)

    def verdict(self, history: History) -> str:
        """Say how many clusters the last law has, and whether to trust the run."""
        weights = np.asarray(history.state.law.modes(8).weight)
        return f"At the end the robot is in one of {int((weights > 0.05).sum())} clusters. {history}"

    def scene(self) -> Scene:
        """Return the floor of the building."""
        picture, extent = floor(self.grid)
        return Scene(names=tuple(self.model.names), units=("m", "m", "rad"), picture=picture, extent=extent, title="Laser",
                     truth=None if self.truth is None else np.asarray(self.truth), angles=tuple(self.model.circular))  # fmt: skip

    def pictures(self, histories: Mapping[str, History]) -> dict[str, Any]:
        """Draw the building with the way, and the particles in motion."""
        history = next(iter(histories.values()))
        return {"laser.png": building_figure(history, self), "laser.gif": building_animation(history, self)}

    def written(self, folder: Path, settings: Settings) -> Settings:
        """Write a map and scans that were made up."""
        if settings.data.file:
            return settings
        write_grid(folder / MAP, self.grid)
        write_scans(folder / SCANS, self.scans)
        return replace(settings, map=str(folder / MAP), data=replace(settings.data, file=str(folder / SCANS)))
