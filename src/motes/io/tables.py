"""Tables of numbers and times from CSV, JSON and Parquet files."""

import csv
import io
import os
import re
from array import array
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from motes.core.checks import need, refuse
from motes.io.clocks import Clock
from motes.io.columns import MISSING, Cells, Columns, chosen_names, is_number, made_of
from motes.io.dialect import PLAIN, Dialect
from motes.io.files import foreign, look, reject
from motes.io.instants import TICKS
from motes.io.instants import times as times
from motes.io.json_tables import JSON_START, json_columns, read_json, unzipped

DELIMITERS = ",;\t|"
SEPARATORS = {"tab": "\t", "\\t": "\t", "comma": ",", "semicolon": ";", "space": " ", "spaces": " "}
"""Names of separators."""
LINE_END = re.compile("\r\n|\r|\n")
MARKS = re.compile(r"%|//|;|!|--|\*")
"""What lines of comments begin with elsewhere."""
_EMPTY = 'An empty cell of a single column is written "".'
_DECIMAL_COMMA = "If commas stand for decimal points, columns must be apart by another mark, or cells in quotes: save the table so."
LARGEST = 20_000_000
WIDEST = 100_000
GZIP = b"\x1f\x8b"


def read_table(
    path: str | os.PathLike[str],
    columns: Sequence[str] | None = None,
    texts: Sequence[str] = (),
    dialect: Dialect = PLAIN,
    expected: Mapping[str, str] | None = None,
) -> Columns:
    """Read columns of numbers and times from a CSV, JSON or Parquet file, told apart by its content; the first two may be zipped by gzip.

    A CSV file is UTF-8 text with one line of names, separated by commas, semicolons, tabs, | or spaces; lines that begin with `#` are
    comments. Empty cells, `NaN`, `NA`, `N/A`, `null` and `None` are NaN. Times (ISO 8601, or Parquet timestamps and dates) become Unix
    seconds; without an offset they are UTC. A JSON file is a list of records or a table of columns, as pandas writes them. Whatever else
    a file may be is told by a dialect.

    Args:
        path: the file.
        columns: names of the columns to read, in this order; all if not given.
        texts: names of columns of text, such as names of aircraft; they are read where the file has them.
        dialect: how the table is written.
        expected: the unit of columns for which the dialect tells another, by column, "s" for times; the first of its kind (m, m/s, rad)
            where there is none.

    Returns:
        One float64 array `(rows,)` per column, and one of text per column of those, which know where their rows stand in the file.

    Raises:
        FileError: the file is damaged or empty, lacks a column, or holds text or infinite numbers; the message names
            the line and the column.
        MotesError: the dialect has no such unit, format or zone.
        MissingExtraError: the file is Parquet and pyarrow is not installed.
    """
    size, start = look(path, 4)
    wanted = None if columns is None else [columns] if isinstance(columns, str) else list(columns)
    _check_marks(dialect)

    def cells(word: str, lines: Sequence[int]) -> Cells:
        return Cells(path, word, lines, dialect, expected or {}, wanted is not None)

    if start == b"PAR1":
        return _read_parquet(path, size, wanted, texts, cells("row", ()))
    data = _content(path, size, start)
    if JSON_START.match(data):
        return read_json(path, data, wanted, texts, cells("row", ()))
    return _read_csv(path, data, wanted, texts, cells("line", ()))


def _check_marks(dialect: Dialect) -> None:
    """Refuse marks that are none."""
    if dialect.decimal not in (".", ","):
        refuse("decimal", '"." or ","', repr(dialect.decimal[:20]))
    if len(_separator(dialect)) > 1:
        refuse("separator", 'one character, "tab" or "spaces"', repr(dialect.separator[:20]))


def _separator(dialect: Dialect) -> str:
    return SEPARATORS.get(dialect.separator.strip().lower() or dialect.separator, dialect.separator)


def column_names(path: str | os.PathLike[str], dialect: Dialect = PLAIN) -> list[str]:
    """Return the names of the columns of a file that `read_table` reads.

    Raises:
        FileError: the file is damaged or empty.
        MissingExtraError: the file is Parquet and pyarrow is not installed.
    """
    size, start = look(path, 4)
    if start == b"PAR1":
        with foreign(path, "an undamaged Parquet file"), Path(path).open("rb") as file:
            return list(need("pyarrow.parquet", "io").ParquetFile(need("pyarrow", "io").PythonFile(file)).schema_arrow.names)
    data = _content(path, size, start)
    return list(json_columns(path, data)) if JSON_START.match(data) else _csv_rows(path, data, dialect)[0]


