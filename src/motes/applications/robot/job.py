"""The robot among beacons as an application: `motes demo robot`, and `motes run`, `motes plan` and `motes study` of its settings."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np

from motes.applications.interface import Job, Score
from motes.applications.robot import scenario
from motes.applications.robot.bag import read_recording
from motes.applications.robot.kidnapping import recovering
from motes.applications.robot.pictures import robot_figure
from motes.applications.robot.settings import Settings
from motes.applications.robot.world import simulated
from motes.core.findings import Diagnosis
from motes.filters.history import History
from motes.filters.interface import Filter
from motes.filters.marginalized import MarginalizedParticleFilter
from motes.io.recordings import write_plaza
from motes.plotting.plot import plot
from motes.report.scene import Marks, Scene

FILE = "recording.mat"
ROOM = 5.0
"""Meters about way and beacons that a page shows."""


def load(settings: Settings, seed: int) -> "RobotJob":
    """Read the recording that the settings name, or make one up.

    Args:
        settings: of the application.
        seed: of a recording that is made up.

    Raises:
        FileError: the file cannot be used.
        MotesError: a setting cannot be used.
    """
    recording = read_recording(settings.data, settings.topics, settings.units) if settings.data else simulated(seed, settings.seconds)
    made = scenario.of_recording(recording, settings.odometry, settings.outliers, settings.start, settings.kidnap)
    usual: Filter = MarginalizedParticleFilter(n=1_000, linear=("scale", "offset"))
    return RobotJob(
        model=made.model, ys=jnp.asarray(made.ys), inputs=made.inputs, times=made.times, scenario=made, recording=recording,
        filters={"recovering": recovering(made.beacons, len(made.model.names))} if settings.kidnap else {"marginalized": usual},
        counted=("px", "py"), blocks={"position": ("px", "py")}, start=recording.start,
    )  # fmt: skip


@dataclass(frozen=True, eq=False, kw_only=True)
class RobotJob(Job):
    """A robot's way; errors are distances from the true place.

    Attributes:
        scenario: what the filter gets, and the truth.
        recording: what it was made of.
    """

    scenario: scenario.Scenario
    recording: Any

    def title(self, steps: int) -> str:
        """Return the length of the way, and how good the odometry is alone."""
        apart = self.scenario.dead_reckoning - self.scenario.truth[:, :2]
        alone = float((apart**2).sum(axis=1).mean() ** 0.5)
        return f"{steps} steps over {self.scenario.times[-1]:.0f} s; position errors (by odometry alone {alone:.2f} m)"

    def scores(self, history: History) -> tuple[Score, ...]:
        """Judge a run by the true way."""
        found = scenario.score(history, self.scenario)
        numbers = (("rms", found.rms, "m", 2), ("worst", found.worst, "m", 2), ("final", found.final, "m", 2),
                   ("scale", found.scale, "", 4), ("scale sd", found.scale_sd, "", 4))  # fmt: skip
        told = tuple(Score(name, float(value), unit, digits) for name, value, unit, digits in numbers)
        if not self.scenario.kidnapped:
            return told
        seconds, rms = scenario.found_again(history, self.scenario)
        lost = seconds == float("inf")
        again = (("found again after", seconds, "s", 1), ("rms from then on", rms, "m", 2))
        return (*told, *(Score(name, None if lost else value, unit, digits) for name, value, unit, digits in again))

    def verdict(self, history: History) -> str:
        """Say nothing: the table tells all."""
        return ""

    def diagnosed(self, history: History) -> Diagnosis:
        """Judge by what else is known of the radios."""
        return scenario.diagnosed(history, self.scenario)

    def scene(self) -> Scene:
        """Return the plane with the beacons."""
        made, names = self.scenario, tuple(self.model.names)
        truth = np.full((len(made.times), len(names)), np.nan)
        truth[made.scored, :3] = made.truth
        around = np.concatenate([made.truth[:, :2], made.beacons])
        low, high = np.nanmin(around, axis=0) - ROOM, np.nanmax(around, axis=0) + ROOM
        return Scene(names=names, units=("m", "m", "rad"), truth=truth, angles=tuple(self.model.circular), title="Robot",
                     extent=(low[0], high[0], low[1], high[1]), marks=(Marks("beacon", made.beacons),))  # fmt: skip

    def pictures(self, histories: Mapping[str, History]) -> dict[str, Any]:
        """Draw the way with its errors and the scale, and the states."""
        history = next(iter(histories.values()))
        return {"robot.png": robot_figure(history, self.scenario), "states.png": plot(history)}

    def written(self, folder: Path, settings: Settings) -> Settings:
        """Write a recording that was made up, in the form of the real ones."""
        if settings.data:
            return settings
        write_plaza(folder / FILE, self.recording)
        return replace(settings, data=str(folder / FILE))
