"""What the numbers of a recording say of its units, before anything is computed: refusals with the line of TOML that mends them."""

from collections.abc import Iterable, Mapping
from typing import Any, NoReturn

import numpy as np

from motes.core import checks
from motes.io.units import UNITS, as_toml, likely

WHOLE = 10.0
"""Steps from which on whole numbers as times may be milliseconds."""
CLEAR = 1.25
"""Numbers that are less than so many times too large, or too small, may be right."""


def check_ratio(source: str, what: str, ratio: float, given: Mapping[str, str], others: Iterable[str], place: str = "data") -> None:
    """Refuse numbers that are so many times too large or small that another unit explains it.

    Args:
        source: name of the file.
        what: they are, and what they should agree with, such as "groundspeed that agrees with the positions".
        ratio: how many times what they should be they are.
        given: the unit that they are taken to be in, by column or what stands for it under `units`.
        others: units that they may be in.
        place: table that has the units.

    Raises:
        FileError: another unit explains it.
    """
    if not np.isfinite(ratio) or not ratio > 0 or 1 / CLEAR < ratio < CLEAR:
        return
    found = likely(ratio, next(iter(given.values())), others)
    if found is not None:
        mend(source, what, "others", f"They are {times_too(ratio)}: {found}", set_to(as_toml(dict.fromkeys(given, found)), place))


def times_too(ratio: float) -> str:
    """Return in words how many times too large or too small something is."""
    return f"{ratio:.3g} times too large" if ratio > 1 else f"{1 / ratio:.3g} times too small"


def set_to(line: str, place: str = "data") -> str:
    """Return a line of TOML as advice; it stands in a table, or above all of them."""
    return f"If so, {f'under [{place}]' if place else 'above all tables'}: {line}"


def mend(source: str, expected: str, given: str, doubt: str, hint: str) -> NoReturn:
    """Refuse numbers of a file, with what may be so, as a question, and what then mends it.

    Raises:
        FileError: always.
    """
    checks.refuse(source, expected, given, f"{doubt}? {hint}", checks.FileError)


def check_milliseconds(source: str, column: str, seconds: Any, way: Any, slowest: float, place: str = "data") -> None:
    """Refuse times in milliseconds: whole numbers far apart, at which something would hardly have moved.

    Args:
        source: name of the file.
        column: of the times.
        seconds: times as they are taken, `(t,)`.
        way: what was gone in the steps between them, `(t - 1,)`, m.
        slowest: speed below which nothing of this kind moves for long, m/s.
        place: table that has the units.

    Raises:
        FileError: they are.
    """
    steps = np.diff(np.asarray(seconds, np.float64))
    way = np.abs(np.asarray(way, np.float64))
    moved = (steps > 0) & (way > 0)
    if not moved.any() or np.median(steps[moved]) < WHOLE or (steps != np.round(steps)).any():
        return
    speed = float(np.median(way[moved] / steps[moved]))
    if speed < slowest and speed / UNITS["ms"].factor > slowest:
        given = f"steps of {np.median(steps[moved]):g}, in which {np.median(way[moved]):.3g} m are gone"
        mend(source, "times in seconds", given, "Milliseconds",
             set_to(as_toml({column: "ms"}), place))  # fmt: skip
