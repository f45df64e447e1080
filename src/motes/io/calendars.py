"""Regular axes of time: the step from row to row, which rows are missing, how they go on; in steps of months and weekdays, too."""

from collections.abc import Callable
from datetime import UTC
from typing import Any, NamedTuple
from zoneinfo import ZoneInfo, ZoneInfoNotFoundError

import numpy as np

DAY = np.timedelta64(1, "D")
NEAR = 1e-3
"""Share of a step by which floating-point numbers may miss their place."""
DAYS: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "first": lambda months: months.astype("datetime64[D]"),
    "last": lambda months: (months + 1).astype("datetime64[D]") - DAY,
    "last weekday": lambda months: np.busday_offset((months + 1).astype("datetime64[D]"), -1, roll="forward"),
    "first weekday": lambda months: np.busday_offset(months.astype("datetime64[D]"), 0, roll="forward"),
}
"""Days of months that a calendar may go by; the one that dates are equally far from first."""
CLOCK = ((86_400, "day"), (3_600, "hour"), (60, "minute"), (1, "second"))


class Calendar(NamedTuple):
    """A regular axis.

    Attributes:
        kind: "number" or "time", of equal steps; "month" or "weekday".
        first: where it begins, in the form in which steps are counted.
        step: number, duration, or number of months or weekdays, from place to place.
        within: what comes on top of the date of a month or a weekday: the time of day, and the day of the month.
        day: of months: the one from which `within` counts, a name in DAYS.
        zone: time zone whose clock the steps go by; empty where it is UTC, or none is known.
    """

    kind: str
    first: Any
    step: Any
    within: np.timedelta64 = np.timedelta64(0, "s")
    day: str = "first"
    zone: str = ""

    def shown(self, places: np.ndarray) -> np.ndarray:
        """Return numbers, or times by the clock of the zone, at places `(k,)`, whole numbers that count from 0 at the first row."""
        if self.kind in ("number", "time"):
            return self.first + places * self.step
        if self.kind == "weekday":
            return np.busday_offset(self.first, places * self.step) + self.within
        return DAYS[self.day](self.first + places * self.step) + self.within

    def at(self, places: np.ndarray, dtype: np.dtype) -> np.ndarray:
        """Return the same, times in UTC."""
        return (_to_utc(self.shown(places), self.zone) if self.zone else self.shown(places)).astype(dtype)

    @property
    def words(self) -> str:
        """What a step is called, several of them."""
        if self.kind in ("month", "weekday"):
            return _counted(int(self.step), self.kind)
        if self.kind == "number":
            return "steps" if self.step == 1 else f"steps of {self.step:g}"
        seconds = self.step / np.timedelta64(1, "s")
        length, name = next(((length, name) for length, name in CLOCK if seconds % length == 0), (None, ""))
        return f"steps of {seconds:g} s" if length is None else _counted(int(seconds // length), name)


def _counted(number: int, name: str) -> str:
    return f"{name}s" if number == 1 else f"steps of {number} {name}s"


def calendar(index: np.ndarray, zone: str = "") -> tuple[Calendar, np.ndarray] | None:
    """Find the regular axis that rows are on, at places with gaps or without.

    An axis is regular where more than half of its rows follow the one before by one step, the others by several, and no more rows are
    missing than there are.

    Args:
        index: numbers, datetime64 in UTC or timedelta64 that never decrease, `(t,)`.
        zone: time zone by whose clock the steps may be regular, where they are not in UTC.

    Returns:
        The axis and the place of each row, whole numbers from 0 on; None where there is none.
    """
    if len(index) < 2:
        return None
    if index.dtype.kind != "M":
        return _even(index, "number" if index.dtype.kind != "m" else "time")
    # days of a zone are not all as long: its own clock goes first where steps are long
    long = bool((np.diff(index) > np.timedelta64(20, "h")).all())
    for clock in ("",) if zone in ("", "UTC") else (zone, "") if long else ("", zone):
        local = _to_clock(index, clock) if clock else index
        found = None if local is None else _weekdays(local) or _even(local, "time") or _months(local)
        if found is not None:
            return found[0]._replace(zone=clock), found[1]
    return None


def _even(index: np.ndarray, kind: str) -> tuple[Calendar, np.ndarray] | None:
    apart = np.diff(index)
    if index.dtype.kind == "f":
        step = float(np.median(apart))
        counts = np.round(apart / step) if step > 0 else apart
        if not step > 0 or (np.abs(apart - counts * step) >= NEAR * step).any():
            return None
        return _if_regular(Calendar(kind, index[0], float((index[-1] - index[0]) / counts.sum())), counts)
    whole = apart.astype(np.int64)
    values, often = np.unique(whole, return_counts=True)
    most = int(values[np.argmax(often)])
    if most <= 0 or (whole % most).any():
        return None
    step = most if apart.dtype.kind != "m" else np.timedelta64(most, np.datetime_data(apart.dtype)[0])
    return _if_regular(Calendar(kind, index[0], step), whole // most)


def _weekdays(index: np.ndarray) -> tuple[Calendar, np.ndarray] | None:
    """Return the axis of the days from Monday to Friday."""
    days = index.astype("datetime64[D]")
    within = index - days
    if (within != within[0]).any() or not np.is_busday(days).all() or days[-1] - days[0] < 6 * DAY or (np.diff(days) < DAY).any():
        return None
    counts = np.busday_count(days[:-1], days[1:])
    return _if_regular(Calendar("weekday", days[0], 1, within[0]), counts) if (np.diff(days) == DAY).any() else None


def _months(index: np.ndarray) -> tuple[Calendar, np.ndarray] | None:
    """Return the axis of some day of the months, or of the last one of each, or of the first or last from Monday to Friday."""
    months = index.astype("datetime64[M]")
    found = _even(months, "month")
    if found is None:
        return None
    for name, day in DAYS.items():
        within = index - day(months)
        if (within == within[0]).all():
            step = int(found[0].step / np.timedelta64(1, "M"))
            return Calendar("month", months[0], step, within[0], name), found[1]
    return None


def _if_regular(found: Calendar, counts: np.ndarray) -> tuple[Calendar, np.ndarray] | None:
    places = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
    single = 2 * int((counts == 1).sum()) > len(counts)
    return (found, places) if single and (counts > 0).all() and places[-1] < 2 * len(places) else None


def _to_clock(index: np.ndarray, zone: str) -> np.ndarray | None:
    """Return what the clocks of a time zone show, of times in UTC; None of a zone that is not known."""
    try:
        known = ZoneInfo(zone)
    except (ZoneInfoNotFoundError, ValueError, OSError):
        return None
    shown = [moment.replace(tzinfo=UTC).astimezone(known).replace(tzinfo=None) for moment in index.astype("datetime64[us]").tolist()]
    return np.array(shown, "datetime64[us]")


def _to_utc(shown: np.ndarray, zone: str) -> np.ndarray:
    known = ZoneInfo(zone)
    moments = [one.replace(tzinfo=known).astimezone(UTC).replace(tzinfo=None) for one in shown.astype("datetime64[us]").tolist()]
    return np.array(moments, "datetime64[us]")
