"""Units, signs and datum of altitudes and heights, by what they say together with the map."""

import itertools
from typing import NamedTuple

import numpy as np

from motes.applications.plausible import check_milliseconds, mend, set_to, times_too
from motes.applications.terrain.recording import own_unit
from motes.applications.terrain.settings import MapFiles, Prior, Recording
from motes.io.columns import Columns
from motes.io.units import FOOT, as_toml
from motes.models.terrain import TerrainMap

FAR_OFF, NEAR = 3.0, 0.5
"""Heights that contradict the map by so many standard deviations are read otherwise, which must leave at most this share of the gap."""
SHIFTS = (-2.0, -1.0, 0.0, 1.0, 2.0)
"""By how many standard deviations the track may be off, north and east."""
SLOWEST = 0.5
"""An aircraft that is slower than this for most of a flight, in m/s, has times in other units."""


class Reading(NamedTuple):
    """Another reading of altitudes, heights and map.

    Attributes:
        altitude: what altitudes are multiplied by.
        height: what readings of the altimeter are.
        terrain: what heights of the map are.
        said: what seems to be so.
        hint: what mends it.
    """

    altitude: float
    height: float
    terrain: float
    said: str
    hint: str


def check_readings(
    terrain: TerrainMap, files: MapFiles, recording: Recording, table: Columns, track: tuple[np.ndarray, np.ndarray], prior: Prior
) -> None:
    """Refuse altitudes or heights that contradict the map, where other units, another sign or another datum make them agree with it.

    Args:
        terrain: the map.
        files: of it.
        recording: names of the columns.
        table: the columns.
        track: north and east of the inertial track, meters of the map's south-west post.
        prior: how far off the inertial track may be.

    Raises:
        FileError: naming the columns, with the line of TOML that mends it; of several that may, the likeliest first.
    """
    name = recording.inertial[2]
    altitude, height = table[name], table[recording.height]
    grounds = _grounds(terrain, track, np.isfinite(height), prior.horizontal_position)
    if not len(grounds):
        return

    def off(one: Reading) -> np.ndarray:
        return one.altitude * altitude - one.height * height - one.terrain * grounds

    def gap(one: Reading) -> float:
        # an offset, and how much fixes scatter about it, wherever the track is
        center = np.nanmedian(off(one), axis=1)
        return float(np.min(np.abs(center) + np.nanmedian(np.abs(off(one) - center[:, None]), axis=1)))

    as_said = Reading(1, 1, 1, "", "")
    usual = FAR_OFF * prior.vertical_position + float(np.nanstd(np.asarray(terrain.heights))) / 2
    if gap(as_said) <= usual:
        return
    meant = [one for one in _readings(files, recording, name) if gap(one) < min(NEAR * gap(as_said), usual)]
    centers = np.nanmedian(off(as_said), axis=1)
    scatter = np.nanmedian(np.abs(off(as_said) - centers[:, None]), axis=1)
    meant = sorted(meant, key=gap)[:2]
    if scatter.min() < prior.vertical_position:
        shift = float(centers[np.argmin(scatter)])
        unit = 10 ** np.floor(np.log10(abs(shift)))
        meant.append(Reading(1, 1, 1, f"altitudes are above another zero by some {shift:.0f} m (a datum, pressure)",
                             set_to(f"vertical_position = {unit * np.ceil(abs(shift) / unit):g}", "prior")))  # fmt: skip
    if meant:
        more = "".join(f" Or {one.said}? {one.hint}" for one in meant[1:])
        mend(table.source, "altitude minus radar minus terrain about 0 m", f"{gap(as_said):.0f} m at the least",
             meant[0].said, meant[0].hint + more)  # fmt: skip


def _grounds(terrain: TerrainMap, track: tuple[np.ndarray, np.ndarray], known: np.ndarray, spread: float) -> np.ndarray:
    """Return the heights `(k, t)` below a track, and below it as it may be off by so much; NaN where nothing is known, which is seldom."""
    found = []
    for shift in itertools.product(SHIFTS, SHIFTS):
        north, east = (part + along * spread for part, along in zip(track, shift, strict=True))
        there = known & np.asarray(terrain.inside(north, east))
        ground = np.asarray(terrain.height(np.where(there, north, 0), np.where(there, east, 0)), np.float64)
        found.append(np.where(there, ground, np.nan))
    counts = np.array([np.isfinite(ground).sum() for ground in found])
    return np.stack(found)[counts > max(counts[len(counts) // 2] // 2, 0)] if counts.max() else np.zeros((0, len(known)))


def _readings(files: MapFiles, recording: Recording, altitude: str) -> list[Reading]:
    """Return what may have been meant: feet and meters taken for one another, altitude and height exchanged, signs."""
    height, found = recording.height, []
    told = {name: own_unit(recording, role) or "m" for role, name in (("altitude", altitude), ("height", height))}
    for names, factors in (((height,), (0, 1)), ((altitude,), (1, 0)), ((altitude, height), (1, 1))):
        if any(told[name] != told[names[0]] for name in names):
            continue
        unit, factor = _other(told[names[0]])
        others = {name: given for name, given in told.items() if given != "m"} | dict.fromkeys(names, unit)
        both = f"{altitude!r} minus {height!r} is" if len(names) == 2 else f"{names[0]!r} is"
        of_altitude, of_height = (factor if changes else 1.0 for changes in factors)
        found.append(Reading(of_altitude, of_height, 1.0, f"{both} {times_too(1 / factor)}: {_WORDS[unit]}", set_to(as_toml(others))))
    unit, factor = _other(files.unit)
    north, east = recording.inertial[:2]
    swapped = f'inertial = ["{north}", "{east}", "{height}"], and height = "{altitude}"'
    return [
        *found,
        Reading(1, 1, factor, f"the map is {times_too(1 / factor)}: {_WORDS[unit]}", set_to(f'unit = "{unit}"', "map")),
        Reading(1, -1, 1, f"{height!r} has the other sign", "Write heights above terrain as positive numbers."),
        Reading(-1, 1, 1, f"{altitude!r} is positive downward", "Write altitudes as positive numbers."),
        Reading(-1, -1, 1, f"{altitude!r} and {height!r} are exchanged", set_to(swapped)),
    ]


def _other(unit: str) -> tuple[str, float]:
    """Return what a unit of lengths may be taken for, and what numbers are then to be multiplied by."""
    return ("m", 1 / FOOT) if unit == "ft" else ("ft", FOOT)


_WORDS = {"ft": "feet", "m": "meters"}


def check_seconds(recording: Recording, table: Columns, seconds: np.ndarray, track: tuple[np.ndarray, np.ndarray]) -> None:
    """Refuse times in milliseconds.

    Raises:
        FileError: they are.
    """
    if recording.time and not own_unit(recording, "time") and not table.clocks[recording.time].format:
        check_milliseconds(table.source, recording.time, seconds, np.hypot(*np.diff(track, axis=1)), SLOWEST)
