"""Times, with or without a unit of their own, as seconds that survive 32-bit arithmetic."""

from collections.abc import Sequence
from datetime import UTC, date, datetime
from typing import Any

import numpy as np

from motes.core.checks import refuse

EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
TICKS = {"s": 1, "ms": 10**3, "us": 10**6, "ns": 10**9, "ps": 10**12, "fs": 10**15, "as": 10**18}
"""Parts of a second."""
SAME = 1e-6
"""Times that differ by less, in seconds, are one."""
LONG = {"m": 60, "h": 3600, "D": 86_400, "W": 604_800}
"""Seconds of longer units."""


def times(values: Any, *, repeats: bool = True, name: str = "times", rows: Sequence[str] = ()) -> tuple[float, np.ndarray]:
    """Split times into a start and the seconds since.

    Unix times near 1.7e9 s are 128 s apart in float32, so the start is subtracted before any cast; over long recordings
    take `np.diff` of the seconds before casting too.

    Args:
        values: times `(t,)`: numbers of seconds, or with a unit of their own: NumPy's datetime64 or timedelta64 of any unit, what pandas
            makes of them, or objects of `datetime`. Those without a time zone are UTC.
        repeats: whether equal neighbors are allowed.
        name: what the times are called in messages.
        rows: what each row is called in messages; "row 1" and so on if not given.

    Returns:
        The first time (of dates: in Unix seconds), and the seconds since then as float64 `(t,)`.

    Raises:
        MotesError: times are missing, infinite, decrease, or repeat where that is not allowed; the row is named.
    """
    start, seconds = in_seconds(values, name)
    if seconds.ndim != 1 or not seconds.size:
        refuse(name, "a row of at least one time", f"shape {seconds.shape}")
    order = "times that never decrease" if repeats else "times that increase"
    steps = np.diff(seconds)
    good = np.isfinite(seconds) & np.concatenate([[True], steps >= 0 if repeats else steps > 0])
    if not good.all():
        row = int(np.argmin(good))
        order = order if np.isfinite(seconds[row]) else "a time in every row"
        given = f"{start + seconds[row]!s}" if np.isfinite(seconds[row]) else "none" if np.isnan(seconds[row]) else "an infinite one"
        before = f" after {start + seconds[row - 1]!s}" if row else ""
        refuse(name, order, f"{given}{before} in {rows[row] if len(rows) else f'row {row + 1} (line {row + 2} of a table with names)'}")
    return start + float(seconds[0]), seconds - seconds[0]


def in_seconds(values: Any, name: str = "times") -> tuple[float, np.ndarray]:
    """Return times as a start in seconds and the seconds since then; what stands for no time is NaN.

    Of dates the difference is taken in whole ticks, before anything is rounded.

    Args:
        values: numbers of seconds, `datetime64` or `timedelta64` of any unit, what pandas makes of them, or `datetime` objects; those
            without a time zone are UTC.
        name: what they are called in messages.

    Returns:
        The start (of dates Unix seconds, of numbers and durations 0), and float64 of the shape of the values.

    Raises:
        MotesError: they are none of these.
    """
    try:
        array = without_zone(values)
        if array.dtype.kind not in "biufmM":
            raise TypeError
    except (TypeError, ValueError, OverflowError):
        refuse(name, "numbers of seconds, or times with a unit of their own", type(values).__name__[:60],
               "Texts become times by np.array(texts, 'datetime64[ms]') or pandas.to_datetime.")  # fmt: skip
    return _ticks(array, name) if array.dtype.kind in "mM" else (0.0, array.astype(np.float64))


def without_zone(values: Any) -> np.ndarray:
    """Return times, or numbers, as NumPy has them: instants with a time zone, of pandas or `datetime`, in UTC.

    Raises:
        TypeError: objects are neither.
        ValueError: likewise.
    """
    if getattr(getattr(values, "dtype", None), "tz", None) is not None:
        # pandas keeps instants with a time zone; those of a column have their methods under .dt
        instants = getattr(values, "dt", values)
        values = instants.tz_convert("UTC").tz_localize(None) if instants is values else instants.tz_convert("UTC").dt.tz_localize(None)
    array = np.asarray(values)
    return _objects(array) if array.dtype == object else array


def _objects(array: np.ndarray) -> np.ndarray:
    """Return an array of objects as one of times, or of numbers where there are no times."""
    flat = array.reshape(-1).tolist()
    if not any(isinstance(item, (date, np.datetime64)) for item in flat):
        return array.astype(np.float64)
    return np.array([_instant(item) for item in flat]).reshape(array.shape)


def _instant(item: Any) -> np.datetime64:
    if item is None or item != item:  # noqa: PLR0124 (what stands for no time differs from itself)
        return np.datetime64("NaT", "ns")
    if isinstance(item, datetime):
        aware = item if item.tzinfo else item.replace(tzinfo=UTC)
        return np.datetime64(aware.astimezone(UTC).replace(tzinfo=None))
    if isinstance(item, (date, np.datetime64)):
        return np.datetime64(item)
    raise TypeError


def _ticks(array: np.ndarray, name: str) -> tuple[float, np.ndarray]:
    unit, count = np.datetime_data(array.dtype)
    if unit in ("Y", "M"):
        if array.dtype.kind == "m":
            refuse(name, "durations in days or shorter units", f"units of {unit!r}", "Months differ in length.")
        array, unit, count = array.astype("datetime64[D]"), "D", 1
    if unit not in TICKS and unit not in LONG:
        refuse(name, "times with a unit", "a number of no unit")
    missing = np.isnat(array)
    ticks = np.where(missing, 0, array.astype(np.int64))
    first = int(ticks[~missing].flat[0]) if not missing.all() else 0
    since = np.where(missing, np.nan, _seconds(ticks - first, unit, count)) if array.dtype.kind == "M" else None
    if since is None:
        return 0.0, np.where(missing, np.nan, _seconds(ticks, unit, count))
    return float(_seconds(np.array(first), unit, count)), since


def _seconds(ticks: np.ndarray, unit: str, count: int) -> np.ndarray:
    if unit in LONG:
        return ticks.astype(np.float64) * (LONG[unit] * count)
    whole, rest = np.divmod(ticks, TICKS[unit])
    return (whole + rest / TICKS[unit]) * count
