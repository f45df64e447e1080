"""Columns of numbers and times, from the text of their cells, which know where their rows stand in the file they came from."""

import math
import re
from collections.abc import Callable, Mapping, Sequence
from datetime import UTC, datetime
from typing import Any

import numpy as np

from motes.io.files import reject
from motes.io.instants import EPOCH, times

MISSING = ("", "nan", "na", "n/a", "#n/a", "<na>", "null", "none", "nat")


class Columns(dict[str, np.ndarray]):
    """Columns of a file by name, each float64 `(rows,)`, or text where labels were asked for, and where its rows stand in it.

    Attributes:
        source: name of the file, for messages.
        word: what `places` count, "line" or "row".
        places: where each row stands in the file, `(rows,)`.
        numbers: of the rows among all that were read, from 0, `(rows,)`.
    """

    def __init__(
        self, columns: Mapping[str, np.ndarray], source: str, word: str, places: Sequence[int], numbers: Sequence[int] | None = None
    ):
        """Keep columns, and where they came from; numbers are those of all rows if not given."""
        super().__init__(columns)
        self.source, self.word, self.places = source, word, places
        self.numbers = range(len(places)) if numbers is None else numbers

    def place(self, row: int) -> str:
        """Return what the row with an index is called in messages, such as "line 7 (row 5)"."""
        return f"{self.word} {self.places[row]}" + (f" (row {self.numbers[row] + 1})" if self.word != "row" else "")

    def rows(self, places: np.ndarray) -> "Columns":
        """Return some rows, by their indices `(m,)`."""
        found = {name: column[places] for name, column in self.items()}
        return Columns(found, self.source, self.word, *([where[row] for row in places] for where in (self.places, self.numbers)))

    def by(self, name: str) -> dict[str, "Columns"]:
        """Return the rows of each label of a column of text, in the order in which they come; all under "" where there is no such column.

        Raises:
            FileError: a row has none.
        """
        if name not in self:
            return {"": self}
        texts = self[name]
        if (texts == "").any():
            hint = "Leave the column out where all rows are of one."
            reject(self.source, f"a name or a number in {self.place(int(np.argmax(texts == '')))}, column {name!r}", "none", hint)
        return {text: self.rows(np.flatnonzero(texts == text)) for text in dict.fromkeys(texts.tolist())}

    def times(self, name: str, *, repeats: bool = True) -> tuple[float, np.ndarray]:
        """Split a column of times as `times` does; messages name file, column, and line or row."""
        rows = [self.place(row) for row in range(len(self.places))]
        return times(self[name], repeats=repeats, name=f"{self.source}: column {name!r}", rows=rows)


def labels(cells: Sequence[Any]) -> np.ndarray:
    """Return the cells of a column of text; "" where there is nothing."""
    texts = ["" if cell is None else str(cell).strip() for cell in cells]
    return np.array(["" if text.lower() in MISSING else text for text in texts], object)


def chosen_names(path: Any, names: Sequence[str], wanted: list[str] | None, texts: Sequence[str] = ()) -> list[str]:
    """Return the names of the columns to read, in order; those of texts only where they are there.

    Raises:
        FileError: two columns have one name, or one is not there.
    """
    seen: set[str] = set()
    for name in names:
        if name in seen:
            reject(path, "different column names", f"{name!r} more than once")
        seen.add(name)
    for name in wanted or []:
        if name not in names:
            reject(path, f"a column {name!r}", f"the columns {', '.join(names)[:240]}")
    return list(names) if wanted is None else list(dict.fromkeys([*wanted, *(name for name in texts if name in names)]))


def _converts(convert: Callable[[str], float], cell: str) -> bool:
    try:
        convert(cell)
    except (ValueError, OverflowError):
        return False
    return True


def is_number(cell: str) -> bool:
    """Whether a cell is a number."""
    return _converts(_number, cell)


def _number(cell: str) -> float:
    # float() also takes digits of other scripts and 1_000, which no instrument writes
    if "_" in cell or not cell.isascii():
        raise ValueError(cell)
    return float(cell)


def _time(cell: str) -> float:
    moment = datetime.fromisoformat(cell)
    return ((moment if moment.tzinfo else moment.replace(tzinfo=UTC)) - EPOCH).total_seconds()


def numbers(path: Any, name: str, cells: Sequence[str], lines: Sequence[int], word: str, asked: bool) -> np.ndarray:
    """Turn the cells of one column into numbers; the first cell that is not empty decides whether they are times.

    Args:
        path: the file, for messages.
        name: the column, for messages.
        cells: the text of each row.
        lines: where each row stands in the file.
        word: what `lines` count, "line" or "row".
        asked: whether columns were named.

    Raises:
        FileError: a cell is neither empty nor of the kind of the first one, or infinite; the message names line and column.
    """
    values = np.full(len(cells), np.nan)
    convert, kind = None, ""
    for index, cell in enumerate(map(str.strip, cells)):
        if cell.lower() in MISSING:
            continue
        if convert is None:
            convert, kind = (_number, "a number") if _converts(_number, cell) else (_time, "an ISO 8601 time")
            if not _converts(convert, cell):
                kind = "a number or an ISO 8601 time"
        try:
            values[index] = convert(cell)
        except (ValueError, OverflowError):
            reject(path, f"{kind} in {word} {lines[index]}, column {name!r}", repr(cell[:60]), _advice(cell, asked))
        if math.isinf(values[index]):
            reject(path, f"a finite number in {word} {lines[index]}, column {name!r}", repr(cell[:60]))
    return values


def _advice(cell: str, asked: bool) -> str:
    """Return what to do about a cell that is neither a number nor a time."""
    if re.fullmatch(r"[+-]?\d+,\d+(e[+-]?\d+)?", cell, re.IGNORECASE):
        return "Write a point in place of the decimal comma."
    if re.match(r"\d{1,2}[./-]\d{1,2}[./-]\d{2,4}\b", cell):
        return "Write dates with the year first, such as 2024-01-31T12:30:00Z."
    if re.match(r"\d{1,2}:\d\d", cell):
        return "Write the date too, such as 2024-01-31T12:30:00Z, or seconds since the start."
    if re.match(r"\d{4}-\d\d-\d\d[T ]\d\d", cell):
        return "Write the offset of local times as numbers, such as 2024-01-31T12:30:00+02:00, or Z for UTC."
    return "Leave the cell empty if nothing was measured." if asked else "Name the columns of numbers with columns=."
