"""Scans with odometry, as tables."""

import os
from pathlib import Path
from typing import NamedTuple

import numpy as np

from motes.io.files import reject
from motes.io.result_table import Table
from motes.io.tables import column_names, read_table

POSE = ("x", "y", "heading")


class Scans(NamedTuple):
    """What a robot measured.

    Attributes:
        times: seconds, `(t,)`.
        forward: meters of the step that ends then, `(t,)`.
        turn: radians of it, `(t,)`.
        ranges: meters, `(t, b)`, NaN where nothing came back.
        poses: true x, y, heading, `(t, 3)`, or None.
    """

    times: np.ndarray
    forward: np.ndarray
    turn: np.ndarray
    ranges: np.ndarray
    poses: np.ndarray | None


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
    return Scans(seconds, table["forward"], table["turn"], ranges, np.stack([table[name] for name in pose], axis=1) if pose else None)


def write_scans(path: str | os.PathLike[str], scans: Scans) -> None:
    """Write scans as `read_scans` reads them."""
    names = ["time", "forward", "turn", *(f"range_{i}" for i in range(scans.ranges.shape[1])), *(POSE if scans.poses is not None else ())]
    blocks = [scans.times, scans.forward, scans.turn, scans.ranges, *([scans.poses] if scans.poses is not None else [])]
    rows = [tuple(None if np.isnan(v) else float(v) for v in row) for row in np.column_stack(blocks)]
    Table(tuple(names), tuple(rows)).save(Path(path))
