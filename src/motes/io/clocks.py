"""Times as people write them: texts to Unix seconds, and seconds to texts of the same form."""

import difflib
import re
from collections.abc import Iterable, Sequence
from datetime import UTC, datetime, timedelta, timezone, tzinfo
from typing import NamedTuple
from zoneinfo import ZoneInfo, available_timezones

import numpy as np

from motes.core.checks import refuse
from motes.core.spelling import meant
from motes.io.dialect import PLAIN, Dialect
from motes.io.instants import EPOCH

FORMS = ("iso", "day first", "month first")
_DATE = re.compile(r"(\d{1,4})([./-])(\d{1,2})\2(\d{1,4})"
                   r"(?:(T|,? +)(\d{1,2}):(\d\d)(?::(\d\d)(?:([.,])(\d{1,9}))?)?( ?[AaPp][Mm])?( ?(?:Z|[+-]\d\d:?\d\d))?)?")  # fmt: skip
"""Year, month and day in any order, hours, minutes and seconds, halves of the day, offset."""
WHOLE = 1e-6
"""Seconds that are nearer to a whole number are one."""


class Clock(NamedTuple):
    """How times were written.

    Attributes:
        format: as of `datetime.strftime`; "" for numbers.
        unit: of numbers, seconds.
        zone: of texts.
        suffix: what texts end with: "", "Z" or "offset".
        given: whether the format is the user's word, and stays as it is.
    """

    format: str = ""
    unit: float = 1.0
    zone: tzinfo = UTC
    suffix: str = ""
    given: bool = False

    def written(self, seconds: Iterable[float]) -> list[str | float]:
        """Return seconds (of texts Unix seconds) as such times."""
        values = np.asarray(seconds, np.float64)
        if not self.format:
            # digits behind what 64 bits hold are noise of the units
            return [float(f"{value / self.unit:.12g}") if self.unit != 1.0 else float(value) for value in values]
        form = self.format if self.given else self._fine_enough(values)
        return [self._text(EPOCH + timedelta(seconds=float(value)), form) for value in values]

    def _fine_enough(self, seconds: np.ndarray) -> str:
        """Return the format with as many digits as the times need."""
        form = self.format
        if "%S" not in form and "%M" in form and (np.abs(seconds / 60 - np.round(seconds / 60)) > WHOLE / 60).any():
            form = form.replace("%M", "%M:%S")
        if "%f" not in form and "%S" in form and (np.abs(seconds - np.round(seconds)) > WHOLE).any():
            form = form.replace("%S", "%S.%f")
        return form

    def _text(self, moment: datetime, form: str) -> str:
        # what lies within a microsecond of a whole second is it
        near = moment.replace(microsecond=0) + timedelta(seconds=1)
        moment = near if near - moment <= timedelta(microseconds=1) else moment
        here = moment.astimezone(self.zone)
        end = "Z" if self.suffix == "Z" else here.isoformat()[-6:] if self.suffix else ""
        return here.strftime(form) + end


def zone_of(name: str) -> tzinfo:
    """Return a time zone by its name; UTC for "".

    Raises:
        MotesError: there is none.
    """
    if not name:
        return UTC
    try:
        return ZoneInfo(name)
    except (KeyError, ValueError, OSError):
        there = sorted(available_timezones())
        near = difflib.get_close_matches(name, there, 3, 0.6) or [one for one in there if name.lower() in one.lower()][:3]
        refuse("time_zone", 'a time zone by its name, such as "Europe/Berlin"', repr(name[:60]), meant(near))


