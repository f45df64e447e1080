"""Scans with odometry, as tables and in bags."""

import os
from pathlib import Path
from typing import NamedTuple

import numpy as np

from motes.applications.laser.settings import Topics
from motes.applications.robot.scenario import moves
from motes.core import checks
from motes.io.bags import read_bag
from motes.io.files import reject
from motes.io.messages import POSES
from motes.io.result_table import Table
from motes.io.tables import column_names, read_table

POSE = ("x", "y", "heading")
ROUNDED = 1e-5
"""Radians by which the beams of a whole circle may miss it, by the rounding of 32 bits."""


class Scans(NamedTuple):
    """What a robot measured.

    Attributes:
        times: seconds, `(t,)`.
        forward: meters of the step that ends then, `(t,)`.
        turn: radians of it, `(t,)`.
        ranges: meters, `(t, b)`, NaN where nothing came back.
        bearings: of the beams, radians from the heading on, counterclockwise, `(b,)`.
        poses: true x, y, heading, `(t, 3)`, or None.
    """

    times: np.ndarray
    forward: np.ndarray
    turn: np.ndarray
    ranges: np.ndarray
    bearings: np.ndarray
    poses: np.ndarray | None


def all_around(beams: int) -> np.ndarray:
    """Return even bearings all around, from the heading on, `(beams,)`."""
    return 2 * np.pi * np.arange(beams) / beams


def read_scans(path: str | os.PathLike[str]) -> Scans:
    """Read a table of scans.

    Raises:
        FileError: it cannot be read, lacks a column, or has a value that cannot be.
    """
    names = column_names(path)
    beams = [f"range_{i}" for i in range(sum(name.startswith("range_") for name in names))]
    pose = list(POSE) if set(POSE) <= set(names) else []
    if not beams:
        reject(path, "columns range_0, range_1, ...", ", ".join(names)[:200])
    table = read_table(path, ["time", "forward", "turn", *beams, *pose])
    start, seconds = table.times("time", repeats=False)
    for name in ("forward", "turn", *pose):
        if np.isnan(table[name]).any():
            reject(path, f"a number in column {name!r} in every row", f"none in {table.place(int(np.isnan(table[name]).argmax()))}")
    ranges = np.stack([table[name] for name in beams], axis=1)
    if (ranges < 0).any():
        reject(path, "ranges of 0 or more", f"{np.nanmin(ranges)} in {table.place(int((ranges < 0).any(axis=1).argmax()))}")
    poses = np.stack([table[name] for name in pose], axis=1) if pose else None
    return Scans(seconds, table["forward"], table["turn"], ranges, all_around(len(beams)), poses)


def read_scan_topics(path: str | os.PathLike[str], topics: Topics) -> Scans:
    """Read scans and odometry of a bag; times are seconds since its first message.

    Raises:
        FileError: the bag or a topic cannot be used, beams have other bearings in some scans, or no scan is within the odometry.
        MotesError: the number of beams cannot be used.
    """
    checks.positive_integer("topics.beams", topics.beams)
    wanted = {"scan": topics.scan, "odometry": topics.odometry} | ({"truth": topics.truth} if topics.truth else {})
    wanted |= {name: f"{topics.scan} {name}" for name in ("angle_min", "angle_increment")}
    kinds = {"scan": ("sensor_msgs/LaserScan",), "odometry": POSES, "truth": POSES}
    found = read_bag(path, wanted, {name: kinds[name] for name in kinds if name in wanted}).topics
    scan, least, step = (found[name].values for name in ("scan", "angle_min", "angle_increment"))
    if np.ptp(least) or np.ptp(step):
        reject(path, f"beams at the same bearings in all messages of {topics.scan}", "others")
    seconds, count = found["scan"].seconds, scan.shape[1]
    poses = found["odometry"].at(seconds)
    truth = found["truth"].at(seconds) if topics.truth else None
    known = np.isfinite(poses).all(axis=1) & (True if truth is None else np.isfinite(truth).all(axis=1))
    if not known.any():
        spans = ", ".join(f"{one.name} {one.seconds[0]:g} to {one.seconds[-1]:g} s" for name, one in found.items() if name in kinds)
        reject(path, "scans while there are odometry and truth", spans, "Are the clocks of these topics the same?")
    chosen = np.arange(min(topics.beams, count)) * count // min(topics.beams, count)
    # a step of 32 bits that closes the circle but for its rounding does close it
    around = abs(step[0] * count - 2 * np.pi) < ROUNDED
    bearings = least[0] + (all_around(count) if around else step[0] * np.arange(count))
    forward, turn = moves(poses[known])
    start = np.zeros(1)
    return Scans(seconds[known], np.concatenate([start, forward]), np.concatenate([start, turn]), scan[known][:, chosen], bearings[chosen],
                 None if truth is None else truth[known])  # fmt: skip


def write_scans(path: str | os.PathLike[str], scans: Scans) -> None:
    """Write scans as `read_scans` reads them."""
    names = ["time", "forward", "turn", *(f"range_{i}" for i in range(scans.ranges.shape[1])), *(POSE if scans.poses is not None else ())]
    blocks = [scans.times, scans.forward, scans.turn, scans.ranges, *([scans.poses] if scans.poses is not None else [])]
    rows = [tuple(None if np.isnan(v) else float(v) for v in row) for row in np.column_stack(blocks)]
    Table(tuple(names), tuple(rows)).save(Path(path))
