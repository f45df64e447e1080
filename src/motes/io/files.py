"""What every reader does first: look at the file itself before any library does, and turn foreign errors into ours."""

import hashlib
import os
import stat
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NoReturn

from filelock import FileLock, Timeout

from motes.core.checks import FileError, MotesError, refuse

MARK = 1024
"""Bytes before a position by which a file is known again."""


def label(path: str | os.PathLike[str]) -> str:
    """Return the name of a file as messages show it: as given, or its end where it is very long."""
    text = os.fspath(path)
    return text if len(text) <= 160 else "..." + text[-157:]


def reject(path: str | os.PathLike[str], expected: str, given: object, hint: str = "") -> NoReturn:
    """Raise a FileError that names the file, what was expected, what it holds and what to do."""
    refuse(label(path), expected, given, hint, FileError)


def lock(path: Path, refused: Callable[[], NoReturn]) -> FileLock:
    """Take a lock, which the system frees when the process ends, however it ends; `refused` says that another process has it."""
    found = FileLock(path)
    try:
        found.acquire(blocking=False)
    except Timeout:
        refused()
    return found


def known_by(file: int, position: int) -> str:
    """Return a digest of the last bytes before a position of an open file, but for the one before it, which ends a line."""
    begin = max(0, position - 1 - MARK)
    return hashlib.sha256(os.pread(file, max(0, position - 1 - begin), begin)).hexdigest()[:16]


def look(path: str | os.PathLike[str], count: int) -> tuple[int, bytes]:
    """Return the size of a file and its first bytes.

    Args:
        path: the file.
        count: how many bytes to return at most.

    Returns:
        The size in bytes and the first `count` bytes.

    Raises:
        FileError: the file is missing, empty, unreadable or no plain file (reading a pipe could wait forever).
    """
    with foreign(path, "a readable file"):
        if not stat.S_ISREG(os.stat(path).st_mode):
            reject(path, "a plain file", "a folder or a device")
        with Path(path).open("rb") as file:
            size, start = os.fstat(file.fileno()).st_size, file.read(count)
    if not start:
        reject(path, "a file with data", "an empty file")
    return size, start


@contextmanager
def foreign(path: str | os.PathLike[str], expected: str) -> Iterator[None]:
    """Turn whatever another library raises over a file into a FileError of one line.

    Every exception is caught on purpose: damaged files make libraries raise nearly anything.

    Args:
        path: the file at hand.
        expected: what a good file would have been.

    Raises:
        FileError: the enclosed calls failed.
    """
    try:
        yield
    except MotesError:
        raise
    except Exception as reason:
        deepest = reason.__cause__ or reason
        text = getattr(deepest, "strerror", None) or " ".join(str(deepest).split()) or type(deepest).__name__
        raise FileError(f"{label(path)}: expected {expected}, got: {text[:240]}.") from None
