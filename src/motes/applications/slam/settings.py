"""What a user can set of the job of a robot without a map."""

from dataclasses import dataclass, field
from typing import Literal

from motes.applications.robot.settings import Topics


@dataclass(frozen=True)
class Settings:
    """Locate a robot and map its landmarks at once (SLAM), nothing of either known.

    Attributes:
        data: a recording of ranges to beacons in MATLAB's format, such as Plaza1_.mat (Djugash, Hamner, Roth 2009), or a text file of lines
            "ODOMETRY i j dx dy dtheta ..." and "LANDMARK i k x y ...", such as victoria_park.txt; both come with gtsam, in gtsam/Data.
            Or a bag (rosbag 1 or 2) of odometry and ranges, with the names of its topics in topics. One is made up where no file is named.
        topics: what is where in a bag.
        units: of what a recording in MATLAB's format has in others than seconds, meters and radians, as in range = "ft": of time, place,
            heading, forward, turn, range.
        seconds: how long a robot that is made up drives, at least 60.
        sights: what a robot that is made up measures: "ranges" to beacons, or "places" of objects, seen from it.
        gaussians: of which the law of a beacon is made at its first range, evenly on the ring.
        scale: standard deviation of the scale error of ranges, as a share.
    """

    data: str = field(default="", metadata={"path": True})
    topics: Topics = Topics()
    units: dict[str, str] = field(default_factory=dict)
    seconds: float = 600.0
    sights: Literal["ranges", "places"] = "ranges"
    gaussians: int = 24
    scale: float = 0.1
