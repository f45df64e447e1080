"""Scans with odometry, as tables and in bags."""

import os
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from motes.applications.laser.settings import Topics
from motes.applications.plausible import check_milliseconds, mend, set_to
from motes.applications.robot.bag import SLOWEST
from motes.applications.robot.scenario import moves
from motes.core import checks
from motes.io.bags import read_bag
from motes.io.clocks import Clock
from motes.io.columns import Columns
from motes.io.dialect import NAMED, NamedDialect
from motes.io.files import reject
from motes.io.messages import POSES
from motes.io.named_tables import named_columns, own_unit, read_named
from motes.io.result_table import Table
from motes.io.units import UNITS, as_toml

POSE = {"x": "m", "y": "m", "heading": "rad"}
"""Columns of the truth, and the unit of each."""
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
        start: time 0 in the file, seconds (of dates Unix seconds).
        clock: how times are written there.
    """

    times: np.ndarray
    forward: np.ndarray
    turn: np.ndarray
    ranges: np.ndarray
    bearings: np.ndarray
    poses: np.ndarray | None
    start: float = 0.0
    clock: Clock = Clock()


def all_around(beams: int) -> np.ndarray:
    """Return even bearings all around, from the heading on, `(beams,)`."""
    return 2 * np.pi * np.arange(beams) / beams


def read_scans(path: str | os.PathLike[str], written: NamedDialect = NAMED) -> Scans:
    """Read a table of scans.

    Args:
        path: the table.
        written: how it is written, and what its columns are called.

    Raises:
        FileError: it cannot be read, lacks a column, or has a value that cannot be.
        MotesError: what is said of the table cannot be used.
    """
    names = named_columns(path, written)
    beams = [f"range_{i}" for i in range(sum(name.startswith("range_") for name in names))]
    pose = list(POSE) if set(POSE) <= set(names) else []
    if not beams:
        hint = 'What they are called is told so: columns = { range_0 = "its name", ... }.'
        reject(path, "columns range_0, range_1, ...", ", ".join(names)[:200], hint)
    # a unit of "range" is one of all beams
    ranges = dict.fromkeys(beams, written.units.get("range", ""))
    units = {**{name: unit for name, unit in ranges.items() if unit}, **{k: u for k, u in written.units.items() if k != "range"}}
    roles = {"time": "s", "forward": "m", "turn": "rad"} | dict.fromkeys(beams, "m") | {name: POSE[name] for name in pose}
    table = read_named(path, roles, replace(written, units=units))
    start, seconds = table.times("time", repeats=False)
    for name in ("forward", "turn", *pose):
        if np.isnan(table[name]).any():
            reject(path, f"a number in column {name!r} in every row", f"none in {table.place(int(np.isnan(table[name]).argmax()))}")
    ranges = np.stack([table[name] for name in beams], axis=1)
    if (ranges < 0).any():
        reject(path, "ranges of 0 or more", f"{np.nanmin(ranges)} in {table.place(int((ranges < 0).any(axis=1).argmax()))}")
    poses = np.stack([table[name] for name in pose], axis=1) if pose else None
    _check_units(table, written, seconds)
    return Scans(seconds, table["forward"], table["turn"], ranges, all_around(len(beams)), poses, start, table.clocks["time"])


def _check_units(table: Columns, written: NamedDialect, seconds: np.ndarray) -> None:
    """Refuse turns in degrees, and times in milliseconds.

    Raises:
        FileError: they are, with the line of TOML that says so.
    """
    most = float(np.abs(table["turn"]).max())
    if not own_unit(written, "turn") and most > np.pi:
        mend(table.source, "turns of a step in radians, at most half a circle", f"{most:.3g}", "Degrees", set_to(as_toml({"turn": "deg"})))
    if not own_unit(written, "time") and not table.clocks["time"].format:
        check_milliseconds(table.source, "time", seconds, table["forward"][1:], SLOWEST)


def check_reach(source: str, scans: Scans, width: float, units: Mapping[str, str]) -> None:
    """Refuse ranges that reach far beyond a map, where another unit brings them onto it.

    Args:
        source: name of the file.
        scans: that were read.
        width: of the map, from corner to corner, m.
        units: that the user told.

    Raises:
        FileError: they do, with the line of TOML that says so.
    """
    known = scans.ranges[np.isfinite(scans.ranges)]
    if not known.size or "range" in units:
        return
    usual = float(np.median(known))
    if usual > width:
        unit = next((name for name in ("ft", "cm", "mm") if usual * UNITS[name].factor < width / 2), None)
        if unit:
            told = f"Are they in {unit}"
            mend(source, f"ranges on a map of {width:.3g} m", f"{usual:.4g} m at the median", told, set_to(as_toml({"range": unit})))


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
    bag = read_bag(path, wanted, {name: kinds[name] for name in kinds if name in wanted})
    found = bag.topics
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
                 None if truth is None else truth[known], bag.start)  # fmt: skip


def write_scans(path: str | os.PathLike[str], scans: Scans) -> None:
    """Write scans as `read_scans` reads them."""
    names = ["time", "forward", "turn", *(f"range_{i}" for i in range(scans.ranges.shape[1])), *(POSE if scans.poses is not None else ())]
    blocks = [scans.times, scans.forward, scans.turn, scans.ranges, *([scans.poses] if scans.poses is not None else [])]
    rows = [tuple(None if np.isnan(v) else float(v) for v in row) for row in np.column_stack(blocks)]
    Table(tuple(names), tuple(rows)).save(Path(path))
