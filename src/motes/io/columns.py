"""Columns of numbers and times, from the text of their cells, which know where their rows stand in the file they came from."""

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from motes.core.checks import FileError, refuse
from motes.core.spelling import perhaps
from motes.io.clocks import Clock, Reader, proposed
from motes.io.dialect import PLAIN, Dialect
from motes.io.files import label, reject
from motes.io.instants import times
from motes.io.units import UNITS, converted, known

MISSING = ("", "nan", "na", "n/a", "#n/a", "<na>", "null", "none", "nat")


class MissingColumnError(FileError):
    """A file lacks a column.

    Attributes:
        path: of the file.
        names: of the columns that it has.
    """

    path: Any
    names: list[str]


class Columns(dict[str, np.ndarray]):
    """Columns of a file by name, each float64 `(rows,)`, or text where labels were asked for, and where its rows stand in it.

    Attributes:
        source: name of the file, for messages.
        word: what `places` count, "line" or "row".
        places: where each row stands in the file, `(rows,)`.
        numbers: of the rows among all that were read, from 0, `(rows,)`.
        clocks: how the times of columns of times were written, by column.
    """

    def __init__(
        self, columns: Mapping[str, np.ndarray], source: str, word: str, places: Sequence[int], numbers: Sequence[int] | None = None,
        clocks: Mapping[str, Clock] | None = None,
    ):  # fmt: skip
        """Keep columns, and where they came from; numbers are those of all rows if not given."""
        super().__init__(columns)
        self.source, self.word, self.places = source, word, places
        self.numbers = range(len(places)) if numbers is None else numbers
        self.clocks = dict(clocks or {})

    def place(self, row: int) -> str:
        """Return what the row with an index is called in messages, such as "line 7 (row 5)"."""
        return f"{self.word} {self.places[row]}" + (f" (row {self.numbers[row] + 1})" if self.word != "row" else "")

    def rows(self, places: np.ndarray) -> "Columns":
        """Return some rows, by their indices `(m,)`."""
        found = {name: column[places] for name, column in self.items()}
        where = ([numbers[row] for row in places] for numbers in (self.places, self.numbers))
        return Columns(found, self.source, self.word, *where, clocks=self.clocks)

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

    def called(self, names: Mapping[str, str]) -> "Columns":
        """Return the same columns by other names, each by that which it has in the file."""
        found = {name: self[there] for name, there in names.items() if there in self}
        clocks = {name: self.clocks[there] for name, there in names.items() if there in self.clocks}
        return Columns(found, self.source, self.word, self.places, self.numbers, clocks)


def labels(cells: Sequence[Any]) -> np.ndarray:
    """Return the cells of a column of text; "" where there is nothing."""
    texts = ["" if cell is None else str(cell).strip() for cell in cells]
    return np.array(["" if text.lower() in MISSING else text for text in texts], object)


def chosen_names(
    path: Any, names: Sequence[str], wanted: list[str] | None, texts: Sequence[str] = (), dialect: Dialect = PLAIN
) -> list[str]:
    """Return the names of the columns to read, in order; those of texts only where they are there.

    Raises:
        FileError: two columns have one name, or one is not there.
        MotesError: a unit is told of a column that is not there.
    """
    seen: set[str] = set()
    for name in names:
        if name in seen:
            reject(path, "different column names", f"{name!r} more than once")
        seen.add(name)
    for name in wanted or []:
        if name not in names:
            error = MissingColumnError(f"{label(path)}: expected a column {name!r}, got the columns {', '.join(names)[:160]}.")
            error.path, error.names = path, list(names)
            raise error
    check_names_of_units(path, names, dialect)
    return list(names) if wanted is None else list(dict.fromkeys([*wanted, *(name for name in texts if name in names)]))


