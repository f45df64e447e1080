"""Tables of numbers and times from CSV and Parquet files, and times as seconds that survive 32-bit arithmetic."""

import csv
import io
import math
import os
import re
from array import array
from collections.abc import Callable, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from motes.core.checks import need, refuse
from motes.io.files import foreign, look, reject

DELIMITERS = ",;\t"
MISSING = ("", "nan", "na")
EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
LARGEST = 20_000_000
TICKS = {"s": 1, "ms": 10**3, "us": 10**6, "ns": 10**9}


def read_table(path: str | os.PathLike[str], columns: Sequence[str] | None = None) -> dict[str, np.ndarray]:
    """Read columns of numbers and times from a CSV or Parquet file, told apart by its content.

    A CSV file is UTF-8 text with one line of names, separated by commas, semicolons or tabs. Empty cells, `NaN` and
    `NA` are NaN. Times (ISO 8601, or Parquet timestamps and dates) become Unix seconds; without an offset they are UTC.

    Args:
        path: the file.
        columns: names of the columns to read, in this order; all if not given.

    Returns:
        One float64 array `(rows,)` per column.

    Raises:
        FileError: the file is damaged or empty, lacks a column, or holds text or infinite numbers; the message names
            the line and the column.
        MissingExtraError: the file is Parquet and pyarrow is not installed.
    """
    size, start = look(path, 4)
    wanted = None if columns is None else [columns] if isinstance(columns, str) else list(columns)
    if start == b"PAR1":
        return _read_parquet(path, size, wanted)
    return _read_csv(path, wanted)


def times(values: Any, *, repeats: bool = True) -> tuple[float, np.ndarray]:
    """Split times into a start and the seconds since, computed in float64.

    Unix times near 1.7e9 s are 128 s apart in float32, so the start is subtracted before any cast; over long recordings
    take `np.diff` of the seconds before casting too.

    Args:
        values: times in seconds, `(t,)`.
        repeats: whether equal neighbors are allowed.

    Returns:
        The first time, and the seconds since then as float64 `(t,)`.

    Raises:
        MotesError: times are missing, infinite, decrease, or repeat where that is not allowed; the row is named.
    """
    try:
        seconds = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError):
        refuse("times", "numbers of seconds", type(values).__name__)
    if seconds.ndim != 1 or not seconds.size:
        refuse("times", "a row of at least one time", f"shape {seconds.shape}")
    order = "times that never decrease" if repeats else "times that increase"
    steps = np.diff(seconds)
    good = np.isfinite(seconds) & np.concatenate([[True], steps >= 0 if repeats else steps > 0])
    if not good.all():
        row = int(np.argmin(good))
        before = f" after {seconds[row - 1]!s}" if row else ""
        refuse("times", order, f"{seconds[row]!s}{before} in row {row + 1} (line {row + 2} of a table with names)")
    return float(seconds[0]), seconds - seconds[0]


def _read_csv(path: str | os.PathLike[str], wanted: list[str] | None) -> dict[str, np.ndarray]:
    text = _text(path)
    with foreign(path, "well-formed CSV"):
        first = re.split("[\r\n]", text, maxsplit=1)[0]
        if not first.strip():
            reject(path, "a line of column names", "an empty line")
        delimiter = max(DELIMITERS, key=lambda mark: len(next(csv.reader([first], delimiter=mark))))
        rows = csv.reader(io.StringIO(text, newline=""), delimiter=delimiter, strict=True)
        names = [name.strip() for name in next(rows)]
        if all(_converts(_number, name) for name in names):
            reject(path, "a line of column names", f"numbers in line 1: {first[:60]!r}", "Add a line of names.")
        chosen = _choose(path, names, wanted)
        cells: list[list[str]] = [[] for _ in chosen]
        lines = _collect(path, rows, len(names), [names.index(name) for name in chosen], cells)
    if not lines:
        reject(path, "at least one line of data", "column names only")
    return {name: _numbers(path, name, column, lines, "line") for name, column in zip(chosen, cells, strict=True)}


def _text(path: str | os.PathLike[str]) -> str:
    with foreign(path, "a readable file"):
        data = Path(path).read_bytes()
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


def _collect(path: Any, rows: Any, width: int, places: list[int], cells: list[list[str]]) -> "array[int]":
    """Append the chosen cells of each row to their columns; return the line on which each row starts."""
    lines = array("q")
    blank, line = 0, rows.line_num + 1
    for row in rows:
        if not row:
            blank = blank or line
        elif blank or len(row) != width:
            given, where = (0, blank) if blank else (len(row), line)
            reject(path, f"{width} fields as in the line of names", f"{given} in line {where}")
        else:
            for column, place in zip(cells, places, strict=True):
                column.append(row[place])
            lines.append(line)
        line = rows.line_num + 1
    return lines


