"""What stands beside the numbers of a table: the times of its rows, the names of its columns."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from motes.core import checks
from motes.core.record import record, replace, static
from motes.io import instants
from motes.io.calendars import calendar

NAMED = 5
"""So many missing times are named in a message."""


@record
class Labels:
    """What stands beside numbers.

    Attributes:
        index: of each row, `(t,)`: datetime64 (in UTC where there is a zone), timedelta64 or numbers; None where rows have none.
        columns: names of the columns; none where they have no names.
        name: of the index.
        zone: time zone in which the index was given; empty where it had none.
        period: what pandas calls the periods that rows are, such as "M" for months; empty where rows are moments.
    """

    index: np.ndarray | None = static(default=None)
    columns: tuple[str, ...] = static(default=())
    name: str = static(default="")
    zone: str = static(default="")
    period: str = static(default="")

    @property
    def are_times(self) -> bool:
        """Whether rows have dates or durations."""
        return self.index is not None and self.index.dtype.kind in "mM"

    def seconds(self) -> np.ndarray | None:
        """Return the times of rows in seconds, of dates Unix seconds, float64 `(t,)`; None where rows have none."""
        if not self.are_times:
            return None
        start, since = instants.in_seconds(self.index)
        return start + since

    def rows(self, part: slice) -> "Labels":
        """Return the labels of some rows."""
        return self if self.index is None else replace(self, index=self.index[part])

    def continued(self, steps: int) -> np.ndarray | None:
        """Return the index of so many further rows, `(steps,)`; None where the rows are on no regular axis.

        A gap within the rows does not matter: they go on with the step that they have elsewhere.
        """
        found = None if self.index is None else calendar(self.index, self.zone)
        if found is None:
            return None
        axis, places = found
        return axis.at(places[-1] + 1 + np.arange(steps), self.index.dtype)  # type: ignore[union-attr]

    def pandas_index(self) -> Any:
        """Return pandas' index, as it was given; pandas must be there."""
        pandas: Any = checks.need("pandas", "results")
        name = self.name or None
        if self.period:
            return pandas.PeriodIndex(pandas.DatetimeIndex(self.index), freq=self.period, name=name)
        if self.are_times and self.index.dtype.kind == "M":  # type: ignore[union-attr]
            moments = pandas.DatetimeIndex(self.index, name=name)
            return moments.tz_localize("UTC").tz_convert(self.zone) if self.zone else moments
        return pandas.Index(self.index, name=name)


@record
class Labelled:
    """Numbers with labels: what `filled` gives; all that takes measurements takes it.

    Attributes:
        values: `(t, y)`.
        labels: names of its columns and times of its rows.
    """

    values: np.ndarray
    labels: Labels = static()


def agree(argument: str, expected: str, one: Labels | None, other: Labels | None, hint: str) -> None:
    """Refuse labels whose index is another, where both have one of a kind.

    Args:
        argument: what the other is called.
        expected: what its index should be.
        one: labels.
        other: labels that must agree with them.
        hint: what to do.

    Raises:
        MotesError: they do not; the message names the first row.
    """
    if one is None or other is None or one.index is None or other.index is None or one.are_times != other.are_times:
        return
    a, b = one.index, other.index
    if a.dtype.kind != b.dtype.kind or (len(a) == len(b) and (a == b).all()):
        return
    shorter = min(len(a), len(b))
    differ = np.flatnonzero(a[:shorter] != b[:shorter])
    row = int(differ[0]) if differ.size else shorter
    shown = [str(x[row]) if row < len(x) else "none" for x in (a, b)]
    checks.refuse(argument, f"{expected} ({len(a)} rows, {shown[0]} in row {row})", f"{len(b)} rows, {shown[1]} there", hint)


def labels_joined(each: Sequence[Labels | None]) -> Labels | None:
    """Return the labels of tables behind one another; None where one has none, or has times of another kind."""
    first = each[0]
    if first is None or any(other is None or replace(other, index=None) != replace(first, index=None) for other in each):
        return None
    parts = [labels.index for labels in each if labels is not None and labels.index is not None]
    if not parts:
        return first
    alike = len(parts) == len(each) and len({part.dtype.kind for part in parts}) == 1
    return replace(first, index=np.concatenate(parts)) if alike else None


def untold_gaps(argument: str, labels: Labels | None) -> None:
    """Warn in one line of rows that are missing on a regular axis."""
    found = None if labels is None or labels.index is None else calendar(labels.index, labels.zone)
    if found is None or found[1][-1] + 1 == len(found[1]):
        return
    axis, places = found
    lacking = np.setdiff1d(np.arange(places[-1] + 1), places)
    named = ", ".join(map(in_words, axis.shown(lacking[:NAMED])))
    more = f" and {len(lacking) - NAMED} more" if len(lacking) > NAMED else ""
    rows = f"{len(lacking)} of {places[-1] + 1} {axis.words} {'is' if len(lacking) == 1 else 'are'} missing ({named}{more})"
    text = f"{argument}: {rows}; the model takes one step over each gap."
    checks.warn(f"{text} mo.io.filled({argument}) has them, as not measured; an array of the values alone has no gaps.")


def in_words(moment: Any) -> str:
    """Return a moment or a number as people write it, without what is zero at the end of it."""
    text = str(moment)
    for empty in (".000000000", ".000000", ".000", "T00:00:00", "T00:00"):
        text = text.removesuffix(empty)
    return text


def labels_of(argument: str, times: Any, name: str = "", zone: str = "", period: str = "") -> Labels | None:
    """Return labels of rows with times or numbers; None where they have none of use: texts, numbers that are in no order.

    Args:
        argument: what they belong to, in messages.
        times: `(t,)`: NumPy array, what pandas makes of times, or a list of `datetime` objects.
        name: of the index.
        zone: time zone, where times are in UTC and do not tell themselves.
        period: what pandas calls the periods that rows are.

    Raises:
        MotesError: times are missing or decrease.
    """
    zone = zone or str(getattr(getattr(times, "dtype", None), "tz", None) or "")
    if any(type(moment).__module__.startswith("cftime") for moment in times[:1]):
        checks.refuse(f"{argument} index", "datetime64", type(times[0]).__name__, "Convert it: data.convert_calendar('standard').")
    try:
        times = instants.without_zone(times)
    except (TypeError, ValueError, OverflowError):  # texts and categories are no times
        return None
    if times.dtype.kind not in "iufmM" or times.ndim != 1 or not len(times):
        return None
    if times.dtype.kind == "M" and np.datetime_data(times.dtype)[0] in ("Y", "M", "W"):
        times = times.astype("datetime64[D]")
    if times.dtype.kind in "mM":
        if np.isnat(times).any() or (times[1:] < times[:-1]).any():
            instants.times(times, name=f"{argument} index", rows=[f"row {row}" for row in range(len(times))])
    elif not (np.isfinite(times).all() and (np.diff(times) > 0).all()):
        return None
    return Labels(times, (), name, zone, period)