@dataclass(frozen=True)
class Cells:
    """Where cells come from, and how they are to be read.

    Attributes:
        path: the file, for messages.
        word: what `lines` count, "line" or "row".
        lines: where each row stands in the file.
        dialect: how the table is written.
        expected: unit that is expected of a column, by its name in the file; others become the first unit of their kind (m, s, rad, ...).
        asked: whether columns were named.
    """

    path: Any
    word: str
    lines: Sequence[int]
    dialect: Dialect = PLAIN
    expected: Mapping[str, str] = field(default_factory=dict)
    asked: bool = True

    def column(self, name: str, cells: Sequence[str]) -> tuple[np.ndarray, Clock | None]:
        """Turn the cells of one column into numbers; the first cell that is not missing decides whether they are times.

        Returns:
            The numbers, NaN for what is missing, and of times how they were written.

        Raises:
            FileError: a cell is neither missing nor of the kind of the first one, or infinite; the message names line and column.
            MotesError: a unit or the format of times is none.
        """
        values = np.full(len(cells), np.nan)
        nothing = {*MISSING, *(code.strip().lower() for code in self.dialect.missing)}
        convert: Callable[[str], float] | None = None
        kind = ""
        for index, cell in enumerate(map(str.strip, cells)):
            if cell.lower() in nothing:
                continue
            if convert is None:
                convert, kind = self._kind(name, cell)
            try:
                values[index] = convert(cell)
            except (ValueError, OverflowError):
                hint = self._advice(cell, cells)
                reject(self.path, f"{kind} in {self.word} {self.lines[index]}, column {name!r}", repr(cell[:60]), hint)
            if math.isinf(values[index]):
                reject(self.path, f"a finite number in {self.word} {self.lines[index]}, column {name!r}", repr(cell[:60]))
        if isinstance(convert, Reader):
            self.refuse_unit(name)
            return values, convert.clock()
        return self.plain(name, values), None

    def plain(self, name: str, values: np.ndarray) -> np.ndarray:
        """Return numbers with NaN for the codes of what is missing, in the unit that is expected.

        Raises:
            MotesError: the unit of the column is none, or of another kind.
        """
        codes = [float(code) for code in self.dialect.missing if is_number(code)]
        if codes:
            values = np.where(np.isin(values, codes), np.nan, values)
        unit = self.dialect.units.get(name)
        return values if unit is None else converted(f"units {name}", values, unit, self.expected.get(name, ""))

    def clock(self, name: str) -> Clock:
        """Return how the times of a column of numbers are written: in its unit."""
        unit = UNITS[known(self.dialect.units.get(name, "s")) or "s"]
        return Clock(unit=unit.factor if unit.kind == "time" else 1.0)

    def refuse_unit(self, name: str) -> None:
        """Refuse a unit of a column of dates.

        Raises:
            FileError: one is told.
        """
        if name in self.dialect.units:
            reject(self.path, f"numbers in column {name!r}, for which a unit is given", "dates")

    def _kind(self, name: str, cell: str) -> tuple[Callable[[str], float], str]:
        """Return what reads the cells of a column, by its first, and what they are."""
        is_time = self.expected.get(name) == "s" and "%" in self.dialect.time_format
        number = self._number
        if not is_time and _converts(number, cell):
            return number, "a number"
        reader = Reader(self.dialect)
        what = {"iso": "an ISO 8601 time"}.get(reader.form, f"a time of the form {reader.form!r}")
        fits = _converts(Reader(self.dialect), cell)
        return reader, what if fits else f"a number or {what}"

    def _number(self, cell: str) -> float:
        return number_of(cell, self.dialect.decimal)

    def _advice(self, cell: str, cells: Sequence[str]) -> str:
        """Return what to do about a cell that is neither a number nor a time."""
        if self.dialect.decimal == "." and re.fullmatch(r"[+-]?\d+,\d+(e[+-]?\d+)?", cell, re.IGNORECASE):
            return 'Set decimal = "," where the file is named (--data.decimal ,).'
        if self.dialect.decimal == "," and re.fullmatch(r"[+-]?\d*\.\d+", cell):
            return 'Set decimal = "."; with commas for decimals points cannot group thousands.'
        form = proposed(cells)
        if form and self.dialect.time_format == "iso":
            zone = "" if self.dialect.time_zone else ', and time_zone = "Europe/Berlin" or another, unless they are UTC'
            return f"Set {form}{zone}."
        if re.match(r"\d{1,2}:\d\d", cell):
            return 'Set time_format = "%H:%M:%S" where these are times of one day.'
        if re.match(r"\d{4}-\d\d-\d\d[T ]\d\d", cell):
            return 'Write the offset of local times as numbers, such as +02:00, or none, and set time_zone = "Europe/Berlin" or another.'
        code = f'missing = ["{cell[:20]}"]' if len(cell) <= 20 and '"' not in cell else "missing"
        return f"If nothing was measured there: {code}." if self.asked else 'Name the columns to read: columns = ["a", "b"].'


def check_names_of_units(path: Any, names: Sequence[str], dialect: Dialect) -> None:
    """Refuse units of columns that are not there.

    Raises:
        MotesError: naming the first.
    """
    for name in dialect.units:
        if name not in names:
            expected = f"names of columns of {label(path)}: {', '.join(names)[:200]}"
            refuse("units", expected, repr(name[:60]), perhaps(name, names, 1))


def made_of(source: Cells, cells: Mapping[str, Any], texts: Sequence[str], read: Callable[..., Any] = Cells.column) -> Columns:
    """Return columns of a file as columns of numbers and times, and of text.

    Args:
        source: where they come from.
        cells: of each column, as the file has them.
        texts: names of columns of text.
        read: gives the numbers of a column, of source, name and cells, and how they were written if they are times; see `Cells.column`.
    """
    found, clocks = {}, {}
    for name, column in cells.items():
        if name in texts:
            found[name] = labels(column)
        else:
            found[name], clock = read(source, name, column)
            clocks[name] = clock or source.clock(name)
    return Columns(found, label(source.path), source.word, source.lines, clocks=clocks)


def _converts(convert: Callable[[str], float], cell: str) -> bool:
    try:
        convert(cell)
    except (ValueError, OverflowError):
        return False
    return True


def is_number(cell: str) -> bool:
    """Whether a cell is a number."""
    return _converts(number_of, cell)


def number_of(cell: str, decimal: str = ".") -> float:
    """Return the number that a cell is.

    Raises:
        ValueError: it is none.
    """
    # float() also takes digits of other scripts and 1_000, which no instrument writes
    if "_" in cell or not cell.isascii() or (decimal != "." and "." in cell):
        raise ValueError(cell)
    return float(cell.replace(decimal, ".") if decimal != "." else cell)
