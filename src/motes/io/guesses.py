"""Which columns of a table may be what is asked for, by their names: proposals for people, never taken without asking."""

import difflib
import os
import re
import unicodedata
from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

from motes.core.checks import FileError
from motes.io.columns import MissingColumnError
from motes.io.units import UNITS, known, quoted, text

WORDS = {
    "time": "time timestamp t date datetime utc unix seconds sec secs epoch clock zeit zeitpunkt datum uhrzeit temps fecha",
    "timestamp": "timestamp time t date datetime utc unix seconds epoch zeit",
    "latitude": "latitude lat breite breitengrad gps_lat phi",
    "longitude": "longitude lon lng long laenge laengengrad gps_lon lambda",
    "north": "north northing n y lat latitude ins_north nord pos_n hochwert breite",
    "east": "east easting e x lon lng long longitude ins_east ost pos_e rechtswert laenge",
    "altitude": "altitude alt ins_altitude baro elevation msl hoehe flughoehe z up hgt_msl",
    "height": "height radar radalt radio agl ra ralt altimeter rad_alt height_above_ground clearance hag radarhoehe hoehe_ueber_grund",
    "range": "range rng distance dist rho slant r entfernung abstand",
    "azimuth": "azimuth az bearing brg theta angle azimut peilung",
    "range_rate": "range_rate rangerate doppler radial_velocity vr rdot velocity rate radialgeschwindigkeit",
    "groundspeed": "groundspeed ground_speed gs speed spd velocity sog geschwindigkeit",
    "track": "track heading course hdg trk cog true_track kurs",
    "v_east": "v_east ve east_velocity vx v_e",
    "v_north": "v_north vn north_velocity vy v_n",
    "forward": "forward dist distance ds step odometry vorwaerts",
    "turn": "turn dtheta rotation dyaw yaw dheading drehung",
    "heading": "heading yaw theta psi orientation kurs",
    "x": "x px pos_x east", "y": "y py pos_y north",
}  # fmt: skip
"""Words by which what is asked for is called in files, the likeliest first."""
ROOM = 470
"""Letters of a message that has its proposal in it."""
LIKE = 0.8
"""Likeness of names from which on they count as alike."""


class Guess(NamedTuple):
    """A column that may be what is asked for.

    Attributes:
        column: its name.
        unit: that its name tells, as in "alt [ft]" and "alt_ft"; "" for none.
    """

    column: str
    unit: str


def guessed(roles: Iterable[str], columns: Iterable[str]) -> dict[str, Guess]:
    """Return the column that each role may be, where one looks like it; no column is taken twice."""
    columns = list(columns)
    pairs = [(role, place, column) for role in roles for place, column in enumerate(columns)]
    scored = sorted(((_likeness(role, column), -place, role, column) for role, place, column in pairs), reverse=True)
    found: dict[str, Guess] = {}
    taken: set[str] = set()
    for score, _, role, column in scored:
        if score > 0 and role not in found and column not in taken:
            found[role] = Guess(column, words_and_unit(column)[1])
            taken.add(column)
    return found


def words_and_unit(column: str) -> tuple[list[str], str]:
    """Return the words of the name of a column, and the unit that it tells; "" for none."""
    spelled = re.sub("[äöüÄÖÜ]", lambda umlaut: _UMLAUTS[umlaut[0].lower()], column)
    plain = unicodedata.normalize("NFKD", spelled).encode("ascii", "ignore").decode()
    inside = re.search(r"[\[(]\s*([^\])]+?)\s*[\])]", column)
    unit = known(inside[1]) if inside else None
    words = [word.lower() for word in re.findall(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+|\d+", re.sub(r"[\[(].*?[\])]", " ", plain))]
    if unit is None and len(words) > 1 and words[-1] in UNITS and len(words[-1]) > 1:
        unit = words[-1]
        words = words[:-1]
    return words, unit or ""


_UMLAUTS = {"ä": "ae", "ö": "oe", "ü": "ue"}


def _likeness(role: str, column: str) -> float:
    """Return how much a column looks like a role, 0 for not at all."""
    words, _ = words_and_unit(column)
    name = "_".join(words)
    if not words:
        return 0.0
    if name == role:
        return 100.0
    likely = WORDS.get(role, role).split()
    for place, word in enumerate(likely):
        parts = word.split("_")
        if name == word:
            return 90.0 - place
        if len(word) > 1 and all(part in words for part in parts):
            return 60.0 - place + 5 * len(parts)
    near = max(difflib.SequenceMatcher(None, name, word).ratio() for word in [role, *likely])
    return 20 * near if near >= LIKE and len(name) > 2 else 0.0


def column(guess: Guess, expected: str) -> str:
    """Return a guess as a value of TOML: a name, with the unit that it tells where another of its kind is expected."""
    # "range_ft" as a bearing in degrees is a guess, and no unit of it
    other = guess.unit and expected and guess.unit != expected and UNITS[guess.unit].kind == UNITS[expected].kind
    name = text(guess.column)
    return f'{{ column = {name}, unit = "{guess.unit}" }}' if other else name


def named(found: Mapping[str, Guess], expected: Mapping[str, str]) -> str:
    """Return the line of TOML that tells what columns are called, by role; units expected of roles beside."""
    told = (quoted(role) + " = " + column(guess, expected.get(role, "")) for role, guess in found.items())
    return f"columns = {{ {', '.join(told)} }}"


def proposing(reason: MissingColumnError, lines: Sequence[str], lost: Sequence[str] = ()) -> FileError:
    """Return a refusal of a table that lacks columns, with a proposal: a line of TOML in it, or several as a note beneath.

    Args:
        reason: the refusal.
        lines: of the table of data, beside the file; none where nothing looks like what is asked for.
        lost: what nothing looks like.
    """
    said = str(reason) + (f" Nothing looks like {', '.join(lost)}." if lost else "")
    if len(lines) == 1 and len(said) + len(lines[0]) < ROOM:
        return FileError(f"{said} Perhaps, under [data]: {lines[0]}")
    error = FileError(said + " Perhaps, in the TOML file:" * bool(lines))
    if lines:
        error.add_note("\n".join(["[data]", f"file = {text(os.path.normpath(reason.path))}", *lines]))
    return error
