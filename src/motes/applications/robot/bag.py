"""Recordings of ranges to beacons in bags."""

import os
from collections.abc import Mapping

import numpy as np

from motes.applications.plausible import check_milliseconds, check_ratio
from motes.applications.robot.scenario import moves
from motes.applications.robot.settings import Topics
from motes.core import checks
from motes.io.bags import is_bag, read_bag
from motes.io.files import label, reject
from motes.io.messages import POSES
from motes.io.recordings import RangeOnlyRecording, read_plaza
from motes.io.tables import read_table

RANGE = "sensor_msgs/Range"
SLOWEST = 0.01
"""A robot that is slower than this for most of its way, in m/s, has times in other units."""
FEWEST = 20
"""Ranges, and steps in which it moved, from which on units are judged."""


def read_recording(path: str | os.PathLike[str], topics: Topics, units: Mapping[str, str] | None = None) -> RangeOnlyRecording:
    """Read a recording of ranges to beacons from a bag, or from a MATLAB file of the Plaza form.

    Args:
        path: of either.
        topics: of a bag.
        units: of a MATLAB file, see `read_plaza`.

    Raises:
        FileError: it cannot be used; the message names the topic or the variable; or its truth tells that units are others.
        MotesError: no table of beacons is named beside a bag, or there is no such unit.
    """
    if is_bag(path):
        if units:
            checks.refuse("units", "none of a bag, whose messages have theirs", ", ".join(units)[:80])
        return _of_bag(path, topics)
    found = read_plaza(path, units)
    check_agrees(found, units or {})
    return found


def check_agrees(recording: RangeOnlyRecording, units: Mapping[str, str]) -> None:
    """Refuse a recording whose numbers contradict its truth, where another unit makes them agree with it.

    Raises:
        FileError: naming the quantity, with the line of TOML that mends it.
    """
    truth, (_, forward, turn) = recording.truth, recording.odometry.T
    way = np.hypot(*np.diff(truth[:, 1:3], axis=0).T)
    if "time" not in units:
        check_milliseconds(recording.source, "time", truth[:, 0], way, SLOWEST, "")
    place = np.argmax(recording.ranges[:, 1, None] == recording.beacons[None, :, 0], axis=1)
    at = np.stack([np.interp(recording.ranges[:, 0], truth[:, 0], axis) for axis in truth[:, 1:3].T], axis=1)
    true = np.hypot(*(at - recording.beacons[place, 1:3]).T)
    given = recording.ranges[:, 2]
    far = (true > 0) & (given > 0)
    if far.sum() >= FEWEST:
        check_ratio(recording.source, "ranges that agree with the truth", float(np.median(given[far] / true[far])), {"range": "m"},
                    ("ft", "km", "cm", "mm"), "")  # fmt: skip
    if (way > 0).sum() >= FEWEST and forward.any():
        ratio = float(np.abs(forward).sum() / way.sum())
        check_ratio(recording.source, "odometry that agrees with the truth", ratio, {"forward": "m"}, ("ft", "cm", "mm", "km"), "")
    turned = float(np.abs(np.angle(np.exp(1j * np.diff(truth[:, 3])))).sum())
    if turned > 1:
        ratio = float(np.abs(turn).sum()) / turned
        check_ratio(recording.source, "turns that agree with the true heading", ratio, {"turn": "rad"}, ("deg",), "")


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
    bag = read_bag(path, wanted | heard, dict.fromkeys(wanted, POSES) | dict.fromkeys(heard, (RANGE,)))
    found = bag.topics
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
    begin, seconds = bag.start + float(seconds[0]), seconds - seconds[0]
    beacons = np.column_stack([np.arange(1.0, len(places) + 1), places])
    odometry = np.column_stack([seconds[1:], *moves(poses)])
    return RangeOnlyRecording(np.column_stack([seconds, truth]), odometry, poses[:, :2], ranges, beacons, label(path), begin)
