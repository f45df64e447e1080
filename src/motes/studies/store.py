"""Where the runs of a study are kept: in memory, or in a folder that survives a kill at any moment.

A folder holds a SQLite ledger and one file of arrays for each block of runs of each part. A file is written whole and forced to disk, with
its folder, before the ledger names it with its digest; the ledger forces each commit to disk too (WAL, synchronous=FULL), so that not even
a loss of power takes a run that was reported done. What the ledger does not name was never done. Rows of the ledger carry digests of their
own, since a flipped bit in a row is still a well-formed row.
"""

import hashlib
import json
import os
import re
import socket
import sqlite3
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, NamedTuple, NoReturn, Self
from urllib.parse import quote

import numpy as np
from filelock import FileLock

from motes.core.checks import FileError, refuse
from motes.io import archive
from motes.io.files import foreign, label, lock, reject
from motes.studies.ledger import SCHEMA, recognize, sound

LEDGER, LOCK, OWNER, KIND = "ledger.sqlite", "lock", "owner", "runs of a study"
REPAIR = "study(..., repair=True) computes these runs again."
_OURS = re.compile(r"\.?part\d+-\d+-\d+\.npz(\.[0-9a-f]+)?")

Arrays = dict[str, np.ndarray]


class Entry(NamedTuple):
    """Something that must not change while a store is in use.

    Attributes:
        digest: what is compared.
        shown: what a message or a report says of it.
    """

    digest: str
    shown: str


class Memory:
    """Runs kept in memory."""

    def __init__(self) -> None:
        """Begin with nothing."""
        self._blocks: dict[str, dict[tuple[int, int], Arrays]] = {}

    def __enter__(self) -> Self:
        """Begin."""
        return self

    def __exit__(self, *reason: object) -> None:
        """End."""

    def done(self, part: str) -> list[tuple[int, int]]:
        """Return the blocks of runs (first, and the one after the last) that a part has, in order."""
        return sorted(self._blocks.get(part, {}))

    def put(self, part: str, start: int, stop: int, arrays: Arrays) -> None:
        """Keep a block of runs, run axis first."""
        self._blocks.setdefault(part, {})[start, stop] = arrays

    def get(self, part: str, start: int, stop: int) -> Arrays:
        """Return a block of runs."""
        return self._blocks[part][start, stop]


