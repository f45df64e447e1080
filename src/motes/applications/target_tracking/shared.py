"""What a job of one target and a job of several share: the radar, and files as a user's own would come."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from motes.applications.interface import Job
from motes.applications.target_tracking import scans as reading
from motes.applications.target_tracking.settings import Radar, Settings
from motes.applications.target_tracking.world import World
from motes.io.dialect import TableFile

LOST = 1e3
"""A track is lost when it is further off at a scan in which the radar is not blind to the target, meters."""
PLOTS, TRUTH = "plots.csv", "truth.csv"


@dataclass(frozen=True, eq=False, kw_only=True)
class RadarJob(Job):
    """Scans of a radar.

    Attributes:
        radar: its numbers.
        world: what was made up or drawn along a recording, or None.
        seed: of the run.
        data: how the user's table is written.
    """

    radar: Radar
    world: World | None
    seed: int
    data: TableFile

    def about(self) -> str:
        """Tell of scans and plots."""
        scans = np.asarray(self.ys.value)[np.asarray(self.ys.there)]
        count = (~np.isnan(scans).all(axis=2)).sum()
        return f"{len(scans)} scans with {count / max(1, len(scans)):.1f} plots each"

    def written(self, folder: Path, settings: Settings) -> Settings:
        """Write scans and truth of what was made up or drawn along a recording."""
        if self.world is None:
            return settings
        reading.written_scans(folder / PLOTS, self.world.times, self.world.scans)
        reading.written_truth(folder / TRUTH, self.world)
        files = {"data": TableFile(file=str(folder / PLOTS)), "truth": str(folder / TRUTH)}
        return replace(settings, **files, targets=len(self.world.names), period=0.0)
