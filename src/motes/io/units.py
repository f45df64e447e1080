"""Units by their plain names: a number in one becomes a number in another of the same kind."""

import difflib
import json
from collections.abc import Iterable, Mapping
from typing import NamedTuple

import numpy as np

from motes.core.checks import refuse
from motes.core.spelling import meant


class Unit(NamedTuple):
    """A unit.

    Attributes:
        kind: of quantity, such as "length".
        factor: how many of the first unit of its kind it is.
        zero: where its zero lies, in the first unit of its kind.
    """

    kind: str
    factor: float
    zero: float = 0.0


FOOT, MILE, NAUTICAL, HOUR = 0.3048, 1609.344, 1852.0, 3600.0
_KINDS: dict[str, dict[str, float]] = {
    "length": {"m": 1, "km": 1e3, "cm": 1e-2, "mm": 1e-3, "ft": FOOT, "in": 0.0254, "yd": 3 * FOOT, "mi": MILE, "nmi": NAUTICAL},
    "speed": {"m/s": 1, "km/h": 1e3 / HOUR, "kn": NAUTICAL / HOUR, "mph": MILE / HOUR, "ft/s": FOOT, "ft/min": FOOT / 60, "km/s": 1e3,
              "mm/s": 1e-3, "cm/s": 1e-2},
    "angle": {"rad": 1, "deg": np.pi / 180, "mrad": 1e-3, "gon": np.pi / 200, "arcmin": np.pi / 10_800, "arcsec": np.pi / 648_000,
              "turn": 2 * np.pi},
    "angular rate": {"rad/s": 1, "deg/s": np.pi / 180, "deg/h": np.pi / 648_000, "rpm": np.pi / 30},
    "acceleration": {"m/s^2": 1, "g": 9.80665, "mg": 9.80665e-3, "ft/s^2": FOOT},
    "time": {"s": 1, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60, "h": HOUR, "d": 24 * HOUR},
    "pressure": {"Pa": 1, "hPa": 1e2, "kPa": 1e3, "bar": 1e5, "mbar": 1e2, "psi": 6894.757293168},
    "frequency": {"Hz": 1, "kHz": 1e3, "MHz": 1e6, "GHz": 1e9},
    "share": {"1": 1, "%": 1e-2},
}  # fmt: skip
UNITS = {name: Unit(kind, float(factor)) for kind, units in _KINDS.items() for name, factor in units.items()}
UNITS |= {"K": Unit("temperature", 1.0), "degC": Unit("temperature", 1.0, 273.15), "degF": Unit("temperature", 5 / 9, 273.15 - 160 / 9)}
_OTHERS = {
    "meter": "m", "meters": "m", "metre": "m", "metres": "m", "kilometer": "km", "kilometers": "km", "feet": "ft", "foot": "ft",
    "inch": "in", "inches": "in", "yard": "yd", "yards": "yd", "mile": "mi", "miles": "mi", "nautical miles": "nmi", "NM": "nmi",
    "mps": "m/s", "kmh": "km/h", "kph": "km/h", "knot": "kn", "knots": "kn", "kt": "kn", "kts": "kn", "mi/h": "mph", "fps": "ft/s",
    "fpm": "ft/min", "radian": "rad", "radians": "rad", "degree": "deg", "degrees": "deg", "\N{DEGREE SIGN}": "deg", "dps": "deg/s",
    "m/s2": "m/s^2", "m/s\N{SUPERSCRIPT TWO}": "m/s^2", "sec": "s", "second": "s", "seconds": "s", "msec": "ms", "milliseconds": "ms",
    "\N{MICRO SIGN}s": "us", "microseconds": "us", "nanoseconds": "ns", "minute": "min", "minutes": "min", "hour": "h", "hours": "h",
    "day": "d", "days": "d", "\N{DEGREE SIGN}C": "degC", "celsius": "degC", "\N{DEGREE SIGN}F": "degF", "fahrenheit": "degF",
    "percent": "%", "1/s": "Hz",
}  # fmt: skip
"""Other names of units."""
NEAR = 0.2
"""Share by which a ratio may miss that of two units and still be taken for it."""


def known(name: str) -> str | None:
    """Return the plain name of a unit, or None where it is none; upper and lower case count only where they tell units apart."""
    plain = name.strip()
    if plain in UNITS or plain in _OTHERS:
        return _OTHERS.get(plain, plain)
    # "nm" is a nanometer to some and a nautical mile to others
    found = {_OTHERS.get(one, one) for one in (*UNITS, *_OTHERS) if one.lower() == plain.lower() != "nm"}
    return found.pop() if len(found) == 1 else None


def unit(place: str, name: str, expected: str = "") -> Unit:
    """Return a unit by name.

    Args:
        place: what has it, for messages.
        name: of the unit.
        expected: one of the kind that it must be of; any kind if empty.

    Raises:
        MotesError: there is none of that name, or it is of another kind.
    """
    kinds = {UNITS[expected].kind} if expected else set(_KINDS) | {"temperature"}
    of_kind = [one for one, unit in UNITS.items() if unit.kind in kinds]
    found = known(name)
    if found is None:
        there = (*UNITS, *_OTHERS)
        near = difflib.get_close_matches(name, there, 3, 0.5) or difflib.get_close_matches(name.lower(), there, 3, 0.5)
        likely = list(dict.fromkeys(_OTHERS.get(one, one) for one in near))
        refuse(place, f"a unit, such as {', '.join(of_kind[:12])}", repr(name[:40]), meant(likely))
    if UNITS[found].kind not in kinds:
        refuse(place, f"a unit of {kinds.pop()}: {', '.join(of_kind)}", f"{name[:40]!r}, one of {UNITS[found].kind}")
    return UNITS[found]


def converted(place: str, values: np.ndarray, name: str, expected: str = "") -> np.ndarray:
    """Return numbers in a unit as numbers in another; in the first of its kind (m, m/s, rad, s, ...) if no other is expected.

    Raises:
        MotesError: there is no such unit, or it is of another kind.
    """
    of = unit(place, name, expected)
    to = UNITS[expected] if expected else Unit(of.kind, 1.0)
    return (values * of.factor + of.zero - to.zero) / to.factor


def back_to(values: np.ndarray, name: str, expected: str) -> np.ndarray:
    """Return numbers in the expected unit as the user has them: the inverse of `converted`; the same for no name."""
    if not name:
        return values
    of, to = unit(name, name, expected), UNITS[expected]
    return (values * to.factor + to.zero - of.zero) / of.factor


def likely(ratio: float, given: str, others: Iterable[str]) -> str | None:
    """Return in which of other units numbers are that are so many times what they should be in a given one; None where in none."""
    factor = UNITS[given].factor
    off = {name: abs(np.log(ratio * UNITS[name].factor / factor)) for name in others} if ratio > 0 else {}
    best = min(off, key=lambda name: off[name], default=None)
    return best if best is not None and off[best] < np.log1p(NEAR) else None


def as_toml(units: Mapping[str, str]) -> str:
    """Return the line of TOML that tells units of columns."""
    return "units = { " + ", ".join(f'{quoted(name)} = "{unit}"' for name, unit in units.items()) + " }"


def quoted(name: str) -> str:
    """Return a name as the key of a TOML table."""
    return name if name.isascii() and name.replace("_", "").replace("-", "").isalnum() else text(name)


def text(value: str) -> str:
    """Return a text as TOML has it."""
    return json.dumps(value, ensure_ascii=False)
