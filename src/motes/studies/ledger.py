"""The ledger of a store as a file: what makes it one of ours, and what SQLite's errors mean."""

import os
import sqlite3
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from urllib.parse import quote

from motes.io.files import foreign, reject

FORMAT = 1
SCHEMA = f"""
CREATE TABLE field (name TEXT PRIMARY KEY, digest TEXT, shown TEXT, mark TEXT);
CREATE TABLE part (number INTEGER PRIMARY KEY, name TEXT UNIQUE, digest TEXT, shown TEXT, mark TEXT);
CREATE TABLE block (part INTEGER, start INTEGER, stop INTEGER, digest TEXT, mark TEXT, PRIMARY KEY (part, start));
PRAGMA user_version = {FORMAT};
"""
START, VERSION_AT = b"SQLite format 3\0", 60
FULL = (sqlite3.SQLITE_FULL, sqlite3.SQLITE_IOERR, sqlite3.SQLITE_READONLY, sqlite3.SQLITE_CANTOPEN, sqlite3.SQLITE_BUSY)
"""Errors (in their lowest byte) of the disk and of others at work, not of what is stored."""


def recognize(path: Path) -> None:
    """Refuse a file that is no ledger of ours, or of another format, before anything opens it that could change it.

    Args:
        path: of the ledger, which may be missing or empty.

    Raises:
        FileError: it is none, or cannot be read.
    """
    with sound(path, "an undamaged ledger"):
        if not path.is_file() or not path.stat().st_size:
            return
        with path.open("rb") as file:
            start = file.read(100)
        if start[: len(START)] != START:
            reject(path, "an undamaged ledger", "a file that is no database")
        written = Path(f"{path}-wal")
        waiting = written.is_file() and written.stat().st_size > 0
        version = int.from_bytes(start[VERSION_AT : VERSION_AT + 4], "big")
        if version not in (0, FORMAT):
            _refuse_version(path, version)
        # nothing is read but this file, and nothing locked, where no other file has a part of it
        how = "mode=ro" if waiting else "mode=ro&immutable=1"
        with closing(sqlite3.connect(f"file:{quote(os.fspath(path.absolute()))}?{how}", uri=True)) as ledger:
            version = ledger.execute("PRAGMA user_version").fetchone()[0]
            rows = ledger.execute("SELECT type, name, sql FROM sqlite_master WHERE sql IS NOT NULL OR type != 'index'").fetchall()
        if version != FORMAT and (version or rows):
            _refuse_version(path, version)
        strange = set(rows) - _ours()
        # a study that was killed at its very beginning leaves an empty one
        if rows and set(rows) != _ours():
            given = ", ".join(f"{kind} {name}"[:60] for kind, name, _ in sorted(strange, key=str)[:3]) or "others"
            reject(path, "the three tables of a study alone", given, "It is no ledger of a study, or somebody changed it.")


def _ours() -> set[tuple[str, str, str]]:
    with closing(sqlite3.connect(":memory:")) as ledger:
        ledger.executescript(SCHEMA)
        return set(ledger.execute("SELECT type, name, sql FROM sqlite_master WHERE sql IS NOT NULL"))


def _refuse_version(path: Path, version: int) -> None:
    hint = "Read it with a newer motes." if version > FORMAT else "It is no ledger of a study."
    reject(path, f"a ledger of format {FORMAT}", f"format {version}", hint)


@contextmanager
def sound(path: Path, expected: str) -> Iterator[None]:
    """Turn errors of SQLite into a FileError that tells a disk which fails from a ledger which is damaged.

    Args:
        path: of the ledger.
        expected: what a good ledger would have been.

    Raises:
        FileError: the enclosed calls failed.
    """
    with foreign(path, expected):
        try:
            yield
        except sqlite3.OperationalError as reason:
            code = getattr(reason, "sqlite_errorcode", None)
            if code is None or code & 0xFF not in FULL:
                raise
            reject(path, "a disk with room that can be read and written", f"{reason} ({reason.sqlite_errorname})",
                   "Nothing that was reported done is lost; go on with the same call once the disk is in order.")  # fmt: skip
