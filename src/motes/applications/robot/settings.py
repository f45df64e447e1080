"""What a user can set of the robot's job."""

from dataclasses import dataclass, field
from typing import Literal


@dataclass(frozen=True)
class Settings:
    """Locate a robot by ranges to four beacons.

    Attributes:
        data: a recording in MATLAB's format, such as Plaza1_.mat of the range-only data sets of Djugash, Hamner, Roth (2009), which comes
            with gtsam, in gtsam/Data; one is made up where no file is named.
        seconds: how long a robot that is made up drives, at least 60.
        odometry: "recorded" as in the file, or "drifting": turns from the drifting path, 20 m off on their own.
        outliers: share of ranges that may be far off, such as 0.1; 0 for Gaussian errors.
        start: "known", or "unknown": sought by the first ranges, and scored two minutes later; take 5 000 particles.
        kidnap: seconds after which the robot is carried 31 m away without knowing it (a part of the way is cut out); 0 for never.
    """

    data: str = field(default="", metadata={"path": True})
    seconds: float = 600.0
    odometry: Literal["recorded", "drifting"] = "recorded"
    outliers: float = 0.0
    start: Literal["known", "unknown"] = "known"
    kidnap: float = 0.0