def _content(path: str | os.PathLike[str], size: int, start: bytes) -> bytes:
    with foreign(path, "a readable file"):
        return unzipped(path, size) if start[:2] == GZIP else Path(path).read_bytes()


def _csv_rows(path: str | os.PathLike[str], data: bytes, dialect: Dialect) -> tuple[list[str], Any, int]:
    """Return the names of the columns, a reader of the rows after them, and how many lines of comments come before."""
    text = _text(path, data)
    with foreign(path, "well-formed CSV"):
        skipped, rest = _without_comments(text, dialect.comment)
        first, *more = LINE_END.split(rest[: 1 << 20], maxsplit=2)
        if not first.strip():
            reject(path, "a line of column names", "an empty line" if rest else "none")
        delimiter = _separator(dialect) or _delimiter(first, more[0] if more else "")
        lines = io.StringIO(rest, newline="")
        spaces = delimiter == " "
        rows = csv.reader(_stripped(lines) if spaces else lines, delimiter=delimiter, skipinitialspace=spaces, strict=True)
        names = [name.strip() for name in next(rows)]
        if len(names) > WIDEST:
            reject(path, f"at most {WIDEST} columns", len(names))
        mark = MARKS.match(first)
        if mark and _differ(first, more[0] if more else "", delimiter):
            hint = f"Are lines that begin with {mark[0]} comments? Set comment = \"{mark[0]}\"; the line of names has no mark."
            reject(path, "a line of column names", repr(first[:60]), hint)
        if all(is_number(name) for name in names):
            hint = "Take the mark of comments off the line of names." if skipped else "Add a line of names."
            reject(path, "a line of column names", f"numbers in line {skipped + 1}: {first[:60]!r}", hint)
    return names, rows, skipped


def _delimiter(names: str, row: str) -> str:
    """Return what separates columns, by the line of names and the next; spaces count where nothing else does, and both have as many."""
    found = max(DELIMITERS, key=lambda mark: len(next(csv.reader([names], delimiter=mark))))
    words = names.split()
    return " " if found not in names and 1 < len(words) == len(row.split()) and not names.lstrip().startswith('"') else found


def _differ(names: str, row: str, delimiter: str) -> bool:
    """Tell whether two lines have other numbers of fields; of words where nothing separates them."""
    mark = delimiter if delimiter in names else None
    return len(names.split(mark)) != len(row.split(mark))


def _stripped(lines: io.StringIO) -> Iterator[str]:
    return (line.strip().replace("\t", " ") + "\n" for line in lines)


def _read_csv(path: str | os.PathLike[str], data: bytes, wanted: list[str] | None, texts: Sequence[str], source: Cells) -> Columns:
    names, rows, skipped = _csv_rows(path, data, source.dialect)
    with foreign(path, "well-formed CSV"):
        chosen = chosen_names(path, names, wanted, texts, source.dialect)
        cells: list[list[str]] = [[] for _ in chosen]
        places = [names.index(name) for name in chosen]
        lines = _collect(path, rows, (len(names), places), cells, (skipped, source.dialect.comment))
    if not lines:
        reject(path, "at least one line of data", "column names only")
    return made_of(replace(source, lines=lines), dict(zip(chosen, cells, strict=True)), texts)


def _without_comments(text: str, mark: str) -> tuple[int, str]:
    """Return how many lines of comments a text begins with, and what comes after them."""
    at, count = 0, 0
    while mark and text.startswith(mark, at):
        end = LINE_END.search(text, at)
        at, count = (end.end() if end else len(text)), count + 1
    return count, text[at:]


def _text(path: str | os.PathLike[str], data: bytes) -> str:
    if data[:2] in (b"\xff\xfe", b"\xfe\xff"):
        reject(path, "UTF-8 text", "UTF-16", "Save it as UTF-8.")
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as reason:
        line = data.count(b"\n", 0, reason.start) + 1
        reject(path, "UTF-8 text", f"byte 0x{data[reason.start]:02x} in line {line}", "Save it as UTF-8.")
    control = re.search(r"[\x00-\x08\x0b\x0c\x0e-\x1f\x7f]", text)
    if control:
        reject(
            path, "text", f"the control character {control[0]!r} in line {text.count(chr(10), 0, control.start()) + 1}"
        )
    return text