class Store:
    """Runs kept in a folder; use it in a `with` block, which ends the lock."""

    def __init__(self, folder: Path, write: bool = True):
        """Open a folder, or make it.

        Args:
            folder: the folder.
            write: whether runs are to be added; otherwise the folder is only read, and must be a store.

        Raises:
            FileError: the folder or the ledger cannot be used, or another process writes to it.
        """
        self.folder, self._lock = folder, None
        recognize(folder / LEDGER)
        if write:
            with foreign(folder, "a folder that can be written"):
                archive.durable_folder(folder.absolute())
                self._lock = _locked(folder)
        try:
            self._ledger = _opened(folder, write)
            self._check()
        except BaseException:
            self._unlock()
            raise

    def __enter__(self) -> Self:
        """Begin."""
        return self

    def __exit__(self, *reason: object) -> None:
        """Close the ledger and end the lock."""
        with sound(self.folder / LEDGER, "a ledger that can be closed"):
            if self._lock is not None:
                # one plain file again, which can be read where nothing can be written; not while somebody reads it
                with suppress(sqlite3.OperationalError):
                    self._ledger.execute("PRAGMA journal_mode=DELETE")
            self._ledger.close()
        self._unlock()

    def _unlock(self) -> None:
        if self._lock is not None:
            self._lock.release()
            self._lock = None

    def _check(self) -> None:
        with self._reading():
            found = self._ledger.execute("PRAGMA integrity_check").fetchone()[0]
            if found != "ok":
                raise sqlite3.DatabaseError(found)
        for table in ("field", "part", "block"):
            self._rows(table)

    @contextmanager
    def _reading(self) -> Iterator[None]:
        with sound(self.folder / LEDGER, "an undamaged ledger"):
            yield

    @contextmanager
    def _writing(self) -> Iterator[None]:
        with sound(self.folder / LEDGER, "a ledger that can be written"):
            self._ledger.execute("BEGIN IMMEDIATE")
            try:
                yield
                self._ledger.execute("COMMIT")
            except BaseException:
                if self._ledger.in_transaction:
                    self._ledger.execute("ROLLBACK")
                raise

    def _rows(self, table: str) -> list[tuple[Any, ...]]:
        with self._reading():
            rows = self._ledger.execute(f"SELECT * FROM {table} ORDER BY 1, 2").fetchall()
        for *values, mark in rows:
            if mark != _mark(values):
                refuse(label(self.folder / LEDGER), "rows as they were written", f"another digest of a {table} {values[0]!r}",
                       "Restore it from a copy, or use another folder.", FileError)
        return [row[:-1] for row in rows]

    def _add(self, table: str, *values: Any) -> None:
        marks = ", ".join("?" * (len(values) + 1))
        self._ledger.execute(f"INSERT OR REPLACE INTO {table} VALUES ({marks})", (*values, _mark(values)))

    def bind(self, fields: dict[str, Entry], parts: dict[str, Entry], notes: dict[str, Any]) -> None:
        """Bind the store to an experiment: what it knows already must be the same, new parts are added, unfinished files removed.

        Args:
            fields: by name, what all runs depend on, such as the model.
            parts: by name, filters and the truth.
            notes: what a reader wants to know besides, such as the names of the states; not compared.

        Raises:
            FileError: the store is of another experiment; the message names what differs.
        """
        known = {name: Entry(digest, shown) for name, digest, shown in self._rows("field") if name != "notes"}
        numbered = self.parts()
        # the longer names keep a filter from being taken for a field
        before = known | {f"filter {name!r}": entry for name, (_, entry) in numbered.items()}
        now = fields | {f"filter {name!r}": entry for name, entry in parts.items()}
        different = [_difference(name, before[name], entry) for name, entry in now.items()
                     if name in before and before[name].digest != entry.digest]
        if different:
            refuse(label(self.folder), "the experiment that this store was begun with", "another " + ", ".join(different),
                   "Use another folder.", FileError)
        with self._writing():
            for name, entry in fields.items():
                if name not in known:
                    self._add("field", name, *entry)
            for name, entry in parts.items():
                if name not in numbered:
                    numbered[name] = (len(numbered), entry)
                    self._add("part", numbered[name][0], name, *entry)
            self._add("field", "notes", "", json.dumps(notes))
        self._sweep()

    def _sweep(self) -> None:
        """Remove files that a killed study left unfinished or unnamed."""
        named = {self._file(number, start, stop).name for number, start, stop, _ in self._rows("block")}
        with foreign(self.folder, "a folder that can be written"):
            for path in self.folder.iterdir():
                if _OURS.fullmatch(path.name) and path.name not in named:
                    path.unlink()

    def notes(self) -> dict[str, Any]:
        """Return the notes that the last study left.

        Raises:
            FileError: there are none: the study was stopped before it began.
        """
        for name, _, shown in self._rows("field"):
            if name == "notes":
                return json.loads(shown)
        refuse(label(self.folder), "a store with runs", "none yet", "Let the study go on.", FileError)

    def parts(self) -> dict[str, tuple[int, Entry]]:
        """Return number and entry of each part by name."""
        return {name: (number, Entry(digest, shown)) for number, name, digest, shown in self._rows("part")}

    def verify(self, repair: bool) -> None:
        """Compare each file with its digest.

        Args:
            repair: whether to forget the runs of a damaged file, so that they are computed again.

        Raises:
            FileError: a file is damaged or missing and is not to be repaired; the message names it.
        """
        for number, start, stop, digest in self._rows("block"):
            path = self._file(number, start, stop)
            given = _digest(path)
            if given == digest:
                continue
            if not repair:
                found = "no such file" if given is None else "a damaged file"
                refuse(label(path), "the runs as they were written", found, REPAIR, FileError)
            with self._writing():
                self._ledger.execute("DELETE FROM block WHERE part = ? AND start = ?", (number, start))

    def done(self, part: str) -> list[tuple[int, int]]:
        """Return the blocks of runs (first, and the one after the last) that a part has, in order."""
        number = self.parts()[part][0]
        return sorted((start, stop) for owner, start, stop, _ in self._rows("block") if owner == number)

    def put(self, part: str, start: int, stop: int, arrays: Arrays) -> None:
        """Keep a block of runs, run axis first; it is on disk, and cannot be lost, when this returns.

        Raises:
            FileError: the disk is full or cannot be written to; nothing is changed.
        """
        number = self.parts()[part][0]
        path = self._file(number, start, stop)
        archive.write_tree(path, arrays, {"part": part, "start": start, "stop": stop}, KIND)
        with self._writing():
            self._add("block", number, start, stop, _digest(path))

    def get(self, part: str, start: int, stop: int) -> Arrays:
        """Return a block of runs.

        Raises:
            FileError: the file is damaged or missing, or holds other runs; the message names it.
        """
        path = self._file(self.parts()[part][0], start, stop)
        arrays, texts = archive.read_tree(path, KIND)
        if (texts["part"], texts["start"], texts["stop"]) != (part, start, stop):
            refuse(label(path), f"runs {start} to {stop - 1} of {part!r}", "others", REPAIR, FileError)
        return arrays

    def _file(self, number: int, start: int, stop: int) -> Path:
        # never the name that a user gave: it could lead out of the folder
        return self.folder / f"part{number:03d}-{start:07d}-{stop:07d}.npz"


