"""Units, signs and datum of altitudes and heights, by what they say together with the map."""

from typing import NamedTuple

import numpy as np

from motes.applications.plausible import check_milliseconds, mend, set_to, times_too
from motes.applications.terrain.settings import MapFiles, Prior, Recording
from motes.io.columns import Columns
from motes.io.units import FOOT, as_toml
from motes.models.terrain import TerrainMap

FAR_OFF, NEAR = 3.0, 0.5
"""Heights that contradict the map by so many standard deviations are read otherwise, which must leave at most this share of the gap."""
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
        FileError: naming the columns, with the line of TOML that mends it.
    """
    north, east = track
    name = recording.inertial[2]
    altitude, height = table[name], table[recording.height]
    known = np.isfinite(height) & np.asarray(terrain.inside(north, east))
    ground = np.asarray(terrain.height(np.where(known, north, 0), np.where(known, east, 0)), np.float64)
    known &= np.isfinite(ground)
    if not known.any():
        return
    above, reading, below = altitude[known], height[known], ground[known]

    def gap(one: Reading) -> float:
        return abs(float(np.median(one.altitude * above - one.height * reading - one.terrain * below)))

    as_said = Reading(1, 1, 1, "", "")
    # the track is beside the true one, so that the ground below is another piece of the same relief
    usual = prior.vertical_position + float(np.nanstd(np.asarray(terrain.heights))) / 2
    if gap(as_said) <= FAR_OFF * usual:
        return
    meant = min(_readings(files, recording, name), key=gap)
    what, given = "altitude minus radar minus terrain about 0 m", f"{gap(as_said):.0f} m at the median fix"
    if gap(meant) < NEAR * gap(as_said) and gap(meant) <= FAR_OFF * usual:
        mend(table.source, what, given, meant.said, meant.hint)
    off = above - reading - below
    shift = float(np.median(off))
    if np.median(np.abs(off - shift)) < usual:
        unit = 10 ** np.floor(np.log10(abs(shift)))
        wide = unit * np.ceil(abs(shift) / unit)
        mend(table.source, what, f"{shift:.0f} m throughout", "Are altitudes above another zero (a datum, pressure)",
             set_to(f"vertical_position = {wide:g}", "prior"))  # fmt: skip


def _readings(files: MapFiles, recording: Recording, altitude: str) -> list[Reading]:
    """Return what may have been meant: feet and meters taken for one another, altitude and height exchanged, signs."""
    height, found = recording.height, []
    told = {name: recording.units.get(name, recording.units.get(role, "m")) for role, name in (("altitude", altitude), ("height", height))}
    for names, factors in (((height,), (0, 1)), ((altitude,), (1, 0)), ((altitude, height), (1, 1))):
        if any(told[name] != told[names[0]] for name in names):
            continue
        unit, factor = _other(told[names[0]])
        others = {name: given for name, given in told.items() if given != "m"} | dict.fromkeys(names, unit)
        both = f"{altitude!r} minus {height!r} is" if len(names) == 2 else f"{names[0]!r} is"
        scales = [factor if changes else 1.0 for changes in factors]
        found.append(Reading(*scales, 1.0, f"{both} {times_too(1 / factor)}: {_WORDS[unit]}", set_to(as_toml(others))))
    unit, factor = _other(files.unit)
    north, east = recording.inertial[:2]
    swapped = f'inertial = ["{north}", "{east}", "{height}"], and height = "{altitude}"'
    return [
        *found,
        Reading(1, 1, factor, f"The map is {times_too(1 / factor)}: {_WORDS[unit]}", set_to(f'unit = "{unit}"', "map")),
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
    if recording.time and recording.time not in recording.units and not table.clocks[recording.time].format:
        check_milliseconds(table.source, recording.time, seconds, np.hypot(*np.diff(track, axis=1)), SLOWEST)
