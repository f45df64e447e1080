"""The user's table of measurements: what it must hold, and what it may hold by mistake."""

from collections.abc import Sequence

import numpy as np

from motes.applications.terrain.settings import Recording
from motes.core import checks
from motes.core.record import replace
from motes.io.columns import Columns, MissingColumnError
from motes.io.guesses import Guess, column, guessed, proposing, words_and_unit
from motes.io.tables import read_table
from motes.io.units import back_to
from motes.models.terrain import TerrainMap

FARTHEST = 4.1e7
"""Meters, around the Earth: no position is farther from any other."""
ALTITUDES, HEIGHTS = (-1e3, 1e6), (-500.0, 1e5)
"""Meters: what an altitude, and a reading above terrain, can be."""
LONGEST = 1e5
"""Seconds between fixes: a day is a recording of something else, or in milliseconds."""
A_DEGREE = 1e3
"""A unit of map coordinates with more meters than this is a degree."""


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
    names = list(roles(recording).values())
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        checks.refuse("data", "a column of its own for each quantity", f"{twice!r} for two of them")
    if not recording.time and not 0 < recording.step <= LONGEST:
        checks.refuse("data step", f"a number of seconds above 0 and at most {LONGEST:.0f}", recording.step)


def roles(recording: Recording) -> dict[str, str]:
    """Return the columns that a recording names, by what they are."""
    horizontal = ("north", "east") if recording.coordinates == "local" else ("latitude", "longitude")
    found = {"time": recording.time} if recording.time else {}
    found |= dict(zip((*horizontal, "altitude"), recording.inertial, strict=True)) | {"height": recording.height}
    return found | dict(zip((f"true {name}" for name in horizontal), recording.truth, strict=False))


def own_unit(recording: Recording, role: str) -> str:
    """Return the unit that the user told of a column, by its name or by what it is; "" for none."""
    return recording.units.get(roles(recording)[role], recording.units.get(role, ""))


def units_of(terrain: TerrainMap, recording: Recording) -> dict[str, str]:
    """Return the unit in which each column of a recording is expected, by its name."""
    degrees = recording.coordinates == "map" and max(terrain.scale) > A_DEGREE
    place = "deg" if degrees else "m"
    return {name: {"time": "s", "altitude": "m", "height": "m"}.get(role, place) for role, name in roles(recording).items()}


def read_recording(terrain: TerrainMap, recording: Recording) -> Columns:
    """Read the columns that a recording names; what marks missing numbers is NaN.

    Raises:
        FileError: the file is missing, damaged or lacks a column; or a number of the inertial track is missing, or one cannot be what its
            column says; the message names column and line.
        MotesError: what is said of the table cannot be used.
    """
    columns = roles(recording)
    # a unit may be told of a column, or of what it is
    dialect = replace(recording, units={columns.get(name, name): unit for name, unit in recording.units.items()})
    try:
        table = read_table(recording.file, list(columns.values()), (), dialect, units_of(terrain, recording))
    except MissingColumnError as reason:
        raise _with_columns(reason, recording) from None
    north, east, altitude = recording.inertial
    for name in recording.inertial:
        _refuse_rows(table, name, np.isnan(table[name]), "a number in every row (only the altimeter may miss)")
    far = (-FARTHEST, FARTHEST)
    limits = {north: far, east: far, altitude: ALTITUDES, recording.height: HEIGHTS} | dict.fromkeys(recording.truth, far)
    for name, (low, high) in limits.items():
        beyond = (table[name] < low) | (table[name] > high)
        hint = ""
        if beyond.any():
            value = back_to(table[name][np.argmax(beyond)], dialect.units.get(name, ""), "m")
            hint = "Leave the cell empty if nothing was measured" + (
                f", or say so under [data]: missing = [{value:.10g}]" if name not in recording.inertial else "") + "."  # fmt: skip
        if name == recording.height and np.nanmedian(table[name]) < 0:
            hint = "They are below 0 for the most part: write heights above terrain as positive numbers."
        _refuse_rows(table, name, beyond, f"meters between {low:g} and {high:g}", hint)
    return table


def _with_columns(reason: MissingColumnError, recording: Recording) -> checks.FileError:
    """Return a refusal with lines of TOML that name the columns that may be meant."""
    asked = {role: name for role, name in roles(recording).items() if not role.startswith("true")}
    there = {role: Guess(name, "") for role, name in asked.items() if name in reason.names}
    taken = {guess.column for guess in there.values()}
    found = there | guessed([role for role in asked if role not in there], [name for name in reason.names if name not in taken])
    lost = [role for role in asked if role not in found]
    track = [role for role in asked if role not in ("time", "height")]
    words = {word for role in track[:2] if role in found for word in words_and_unit(found[role].column)[0]}
    units = dict.fromkeys(asked, "m") | {"time": "s", "latitude": "deg", "longitude": "deg"}
    moved = not set(track) <= set(there)
    lines = ['coordinates = "map"'] if moved and words & {"lat", "latitude", "lon", "long", "longitude"} else []
    if moved and found.keys() >= set(track):
        lines.append(f"inertial = [{', '.join(column(found[role], units[role]) for role in track)}]")
    lines += [f"{role} = {column(found[role], units[role])}" for role in ("height", "time") if role in found and role not in there]
    lines += ['time = ""', f"step = {recording.step:g}"] if "time" in lost else []
    return proposing(reason, lines if found else [], lost)


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