def _locked(folder: Path) -> FileLock:
    """Take the lock of a folder, and say in it who has it."""

    def refused() -> NoReturn:
        owner = (folder / OWNER).read_text(errors="replace")[:200] if (folder / OWNER).is_file() else "another process"
        reject(folder, "a store that no other study writes to", f"one in use by {owner}", "Wait for it, or end it.")

    found = lock(folder / LOCK, refused)
    (folder / OWNER).write_text(f"process {os.getpid()} on {socket.gethostname()}")
    return found


def _opened(folder: Path, write: bool) -> sqlite3.Connection:
    path = folder / LEDGER
    runs = sum(1 for name in folder.iterdir() if _OURS.fullmatch(name.name)) if folder.is_dir() else 0
    if not path.is_file() or not path.stat().st_size:
        if runs or not write:
            cure = "Restore it from a copy." if runs else "Of a run that is no study: mo.report(mo.History.load('NAME.npz'), 'run.html')."
            refuse(label(path), "the ledger of a study", f"none beside {runs} files of runs", cure, FileError)
    with sound(path, "an undamaged ledger"):
        mode = "rwc" if write else "ro"
        ledger = sqlite3.connect(f"file:{quote(str(path.absolute()))}?mode={mode}", uri=True, isolation_level=None)
        if write:
            ledger.execute("PRAGMA journal_mode=WAL")
            ledger.execute("PRAGMA synchronous=FULL")
            if ledger.execute("SELECT count(*) FROM sqlite_master").fetchone()[0] == 0 and not runs:
                ledger.executescript(f"BEGIN;{SCHEMA}COMMIT;")
        return ledger


def _mark(values: Any) -> str:
    return hashlib.sha256(repr(list(values)).encode()).hexdigest()


def _digest(path: Path) -> str | None:
    """Return the digest of a file; None where there is none."""
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except FileNotFoundError:
        return None


def _difference(name: str, there: Entry, here: Entry) -> str:
    """Name what differs, with both values where they are short."""
    if there.shown == here.shown or len(there.shown) + len(here.shown) > 160:
        return name
    return f"{name} ({there.shown} there, {here.shown} here)"