def _choose(path: Any, names: list[str], wanted: list[str] | None) -> list[str]:
    seen: set[str] = set()
    for name in names:
        if name in seen:
            reject(path, "different column names", f"{name!r} more than once")
        seen.add(name)
    for name in wanted or []:
        if name not in names:
            reject(path, f"a column {name!r}", f"the columns {', '.join(names)[:240]}")
    return names if wanted is None else list(dict.fromkeys(wanted))


def _converts(convert: Callable[[str], float], cell: str) -> bool:
    try:
        convert(cell)
    except (ValueError, OverflowError):
        return False
    return True


def _number(cell: str) -> float:
    # float() also takes digits of other scripts and 1_000, which no instrument writes
    if "_" in cell or not cell.isascii():
        raise ValueError(cell)
    return float(cell)


def _time(cell: str) -> float:
    moment = datetime.fromisoformat(cell)
    return ((moment if moment.tzinfo else moment.replace(tzinfo=UTC)) - EPOCH).total_seconds()


def _numbers(path: Any, name: str, cells: Sequence[str], lines: Sequence[int], word: str) -> np.ndarray:
    """Turn the cells of one column into numbers; the first cell that is not empty decides whether they are times.

    Args:
        path: the file, for messages.
        name: the column, for messages.
        cells: the text of each row.
        lines: where each row stands in the file.
        word: what `lines` count, "line" or "row".
    """
    values = np.full(len(cells), np.nan)
    convert, kind = None, ""
    for index, cell in enumerate(map(str.strip, cells)):
        if cell.lower() in MISSING:
            continue
        if convert is None:
            convert, kind = (_number, "a number") if _converts(_number, cell) else (_time, "an ISO 8601 time")
            if not _converts(convert, cell):
                expected = f"a number or an ISO 8601 time in {word} {lines[index]}, column {name!r}"
                reject(path, expected, repr(cell[:60]), "Name the columns of numbers with columns=.")
        try:
            values[index] = convert(cell)
        except (ValueError, OverflowError):
            reject(path, f"{kind} in {word} {lines[index]}, column {name!r}", repr(cell[:60]))
        if math.isinf(values[index]):
            reject(path, f"a finite number in {word} {lines[index]}, column {name!r}", repr(cell[:60]))
    return values


def _read_parquet(path: str | os.PathLike[str], size: int, wanted: list[str] | None) -> dict[str, np.ndarray]:
    parquet, arrow = need("pyarrow.parquet", "io"), need("pyarrow", "io")
    with foreign(path, "an undamaged Parquet file"), Path(path).open("rb") as file:
        file.seek(max(size - 4, 0))
        if size < 12 or file.read(4) != b"PAR1":
            reject(path, "'PAR1' at both ends of a Parquet file", "it at the start only", "The file is cut short.")
        source = parquet.ParquetFile(arrow.PythonFile(file), page_checksum_verification=True)
        chosen = _choose(path, source.schema_arrow.names, wanted)
        rows = source.metadata.num_rows
        # packed columns may be small, but a header alone must not make us allocate without bound
        if rows * len(chosen) > max(LARGEST, 8 * size):
            reject(path, f"at most {LARGEST} numbers in {size} bytes", f"{rows} rows of {len(chosen)} columns")
        unpacked = sum(source.metadata.row_group(group).total_byte_size for group in range(source.num_row_groups))
        if unpacked > max(16 * LARGEST, 16 * size):
            reject(path, f"at most {16 * LARGEST} bytes unpacked from {size}", f"{unpacked} bytes")
        if rows < 1:
            reject(path, "at least one row", "column names only")
        table = source.read(columns=chosen, use_threads=False)
        table.validate(full=True)
        return {name: _arrow_numbers(path, name, table.column(name)) for name in chosen}


def _arrow_numbers(path: Any, name: str, column: Any) -> np.ndarray:
    arrow = need("pyarrow", "io")
    kind = column.type.value_type if arrow.types.is_dictionary(column.type) else column.type
    if arrow.types.is_string(kind) or arrow.types.is_large_string(kind):
        cells = ["" if cell is None else cell for cell in column.to_pylist()]
        return _numbers(path, name, cells, range(1, len(cells) + 1), "row")
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
        reject(
            path, f"numbers or times in column {name!r}", str(kind)[:60], "Name the columns of numbers with columns=."
        )
    values[missing] = np.nan
    if np.isinf(values).any():
        row = int(np.argmax(np.isinf(values))) + 1
        reject(path, f"a finite number in row {row}, column {name!r}", str(values[row - 1]))
    return values
