"""What a user can set of the job of a robot with a laser."""

from dataclasses import dataclass, field

from motes.io.dialect import TableFile


@dataclass(frozen=True)
class Topics:
    """Where a bag has what a robot with a laser measured.

    Attributes:
        scan: topic of scans, sensor_msgs/LaserScan, whose laser is where the odometry is and looks ahead.
        odometry: topic of nav_msgs/Odometry or of poses by odometry; scans are used from its first to its last message.
        truth: topic of true poses, of the same types, or "" where there is none; scans outside of its times are left out.
        beams: how many beams of a scan are used at most, evenly spread.
    """

    scan: str = "/scan"
    odometry: str = "/odom"
    truth: str = ""
    beams: int = 24


@dataclass(frozen=True)
class Settings:
    """Locate a robot on a map of a building by the scans of a laser, from a start that it does not know.

    Attributes:
        map: YAML file of an occupancy grid: image (PNG), resolution, origin, occupied_thresh, free_thresh, negate. A building is made up
            where no file is named.
        data: scans, a table with the columns time (s), forward (m) and turn (radians) of the step that ends then, and range_0, range_1, ...
            (m), at even bearings from the heading on, counterclockwise, empty where nothing came back; x, y, heading where they are known.
            Or a bag (rosbag 1 or 2), with the names of its topics in topics.
        topics: what is where in a bag.
        seconds: how long a robot that is made up drives, at least 60.
        kidnap: seconds after which a robot that is made up is carried elsewhere without knowing it; 0 for never.
        outliers: share of the beams of a robot that is made up that hit what is not on the map.
    """

    map: str = field(default="", metadata={"path": True})
    data: TableFile = TableFile()
    topics: Topics = Topics()
    seconds: float = 200.0
    kidnap: float = 0.0
    outliers: float = 0.0
