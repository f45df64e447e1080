"""The user's table of measurements: what it must hold, and what it may hold by mistake."""

from collections.abc import Sequence

import numpy as np

from motes.applications.terrain.settings import Prior, Recording
from motes.core import checks
from motes.core.record import replace
from motes.io.tables import Columns, read_table
from motes.models.terrain import TerrainMap

FARTHEST = 4.1e7
"""Meters, around the Earth: no position is farther from any other."""
ALTITUDES, HEIGHTS = (-1e3, 1e6), (-500.0, 1e5)
"""Meters: what an altitude, and a reading above terrain, can be."""
LONGEST = 1e5
"""Seconds between fixes: a day is a recording of something else, or in milliseconds."""
FEET = 0.3048
FAR_OFF, NEAR = 3.0, 0.5
"""Heights that contradict the map by so many standard deviations are looked at in feet, which must leave at most this share of the gap."""


def check_recording(recording: Recording) -> None:
    """Refuse settings of a table that cannot be right, before it is read.

    Raises:
        MotesError: naming the key.
    """
    checks.option("data coordinates", recording.coordinates, ("local", "map"))
    if not recording.file:
        checks.refuse("data file", "a CSV or Parquet file", "none")
    horizontal = "north or latitude, east or longitude"
    if len(recording.inertial) != 3:
        checks.refuse("data inertial", f"the names of three columns ({horizontal}, altitude)", list(recording.inertial))
    if len(recording.truth) not in (0, 2):
        checks.refuse("data truth", f"the names of two columns ({horizontal}) or none", list(recording.truth))
    names = _columns(recording)
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        checks.refuse("data", "a column of its own for each quantity", f"{twice!r} for two of them")
    if not recording.time and not 0 < recording.step <= LONGEST:
        checks.refuse("data step", f"a number of seconds above 0 and at most {LONGEST:.0f}", recording.step)


def _columns(recording: Recording) -> list[str]:
    return [*((recording.time,) if recording.time else ()), *recording.inertial, recording.height, *recording.truth]


def read_recording(recording: Recording) -> Columns:
    """Read the columns that a recording names; what marks missing numbers is NaN.

    Raises:
        FileError: the file is missing, damaged or lacks a column; or a number of the inertial track is missing, or one cannot be what its
            column says; the message names column and line.
    """
    table = read_table(recording.file, _columns(recording))
    for name, values in table.items():
        if recording.missing is not None and name != recording.time:
            values[values == recording.missing] = np.nan
    north, east, altitude = recording.inertial
    for name in recording.inertial:
        _refuse_rows(table, name, np.isnan(table[name]), "a number in every row (only the altimeter may miss)")
    far = (-FARTHEST, FARTHEST)
    limits = {north: far, east: far, altitude: ALTITUDES, recording.height: HEIGHTS} | dict.fromkeys(recording.truth, far)
    for name, (low, high) in limits.items():
        beyond = (table[name] < low) | (table[name] > high)
        hint = ""
        if beyond.any():
            value = table[name][np.argmax(beyond)]
            hint = "Leave the cell empty if nothing was measured" + (
                f", or say so under [data]: missing = {value:g}" if name not in recording.inertial else "") + "."  # fmt: skip
        _refuse_rows(table, name, beyond, f"meters between {low:g} and {high:g}", hint)
    return table


def _refuse_rows(table: Columns, name: str, bad: np.ndarray, expected: str, hint: str = "") -> None:
    if bad.any():
        row = int(np.argmax(bad))
        value = table[name][row]
        given = f"{'none' if np.isnan(value) else f'{value:g}'} in {table.place(row)}"
        checks.refuse(f"{table.source}: column {name!r}", expected, given, hint, checks.FileError)


def check_steps(name: str, seconds: np.ndarray) -> None:
    """Refuse times so far apart that they are no seconds.

    Args:
        name: of the file.
        seconds: of each fix, `(t,)`.

    Raises:
        MotesError: naming the row.
    """
    steps = np.diff(seconds)
    if steps.size and steps.max() > LONGEST:
        row = int(np.argmax(steps)) + 2
        checks.refuse(f"{name}: times", f"at most {LONGEST:.0f} seconds between fixes", f"{steps.max():.6g} before row {row}",
                      "Write times in seconds, or as 2024-01-31T12:30:00Z.")  # fmt: skip


def local(terrain: TerrainMap, recording: Recording, table: Columns, columns: Sequence[str]) -> tuple[np.ndarray, np.ndarray]:
    """Return two columns, north and east, in meters of the map's south-west post."""
    north, east = table[columns[0]], table[columns[1]]
    return (north, east) if recording.coordinates == "local" else terrain.to_local(north, east)


def misreadings(terrain: TerrainMap, recording: Recording, table: Columns) -> list[tuple[str, np.ndarray, np.ndarray]]:
    """Return other readings of a track that lies off the map, each as advice for the user, north and east in meters.

    Whoever asks tells which of them lies on the map.
    """
    north, east = recording.inertial[:2]
    in_meters = recording.coordinates == "local"
    other = replace(recording, coordinates="map" if in_meters else "local")
    other_system = "the map's own coordinates" if in_meters else "meters from its south-west post"
    return [
        (f"{'North and east' if in_meters else 'Latitude and longitude'} look swapped: exchange {north!r} and {east!r}.",
         *local(terrain, recording, table, (east, north))),
        (f'They look like {other_system}: set coordinates = "{other.coordinates}".', *local(terrain, other, table, recording.inertial)),
    ]


def check_units(terrain: TerrainMap, recording: Recording, table: Columns, north: np.ndarray, east: np.ndarray, prior: Prior) -> None:
    """Refuse altitudes or heights in feet: those that contradict the map as meters and agree with it once they are converted.

    Args:
        terrain: the map.
        recording: names of the columns.
        table: the columns.
        north: of the inertial track, meters of the map's south-west post.
        east: likewise.
        prior: how far off the inertial track may be.

    Raises:
        FileError: naming the columns.
    """
    altitude, height = table[recording.inertial[2]], table[recording.height]
    known = np.isfinite(height) & np.asarray(terrain.inside(north, east))
    ground = np.asarray(terrain.height(np.where(known, north, 0), np.where(known, east, 0)), np.float64)
    known &= np.isfinite(ground)
    if not known.any():
        return
    readings = {"": (1, 1), f"{recording.height!r} looks": (1, FEET), f"{recording.inertial[2]!r} looks": (FEET, 1),
                f"{recording.inertial[2]!r} and {recording.height!r} look": (FEET, FEET)}
    gaps = {what: abs(float(np.median(a * altitude[known] - h * height[known] - ground[known]))) for what, (a, h) in readings.items()}
    as_said = gaps.pop("")
    meant = min(gaps, key=lambda what: gaps[what])
    # the track is beside the true one, so that the ground below is another piece of the same relief
    usual = prior.vertical_position + float(np.nanstd(np.asarray(terrain.heights))) / 2
    if as_said > FAR_OFF * usual and gaps[meant] < NEAR * as_said:
        checks.refuse(f"{table.source}: heights", "meters that agree with the map", f"{as_said:.0f} m of contradiction at the median fix",
                      f"{meant} like feet: multiply by {FEET}.", checks.FileError)  # fmt: skip
