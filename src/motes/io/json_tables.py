"""Tables in JSON, as pandas writes them: a list of records, or columns whose cells are numbered; and files zipped by gzip."""

import json
import os
import re
import zlib
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from motes.io.clocks import Clock
from motes.io.columns import Cells, Columns, chosen_names, made_of
from motes.io.files import foreign, reject

JSON_START = re.compile(rb"(?:\xef\xbb\xbf)?\s*(\[\s*[{\]]|\{\s*[\"}])")
LARGEST, PACKED = 1 << 25, 30
"""Bytes that any file may unpack to, and how many times its own size beyond that."""
RECORDS, VALUES = 1_000_000, 5_000_000
"""Records and numbers of a JSON file at most: each takes many times its length in memory."""


def unzipped(path: str | os.PathLike[str], size: int) -> bytes:
    """Return the content of a file zipped by gzip.

    Raises:
        FileError: it is damaged, or unpacks to so much that it was rather made to exhaust memory.
    """
    most = max(LARGEST, PACKED * size)
    with foreign(path, "an undamaged gzip file"):
        stream = zlib.decompressobj(wbits=31)
        data = stream.decompress(Path(path).read_bytes(), most)
        if stream.unconsumed_tail:
            reject(path, f"at most {most} bytes unpacked from {size}", "more")
        if not stream.eof or stream.unused_data:
            reject(path, "an undamaged gzip file", "one that is cut short" if not stream.eof else "one with other data behind it")
    return data


def read_json(path: str | os.PathLike[str], data: bytes, wanted: list[str] | None, texts: Sequence[str], source: Cells) -> Columns:
    """Read columns from a list of records, `[{"a": 1, "b": 2}, ...]`, or from columns, `{"a": {"0": 1, ...}, ...}` or `{"a": [1, ...]}`.

    A null, or what a record lacks, is NaN.

    Args:
        path: the file, for messages.
        data: its content.
        wanted: names of the columns; all if None.
        texts: names of columns of text, where they are there.
        source: how cells are read.

    Raises:
        FileError: the content is no such table, or a cell no number or time.
    """
    columns = json_columns(path, data)
    chosen = chosen_names(path, list(columns), wanted, texts, source.dialect)
    lengths = {len(columns[name]) for name in chosen}
    if len(lengths) != 1 or 0 in lengths:
        reject(path, "columns of one length, with at least one row", str(sorted(lengths))[:80] if chosen else "none")
    rows = range(1, len(columns[chosen[0]]) + 1)
    return made_of(replace(source, lines=rows), {name: columns[name] for name in chosen}, texts, _numbers)


def json_columns(path: str | os.PathLike[str], data: bytes) -> dict[str, list[Any]]:
    """Return the cells of each column as they stand.

    Raises:
        FileError: the content is no table.
    """
    for mark, most, what in ((b"{", RECORDS, "records"), (b",", VALUES, "numbers")):
        if data.count(mark) > most:
            reject(path, f"at most {most} {what} in JSON", data.count(mark), "Write the table as CSV or Parquet.")
    with foreign(path, "well-formed JSON in UTF-8"):
        content = json.loads(data.decode("utf-8-sig"), object_pairs_hook=_without_doubles)
    return _by_columns(path, content)


def _without_doubles(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found = dict(pairs)
    if len(found) < len(pairs):
        raise ValueError("a name twice in one object")
    return found


def _by_columns(path: Any, content: Any) -> dict[str, list[Any]]:
    if isinstance(content, list) and all(isinstance(record, dict) for record in content):
        names = dict.fromkeys(name for record in content for name in record)
        return {name: [record.get(name) for record in content] for name in names}
    if isinstance(content, dict) and content and all(isinstance(column, list) for column in content.values()):
        return content
    if isinstance(content, dict) and content and all(isinstance(column, dict) for column in content.values()):
        places = next(iter(content.values())).keys()
        if all(column.keys() == places for column in content.values()):
            return {name: [column[place] for place in places] for name, column in content.items()}
    reject(path, "a list of records or a table of columns", "JSON of another form")


def _numbers(source: Cells, name: str, cells: list[Any]) -> tuple[np.ndarray, Clock | None]:
    if all(cell is None or type(cell) in (int, float) for cell in cells):
        with foreign(source.path, f"numbers in column {name!r}"):
            values = np.array([np.nan if cell is None else cell for cell in cells], np.float64)
        if not np.isinf(values).any():
            return source.plain(name, values), None
    return source.column(name, ["" if cell is None else _cell_text(cell, source)[:200] for cell in cells])


def _cell_text(cell: Any, source: Cells) -> str:
    """Return a cell as text; a number has the mark of decimals of texts beside it."""
    return str(cell).replace(".", source.dialect.decimal) if type(cell) is float else str(cell)
