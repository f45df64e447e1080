"""What a user can set of the robot's job."""

from dataclasses import dataclass, field
from typing import Literal


@dataclass(frozen=True)
class Topics:
    """Where a bag has what a robot among beacons measured, and where it was.

    Attributes:
        odometry: topic of nav_msgs/Odometry or of poses by odometry.
        truth: topic of true poses, of the same types; what was measured outside of its times is left out.
        beacons: table with the columns topic, x and y (m): for each beacon the topic of its ranges, sensor_msgs/Range, and its place.
    """

    odometry: str = "/odom"
    truth: str = "/ground_truth"
    beacons: str = field(default="", metadata={"path": True})


@dataclass(frozen=True)
class Settings:
    """Locate a robot by ranges to four beacons.

    Attributes:
        data: a recording in MATLAB's format, such as Plaza1_.mat of the range-only data sets of Djugash, Hamner, Roth (2009), which comes
            with gtsam, in gtsam/Data; or a bag (rosbag 1 or 2), with the names of its topics in topics. One is made up where no file is
            named.
        topics: what is where in a bag.
        units: of what a recording in MATLAB's format has in others than seconds, meters and radians, as in range = "ft": of time, place,
            heading, forward, turn, range.
        seconds: how long a robot that is made up drives, at least 60.
        odometry: "recorded" as in the file, or "drifting": turns from the drifting path, 20 m off on their own.
        outliers: share of ranges that may be far off, such as 0.1; 0 for Gaussian errors.
        start: "known", or "unknown": sought by the first ranges, and scored two minutes later; take 5 000 particles.
        kidnap: seconds after which the robot is carried 31 m away without knowing it (a part of the way is cut out); 0 for never.
    """

    data: str = field(default="", metadata={"path": True})
    topics: Topics = Topics()
    units: dict[str, str] = field(default_factory=dict)
    seconds: float = 600.0
    odometry: Literal["recorded", "drifting"] = "recorded"
    outliers: float = 0.0
    start: Literal["known", "unknown"] = "known"
    kidnap: float = 0.0
