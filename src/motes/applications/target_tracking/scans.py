"""Scans of the user's own from a file, and the beginning of a track found among their plots."""

from pathlib import Path
from typing import NamedTuple

import numpy as np

from motes.applications.target_tracking.settings import Radar
from motes.core import checks
from motes.io.columns import Columns
from motes.io.result_table import Table
from motes.io.tables import read_table

PLOT = ("time", "range", "azimuth", "range_rate")
STATE = ("time", "east", "north", "v_east", "v_north")
SCANS, SUPPORT = 5, 3
"""A track begins where among so many scans so many have a plot on a line that an aircraft could fly (M of N)."""
GATE = 4.0
"""Standard deviations within which a plot supports a line."""
MANEUVER = 2.0
"""Acceleration that a line is allowed, m/s^2."""
LONGEST = 10_000
"""Scans that a file is filled up to at most."""


class Beginning(NamedTuple):
    """Where a track begins.

    Attributes:
        scan: number of the second of the two scans whose plots it is made of.
        mean: east, north and velocities `(4,)` at that time.
        cov: `(4, 4)`.
    """

    scan: int
    mean: np.ndarray
    cov: np.ndarray


def read_scans(file: str, period: float) -> tuple[np.ndarray, list[np.ndarray]]:
    """Return times `(t,)` of scans, in seconds of the file, and the plots `(m, 3)` of each: range, azimuth from east (radians), range rate.

    Args:
        file: see `Settings.data`.
        period: see `Settings.period`.

    Raises:
        FileError: the file cannot be used; the message names column and row.
        MotesError: the period is negative.
    """
    if not period >= 0:
        checks.refuse("period", "a number of seconds, 0 or more", period)
    table = read_table(file, PLOT)
    start, times = table.times("time")
    rows = np.stack([table["range"], np.pi / 2 - np.radians(table["azimuth"]), table["range_rate"]], axis=1)
    missing = np.isnan(rows)
    count = missing.sum(axis=1)
    partly = (count > 0) & (count < missing.shape[1])
    _refuse_rows(table, partly, "range", "range, azimuth and range_rate, or none of them", "Leave the plot out.")
    _refuse_rows(table, rows[:, 0] < 0, "range", "meters, not below 0", "")
    rows[:, 1] = (rows[:, 1] + np.pi) % (2 * np.pi) - np.pi
    begins = np.flatnonzero(np.diff(times, prepend=-np.inf) > 0)
    found: list[tuple[float, np.ndarray]] = []
    for block in np.split(np.arange(len(times)), begins[1:]):
        now = float(times[block[0]])
        gaps = int(round((now - found[-1][0]) / period)) - 1 if found and period else 0
        if len(found) + gaps > LONGEST:
            checks.refuse(f"{table.source}: column 'time'", f"at most {LONGEST} scans", f"a gap of {gaps} before {table.place(block[0])}",
                          "Set the period, or 0 where the file has all scans.", checks.FileError)  # fmt: skip
        before = found[-1][0] if found else now
        found += [(before + (now - before) * (gap + 1) / (gaps + 1), np.zeros((0, 3))) for gap in range(gaps)]
        found.append((now, rows[block][count[block] == 0]))
    return start + np.array([time for time, _ in found]), [plots for _, plots in found]


def read_truth(file: str, times: np.ndarray) -> np.ndarray:
    """Return true states `(t, 4)` at some times, between those of a file (see `Settings.truth`); NaN beyond them.

    Raises:
        FileError: the file cannot be used, or its times do not grow.
    """
    table = read_table(file, STATE)
    start, seconds = table.times("time", repeats=False)
    return np.stack([np.interp(times - start, seconds, table[name], np.nan, np.nan) for name in STATE[1:]], axis=1)


def written_scans(path: Path, times: np.ndarray, scans: list[np.ndarray]) -> None:
    """Write scans as `read_scans` reads them."""
    rows = []
    for time, plots in zip(times, scans, strict=True):
        known = [(float(time), float(r), float(np.degrees(np.pi / 2 - a) % 360), float(v)) for r, a, v in plots]
        rows += known or [(float(time), None, None, None)]
    Table(PLOT, tuple(rows)).save(path)