class Reader:
    """Takes the times of one column, one after the other; local ones that come twice, when clocks are set back, go on from those before."""

    def __init__(self, dialect: Dialect = PLAIN):
        """Take the format and the zone.

        Raises:
            MotesError: either is none.
        """
        form = dialect.time_format.strip()
        if form not in FORMS and "%" not in form:
            refuse("time_format", f"one of {', '.join(map(repr, FORMS))}, or a format such as '%d.%m.%Y %H:%M'", repr(form[:60]),
                   'Of numbers the unit is told: units = { time = "ms" }.')  # fmt: skip
        self.form, self.zone = form, zone_of(dialect.time_zone)
        self.before, self.first = -np.inf, ""

    def __call__(self, cell: str) -> float:
        """Return Unix seconds.

        Raises:
            ValueError: the cell is no time of this form.
        """
        moment = self._moment(cell)
        self.first = self.first or cell
        if moment.tzinfo is None:
            moment = moment.replace(tzinfo=self.zone)
            later = moment.replace(fold=1)
            if moment.utcoffset() != later.utcoffset():
                if moment.astimezone(UTC).astimezone(self.zone).replace(tzinfo=None) != moment.replace(tzinfo=None):
                    raise ValueError("a time that the clocks of the zone leave out")
                moment = later if (moment - EPOCH).total_seconds() < self.before else moment
        seconds = (moment - EPOCH).total_seconds()
        self.before = seconds
        return seconds

    def _moment(self, cell: str) -> datetime:
        if "%" in self.form:
            return datetime.strptime(cell, self.form)
        return datetime.fromisoformat(cell) if self.form == "iso" else _of_parts(cell, self.form == "day first")

    def clock(self) -> Clock:
        """Return how the times are written, by the first of them."""
        if "%" in self.form:
            return Clock(self.form, zone=self.zone, given=True)
        form, suffix = form_of(self.first, self.form) or ("%Y-%m-%dT%H:%M:%S", "")
        offset = datetime.fromisoformat(self.first).utcoffset() if suffix and self.form == "iso" else None
        zone = timezone(offset) if offset is not None else UTC if suffix else self.zone
        return Clock(form, zone=zone, suffix=suffix)


def _of_parts(cell: str, day_first: bool) -> datetime:
    """Return a time with the day or the month first.

    Raises:
        ValueError: it is none.
    """
    found = _DATE.fullmatch(cell)
    if found is None or len(found[1]) > 2:
        raise ValueError(cell)
    day, month = (found[1], found[3]) if day_first else (found[3], found[1])
    year = int(found[4]) + (0 if len(found[4]) == 4 else 2000 if int(found[4]) < 70 else 1900)
    hour, half = int(found[6] or 0), (found[11] or "").strip().lower()
    if half:
        if not 1 <= hour <= 12:
            raise ValueError(cell)
        hour = hour % 12 + 12 * (half == "pm")
    fraction = int((found[10] or "").ljust(6, "0")[:6])
    moment = datetime(year, int(month), int(day), hour, int(found[7] or 0), int(found[8] or 0), fraction)
    offset = (found[12] or "").strip()
    return datetime.fromisoformat(moment.isoformat() + offset) if offset else moment


def form_of(cell: str, order: str = "iso") -> tuple[str, str] | None:
    """Return the format of a time as `strftime` has it, and what it ends with ("", "Z" or "offset"); None where it is no date.

    Args:
        cell: the time.
        order: of day and month where the year does not come first.
    """
    found = _DATE.fullmatch(cell.strip())
    if found is None:
        return None
    mark = found[2]
    if len(found[1]) == 4:
        date = f"%Y{mark}%m{mark}%d"
    else:
        year = "%Y" if len(found[4]) == 4 else "%y"
        date = f"%m{mark}%d{mark}{year}" if order == "month first" else f"%d{mark}%m{mark}{year}"
    if found[5] is None:
        return date, ""
    clock = ("%I" if found[11] else "%H") + ":%M" + (":%S" if found[8] else "") + (f"{found[9]}%f" if found[9] else "")
    suffix = "" if found[12] is None else "Z" if "Z" in found[12] else "offset"
    half = "" if found[11] is None else " %p" if found[11][0] == " " else "%p"
    return date + found[5] + clock + half, suffix


def proposed(cells: Sequence[str]) -> str:
    """Return the line of TOML that tells how times are written; "" where that is not known. Days after the 12th tell day from month."""
    dates = [found for found in map(_DATE.fullmatch, (cell.strip() for cell in cells)) if found is not None]
    if not dates:
        return ""
    if len(dates[0][1]) == 4:
        form = form_of(dates[0][0])
        return f'time_format = "{form[0]}"' if form and not form[1] else ""
    days = [(int(date[1]), int(date[3])) for date in dates]
    if any(first > 12 for first, _ in days):
        return 'time_format = "day first"'
    return 'time_format = "month first"' if any(second > 12 for _, second in days) else 'time_format = "day first" (or "month first")'
