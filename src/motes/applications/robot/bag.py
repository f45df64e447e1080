"""Recordings of ranges to beacons in bags."""

import os

import numpy as np

from motes.applications.robot.scenario import moves
from motes.applications.robot.settings import Topics
from motes.core import checks
from motes.io.bags import is_bag, read_bag
from motes.io.files import label, reject
from motes.io.messages import POSES
from motes.io.recordings import RangeOnlyRecording, read_plaza
from motes.io.tables import read_table

RANGE = "sensor_msgs/Range"


def read_recording(path: str | os.PathLike[str], topics: Topics) -> RangeOnlyRecording:
    """Read a recording of ranges to beacons from a bag, or from a MATLAB file of the Plaza form.

    Args:
        path: of either.
        topics: of a bag.

    Raises:
        FileError: it cannot be used; the message names the topic or the variable.
        MotesError: no table of beacons is named beside a bag.
    """
    return _of_bag(path, topics) if is_bag(path) else read_plaza(path)


def _of_bag(path: str | os.PathLike[str], topics: Topics) -> RangeOnlyRecording:
    if not topics.beacons:
        checks.refuse("topics.beacons", "a table of topic, x and y of each beacon", "none", "Give --topics.beacons FILE.")
    table = read_table(topics.beacons, ("x", "y"), ("topic",))
    if "topic" not in table:
        reject(topics.beacons, "a column 'topic'", "x and y alone")
    places = np.stack([table["x"], table["y"]], axis=1)
    if not np.isfinite(places).all():
        reject(topics.beacons, "x and y of each beacon", f"none in {table.place(int(np.argmin(np.isfinite(places).all(axis=1))))}")
    heard = {f"beacon {number}": topic for number, topic in enumerate(table["topic"].tolist(), 1)}
    wanted = {"odometry": topics.odometry, "truth": topics.truth}
    found = read_bag(path, wanted | heard, dict.fromkeys(wanted, POSES) | dict.fromkeys(heard, (RANGE,))).topics
    # the last of messages of one time
    seconds, poses = found["odometry"].seconds, found["odometry"].values
    last = np.append(np.diff(seconds) > 0, True)
    seconds, poses = seconds[last], poses[last]
    truth = found["truth"].at(seconds)
    known = np.isfinite(truth).all(axis=1)
    if known.sum() < 2:
        reject(path, f"messages of {topics.odometry} within the times of {topics.truth}", f"{known.sum()}",
               "Are the clocks of both topics the same?")  # fmt: skip
    seconds, poses, truth = seconds[known], poses[known], truth[known]
    rows = [np.stack([one.seconds, np.full(len(one.seconds), number), one.values], axis=1)
            for number, one in enumerate((found[name] for name in heard), 1)]  # fmt: skip
    ranges = np.concatenate(rows)
    ranges = ranges[np.isfinite(ranges[:, 2]) & (ranges[:, 0] >= seconds[0]) & (ranges[:, 0] <= seconds[-1])]
    if not len(ranges):
        reject(path, "ranges while there are odometry and truth", "none", "Are the clocks of these topics the same?")
    ranges = ranges[np.argsort(ranges[:, 0], kind="stable")]
    ranges[:, 0] -= seconds[0]
    seconds = seconds - seconds[0]
    beacons = np.column_stack([np.arange(1.0, len(places) + 1), places])
    odometry = np.column_stack([seconds[1:], *moves(poses)])
    return RangeOnlyRecording(np.column_stack([seconds, truth]), odometry, poses[:, :2], ranges, beacons, label(path))
