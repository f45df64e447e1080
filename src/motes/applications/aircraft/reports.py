"""Recordings of ADS-B reports: what they must hold, what counts of them, and what they may hold by mistake."""

import os
from typing import NamedTuple

import numpy as np

from motes.applications.plausible import CLEAR, check_ratio, mend, set_to
from motes.core import checks
from motes.io.clocks import Clock
from motes.io.columns import Columns
from motes.io.dialect import NamedDialect
from motes.io.named_tables import read_named
from motes.io.units import as_toml

NAME, SHOWN = "icao24", 12
"""Column that tells aircraft apart, and how many of them a refusal names."""
LIMITS = ((-1e15, 1e15), (-89.0, 89.0), (-180.0, 360.0), (0.0, 2000.0), (-360.0, 360.0))
"""Columns of a report and what they can be: seconds, degrees (no flat map has a pole), degrees, knots, degrees."""
LEAST = 10
"""Reports without which there is no path."""
LATEST, MILLI = 1e11, 1e3
"""Times beyond the one, in the year 5138, are milliseconds."""
EARTH, KNOT = 6371008.8, 1852 / 3600


class Reports(NamedTuple):
    """Reports `(r,)` by column: seconds, degrees, degrees, knots, degrees from north."""

    timestamp: np.ndarray
    latitude: np.ndarray
    longitude: np.ndarray
    groundspeed: np.ndarray
    track: np.ndarray


REPORT = Reports._fields
UNITS = dict(zip(REPORT, ("s", "deg", "deg", "kn", "deg"), strict=True))
FASTER, OFF_COURSE = 20.0, (0.5, 0.2)
"""Knots from which on a speed is held against the positions; radians by which tracks contradict them, and by which others agree."""


def read_reports(file: str | os.PathLike[str], written: NamedDialect) -> dict[str, Columns]:
    """Read the reports of all aircraft of a recording, by icao24; all under "" where it has no such column.

    Raises:
        FileError: the file cannot be used.
    """
    return read_named(file, UNITS, written, (NAME,)).by(NAME)


def heard_of(table: Columns) -> Reports:
    """Return the reports that count, their times in seconds."""
    time, latitude, longitude, speed, track = (table[name] for name in REPORT)
    silent = (np.isnan(latitude) & np.isnan(longitude)) | (np.isnan(speed) & np.isnan(track))
    for name, (low, high) in zip(REPORT, LIMITS, strict=True):
        bad = ~silent & ~((table[name] >= low) & (table[name] <= high))
        if bad.any():
            row = int(np.argmax(bad))
            given = "none" if np.isnan(table[name][row]) else f"{table[name][row]:g}"
            checks.refuse(f"{table.source}: column {name!r}", f"a number between {low:g} and {high:g} in {table.place(row)}", given,
                          "Take the row out, or leave all of its position or velocity empty.", checks.FileError)  # fmt: skip
    heard = np.flatnonzero(~silent)
    seconds = time[heard] * _unit(time)
    back = np.diff(seconds) < 0
    if back.any():
        row = heard[int(np.argmax(back)) + 1]
        checks.refuse(f"{table.source}: column 'timestamp'", "times that never decrease", f"an earlier one in {table.place(row)}",
                      "Sort the rows by time.", checks.FileError)  # fmt: skip
    return Reports(seconds, *(column[heard] for column in (latitude, longitude, speed, track)))


def part_of(reports: Reports, first: float, start: float, duration: float) -> Reports:
    """Return the reports of a part, their times since the first report, without those that repeat a position."""
    seconds = reports.timestamp - first
    kept = (seconds >= start) & (seconds <= start + duration)
    kept[1:] &= (np.diff(reports.latitude) != 0) | (np.diff(reports.longitude) != 0)
    return Reports(*(column[kept] for column in reports._replace(timestamp=seconds)))


def _steps(latitude: np.ndarray, longitude: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return meters east and north between successive positions, degrees."""
    east = EARTH * np.cos(np.radians(latitude[:-1])) * np.radians(wrapped_degrees(np.diff(longitude)))
    return east, EARTH * np.radians(np.diff(latitude))


def check_agreement(source: str, heard: Reports) -> None:
    """Refuse speeds and tracks that contradict the positions, where another unit makes them agree.

    Raises:
        FileError: naming the column, with the line of TOML that mends it.
    """
    dt = np.diff(heard.timestamp)
    east, north = _steps(heard.latitude, heard.longitude)
    way, speed = np.hypot(east, north), KNOT * heard.groundspeed[:-1]
    moved = (dt > 0) & (way > 0) & (heard.groundspeed[:-1] > FASTER)
    if moved.sum() < LEAST:
        return

    def ratio(way: np.ndarray) -> float:
        return float(np.median(speed[moved] * dt[moved] / way[moved]))

    check_ratio(source, "a groundspeed that agrees with the positions", ratio(way), {"groundspeed": "kn"}, ("m/s", "km/h"))
    check_ratio(source, "times that agree with positions and groundspeed", ratio(way), {"timestamp": "s"}, ("ms",))
    if np.abs(heard.latitude).max() < np.pi / 2 and not 1 / CLEAR < ratio(way) < CLEAR:
        wide = np.hypot(*_steps(np.degrees(heard.latitude), np.degrees(heard.longitude)))
        if 1 / CLEAR < ratio(wide) < CLEAR:
            units = {"latitude": "rad", "longitude": "rad"}
            mend(source, "positions that agree with the groundspeed", "some that agree in radians", "Radians", set_to(as_toml(units)))
    course = np.arctan2(east, north)[moved]

    def off(track: np.ndarray) -> float:
        return float(np.median(np.abs(np.angle(np.exp(1j * (course - track[:-1][moved]))))))

    if off(np.radians(heard.track)) > OFF_COURSE[0] and off(heard.track) < OFF_COURSE[1]:
        mend(source, "a track that agrees with the positions", "one that agrees in radians", "Radians", set_to(as_toml({"track": "rad"})))


def clock_of(table: Columns) -> Clock:
    """Return how the times of a recording are written; very large numbers are milliseconds."""
    clock, unit = table.clocks[REPORT[0]], _unit(table[REPORT[0]])
    return clock._replace(unit=unit) if not clock.format and unit != 1.0 else clock


def _unit(time: np.ndarray) -> float:
    """Return the unit of numbers as times, seconds."""
    return 1 / MILLI if (time[np.isfinite(time)][:1] > LATEST).any() else 1.0


def wrapped_degrees(angle: np.ndarray) -> np.ndarray:
    """Return angles from -180 to 180 degrees, so that a flight may cross the date line."""
    return (angle + 180) % 360 - 180
