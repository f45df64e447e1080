"""Results as Parquet (package `pyarrow`, extra `io`): a folder that grows by whole files of one row group each.

A Parquet file is readable only once its end is written. So each row group is a file of its own, which is there whole or not at all; what
reads Parquet reads the folder as one table. The last file is written anew until it is full.
"""

import os
import re
from pathlib import Path
from typing import Any

from motes.core.checks import need
from motes.io.archive import durable_folder, whole_file
from motes.io.files import foreign, lock, reject
from motes.io.unfinished import remove_leftovers
from motes.live.counts import LOG
from motes.live.sink import IN_USE, Sink

ROWS = 10_000
"""Rows of a row group."""
PART = re.compile(r"part-(\d{8})\.parquet")


WHOLE, TRUTHS = ("step", "number", "late"), ("alarm", "collapsed")
"""Columns of whole numbers and of truth values; all others are numbers."""


class Parquet(Sink):
    """Collects records and writes them by row groups."""

    def __init__(self, path: str):
        """Make the folder.

        Raises:
            FileError: it cannot be made, holds something else, or another run writes to it.
            MissingExtraError: pyarrow is not installed.
        """
        self.name, self._folder = path, Path(path)
        self._arrow: Any = need("pyarrow", "io")
        self._parquet: Any = need("pyarrow.parquet", "io")
        with foreign(path, "a folder that can be made"):
            durable_folder(self._folder.absolute())
        other = next((one.name for one in self._folder.iterdir() if not one.name.startswith(".") and not PART.fullmatch(one.name)), None)
        if other is not None:
            reject(path, "an empty folder, or one that this wrote", f"{other} in it")
        with foreign(path, "a folder that can be written"):
            self._lock = lock(self._folder / ".lock", lambda: reject(path, *IN_USE))
        self._full, self._written = 0, 0
        self._rows: list[dict[str, Any]] = []
        self.go_on(None, cut=False)

    def _part(self, number: int) -> Path:
        return self._folder / f"part-{number:08d}.parquet"

    def write(self, record: dict[str, Any]) -> None:
        """Take a record; a row group that is full is written first, and until that succeeds none is taken."""
        if len(self._rows) >= ROWS:
            self._flush()
            self._full, self._rows, self._written = self._full + 1, [], 0
        self._rows.append(record)

    def _flush(self) -> None:
        if len(self._rows) > self._written:
            with whole_file(self._part(self._full)) as file:
                self._parquet.write_table(self._table(), file, write_page_checksum=True)
            self._written = len(self._rows)

    def _table(self) -> Any:
        """Return the rows as a table whose columns have the same types in every file; what does not fit is null."""
        arrow = self._arrow
        types = {**dict.fromkeys(WHOLE, arrow.int64()), **dict.fromkeys(TRUTHS, arrow.bool_())}
        names = dict.fromkeys(name for row in self._rows for name in row)
        schema = arrow.schema([(name, types.get(name, arrow.float64())) for name in names])
        return arrow.Table.from_pylist([{name: _fitting(name, row.get(name)) for name in names} for row in self._rows], schema)

    @property
    def place(self) -> str:
        """The whole path of the folder."""
        return os.path.abspath(self._folder)

    @property
    def unwritten(self) -> int:
        """Number of rows that are in no file yet."""
        return len(self._rows) - self._written

    def secure(self) -> None:
        """Write what is left over."""
        self._flush()

    def kept(self) -> int | None:
        """Return how many rows there are."""
        return self._full * ROWS + len(self._rows)

    def go_on(self, kept: int | None, cut: bool) -> None:
        """Go on behind the rows that are there, or that were there at the checkpoint."""
        rows = kept if cut else None
        parts = sorted(int(found[1]) for one in self._folder.iterdir() if (found := PART.fullmatch(one.name)))
        for number in parts:
            if rows is not None and number * ROWS >= rows:
                self._part(number).unlink()
        self._full, self._rows, self._written = (parts[-1] if parts else 0) if rows is None else rows // ROWS, [], 0
        remove_leftovers(self._part(self._full))
        if self._part(self._full).exists():
            with foreign(self._part(self._full), "an undamaged Parquet file"):
                table = self._parquet.ParquetFile(self._part(self._full), page_checksum_verification=True).read()
            there = table.to_pylist()
            self._rows = there if rows is None else there[: rows % ROWS]
            self._written = len(there) if rows is None else 0
        missing = 0 if rows is None else rows % ROWS - len(self._rows)
        if missing:
            LOG.warning("sink %s: %d records from before the checkpoint are not in it.", self.name, missing)

    def close(self) -> None:
        """Write what is left over, and let others write."""
        try:
            self._flush()
        finally:
            self._lock.release()


def _fitting(name: str, value: Any) -> Any:
    """Return a value as its column can hold it; None where it cannot."""
    if value is None or name in TRUTHS:
        return value
    if name in WHOLE:
        return value if -(2**63) <= value < 2**63 else None
    try:
        return float(value)
    except OverflowError:
        return None