def _collect(path: Any, rows: Any, asked: tuple[int, list[int]], cells: list[list[str]], comments: tuple[int, str]) -> "array[int]":
    """Append the chosen cells of each row to their columns; return the line on which each row starts.

    Args:
        path: the file, for messages.
        rows: of texts.
        asked: how many cells a row has, and the places of those that are chosen.
        cells: of each column.
        comments: lines that came before, and what lines of comments begin with.
    """
    (width, places), (skipped, mark) = asked, comments
    lines = array("q")
    first_blank, line = 0, skipped + rows.line_num + 1
    for row in rows:
        if not row:
            first_blank = first_blank or line  # allowed at the end of the file alone
        # "#N/A" is a missing number, not a comment
        elif mark and row[0].lstrip().startswith(mark) and row[0].strip().lower() not in MISSING:
            pass
        elif first_blank or len(row) != width:
            given, where = (0, first_blank) if first_blank else (len(row), line)
            hint = _EMPTY if width == 1 else "" if first_blank or given < width else _DECIMAL_COMMA
            reject(path, f"{width} fields as in the line of names", f"{given} in line {where}", hint)
        else:
            for column, place in zip(cells, places, strict=True):
                column.append(row[place])
            lines.append(line)
        line = skipped + rows.line_num + 1  # a quoted cell may be on several lines
    return lines


def _read_parquet(path: str | os.PathLike[str], size: int, wanted: list[str] | None, texts: Sequence[str], source: Cells) -> Columns:
    parquet, arrow = need("pyarrow.parquet", "io"), need("pyarrow", "io")
    with foreign(path, "an undamaged Parquet file"), Path(path).open("rb") as file:
        file.seek(max(size - 4, 0))
        if size < 12 or file.read(4) != b"PAR1":
            reject(path, "'PAR1' at both ends of a Parquet file", "it at the start only", "The file is cut short.")
        stored = parquet.ParquetFile(arrow.PythonFile(file), page_checksum_verification=True)
        chosen = chosen_names(path, stored.schema_arrow.names, wanted, texts, source.dialect)
        rows = stored.metadata.num_rows
        # packed columns may be small, but a header alone must not make us allocate without bound
        if rows * len(chosen) > max(LARGEST, 8 * size):
            reject(path, f"at most {LARGEST} numbers in {size} bytes", f"{rows} rows of {len(chosen)} columns")
        unpacked = sum(stored.metadata.row_group(group).total_byte_size for group in range(stored.num_row_groups))
        if unpacked > max(16 * LARGEST, 16 * size):
            reject(path, f"at most {16 * LARGEST} bytes unpacked from {size}", f"{unpacked} bytes")
        if rows < 1:
            reject(path, "at least one row", "column names only")
        table = stored.read(columns=chosen, use_threads=False)
        table.validate(full=True)
        cells = {name: table.column(name).to_pylist() if name in texts else table.column(name) for name in chosen}
        return made_of(replace(source, lines=range(1, rows + 1)), cells, texts, _arrow_numbers)


def _arrow_numbers(source: Cells, name: str, column: Any) -> tuple[np.ndarray, Clock | None]:
    arrow = need("pyarrow", "io")
    kind = column.type.value_type if arrow.types.is_dictionary(column.type) else column.type
    if arrow.types.is_string(kind) or arrow.types.is_large_string(kind):
        return source.column(name, ["" if cell is None else cell for cell in column.to_pylist()])
    if arrow.types.is_date(kind):
        column, kind = column.cast(arrow.timestamp("ms")), arrow.timestamp("ms")
    missing = np.asarray(column.is_null().to_numpy(zero_copy_only=False), bool)
    if arrow.types.is_timestamp(kind):
        ticks = column.cast(arrow.int64()).fill_null(0).to_numpy(zero_copy_only=False)
        whole, rest = np.divmod(ticks, TICKS[kind.unit])
        values = whole + rest / TICKS[kind.unit]
    elif arrow.types.is_integer(kind) or arrow.types.is_floating(kind) or arrow.types.is_decimal(kind):
        values = column.cast(arrow.float64(), safe=False).fill_null(0).to_numpy(zero_copy_only=False).copy()
    else:
        reject(source.path, f"numbers or times in column {name!r}", str(kind)[:60], 'Name the columns to read: columns = ["a", "b"].')
    values[missing] = np.nan
    if np.isinf(values).any():
        row = int(np.argmax(np.isinf(values))) + 1
        reject(source.path, f"a finite number in row {row}, column {name!r}", str(values[row - 1]))
    if arrow.types.is_timestamp(kind):
        source.refuse_unit(name)
        return values, Clock("%Y-%m-%dT%H:%M:%S", suffix="Z")
    return source.plain(name, values), None