def begun(times: np.ndarray, scans: list[np.ndarray], radar: Radar) -> Beginning:
    """Find where a track begins: the first scans of which M of N have a plot on one line, by the pair of plots with most support.

    Two plots say places and a velocity, which their own range rates must agree with; the other scans support it with a plot near the line.

    Args:
        times: of the scans.
        scans: plots of each.
        radar: its accuracy.

    Raises:
        MotesError: no scans have so many.
    """
    for first in range(len(scans) - SUPPORT + 1):
        window = range(first, min(first + SCANS, len(scans)))
        pairs = [(i, j, a, b) for i in window for j in window if i < j for a in scans[i] for b in scans[j]]
        if not pairs:
            continue
        best, support, distance = None, 0, 0.0
        for i, j, a, b in pairs:
            mean, cov = _line(a, b, times[j] - times[i], radar)
            if np.hypot(*mean[2:]) > radar.fastest or not _agree(a, b, mean, cov, times[j] - times[i], radar):
                continue
            squares = [_off(mean, cov, times[k] - times[j], scans[k], radar) for k in window if k not in (i, j)]
            near = [square for square in squares if square < GATE**2]
            if (2 + len(near), -sum(near)) > (support, -distance):
                best, support, distance = Beginning(j, mean, cov), 2 + len(near), sum(near)
        if best is not None and support >= SUPPORT:
            return best
    checks.refuse("data", f"{SUPPORT} of {SCANS} scans with plots on a line that an aircraft could fly", f"none in {len(scans)} scans",
                  "Look at the numbers of the radar: range and range rate in meters, azimuth in degrees from north.")


def _placed(plot: np.ndarray, radar: Radar) -> tuple[np.ndarray, np.ndarray]:
    """East and north of a plot, and their covariance."""
    distance, azimuth = plot[:2]
    turn = np.array([[np.cos(azimuth), -np.sin(azimuth)], [np.sin(azimuth), np.cos(azimuth)]])
    return distance * turn[:, 0], turn @ np.diag([radar.distance**2, (radar.azimuth * distance) ** 2]) @ turn.T


def _line(a: np.ndarray, b: np.ndarray, apart: float, radar: Radar) -> tuple[np.ndarray, np.ndarray]:
    """State at the second of two plots, and its covariance; maneuvers between them widen that of the velocity."""
    (before, cov_a), (place, cov_b) = _placed(a, radar), _placed(b, radar)
    wide = (cov_a + cov_b) / apart**2 + (0.5 * MANEUVER * apart) ** 2 * np.eye(2)
    return np.concatenate([place, (place - before) / apart]), np.block([[cov_b, cov_b / apart], [cov_b / apart, wide]])


def _agree(a: np.ndarray, b: np.ndarray, mean: np.ndarray, cov: np.ndarray, apart: float, radar: Radar) -> bool:
    """Tell whether the range rates of two plots are those of the velocity between their places."""
    for plot in (a, b):
        along = np.array([np.cos(plot[1]), np.sin(plot[1])])
        spread = np.sqrt(along @ cov[2:, 2:] @ along + radar.rate**2)
        if abs(along @ mean[2:] - plot[2]) > GATE * spread:
            return False
    return True


def _off(mean: np.ndarray, cov: np.ndarray, ahead: float, plots: np.ndarray, radar: Radar) -> float:
    """Least squared distance of the plots of a scan from a line, in standard deviations; infinite without plots."""
    F = np.block([[np.eye(2), ahead * np.eye(2)], [np.zeros((2, 2)), np.eye(2)]])
    place, wide = (F @ mean)[:2], (F @ cov @ F.T)[:2, :2] + (0.5 * MANEUVER * ahead**2) ** 2 * np.eye(2)
    squares = [np.inf]
    for plot in plots:
        at, own = _placed(plot, radar)
        squares.append(float((at - place) @ np.linalg.solve(wide + own, at - place)))
    return min(squares)


def _refuse_rows(table: Columns, bad: np.ndarray, name: str, expected: str, hint: str) -> None:
    if bad.any():
        row = int(np.argmax(bad))
        given = f"{table[name][row]:g}"
        checks.refuse(f"{table.source}: column {name!r}", f"{expected} in {table.place(row)}", given, hint, checks.FileError)
