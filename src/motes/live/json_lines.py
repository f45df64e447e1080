"""Results as lines of JSON, in a file or on standard output: only whole lines are ever there."""

import os
import select
import stat
from contextlib import suppress
from typing import Any

from motes.io.archive import POSIX
from motes.io.files import foreign, known_by, reject
from motes.live.counts import LOG
from motes.live.inbox import POLL
from motes.live.sink import IN_USE, Sink, line_of

AT_ONCE: int = getattr(select, "PIPE_BUF", 512)
"""Bytes that a pipe takes whole and without waiting where it takes any."""


class JSONLines(Sink):
    """Writes each record as a line, at once, behind what is in the file."""

    def __init__(self, name: str, file: int, path: str | None = None):
        """Write to an open file, by its number, which is closed in the end; with a path to what is there under that name."""
        self.name, self._file = name, file
        self._plain = stat.S_ISREG(os.fstat(file).st_mode)
        self._path, self._named = path if self._plain else None, path is not None
        # one that a shell opened with >> stands at its beginning until it is written to
        self._end = os.lseek(file, 0, os.SEEK_END) if self._plain else 0

    @property
    def place(self) -> str:
        """The whole path of a file."""
        return self.name if self._path is None else os.path.abspath(self._path)

    def write(self, record: dict[str, Any]) -> None:
        """Write a line; of a file that is full what is only half of one is taken back."""
        line = line_of(record) + b"\n"
        if not self._plain:
            self._hand_on(line)
            return
        self._look()
        if not _ends_a_line(self._file, self._end):
            # half a line of somebody else's
            line = b"\n" + line
        written = os.write(self._file, line)
        if written < len(line):
            os.ftruncate(self._file, os.lseek(self._file, 0, os.SEEK_CUR) - written)
            os.lseek(self._file, 0, os.SEEK_END)
            raise OSError(f"the disk took {written} of {len(line)} bytes")
        self._end = os.lseek(self._file, 0, os.SEEK_CUR)

    def _hand_on(self, line: bytes) -> None:
        """Write to a pipe or a terminal, waiting for who reads, but not once the run is to end."""
        while line:
            while POSIX and not select.select([], [self._file], [], POLL)[1]:
                if self.ends():
                    raise OSError("nobody reads it, and the run is to end")
            try:
                line = line[os.write(self._file, line[:AT_ONCE]) :]
            except BrokenPipeError:
                if not self._named:
                    raise
                # another reader may open it
                raise OSError("nobody reads it") from None

    def _look(self) -> None:
        """See to it that lines go where the path leads, and to the end: others remove, replace and empty files."""
        if self._path is not None and not _is_at(self._file, self._path):
            file = _to_append(self._path)
            os.close(self._file)
            self._file = file
            self._end = os.lseek(file, 0, os.SEEK_END)
            LOG.warning("sink %s: it was removed or replaced; lines go on in the file that is there now.", self.name)
        size = os.fstat(self._file).st_size
        if size < self._end:
            LOG.warning("sink %s: it was cut from %d to %d bytes; lines go on behind these.", self.name, self._end, size)
        if size != self._end:
            self._end = os.lseek(self._file, 0, os.SEEK_END)

    def secure(self) -> None:
        """Force the lines to disk."""
        if self._plain:
            os.fsync(self._file)

    def kept(self) -> tuple[int, str] | None:
        """Return how many bytes the lines are, and what the file is known by there."""
        return (self._end, _mark_of(self._file, self._end)) if self._plain else None

    def go_on(self, kept: Any, cut: bool) -> None:
        """Go on behind the lines that are there, or that were there at the checkpoint."""
        if not self._plain:
            return
        if cut and kept is not None:
            size, (end, mark) = os.fstat(self._file).st_size, kept
            if end <= size and mark == _mark_of(self._file, end):
                os.ftruncate(self._file, end)
            elif size:
                LOG.warning("sink %s: it is another file than at the checkpoint; lines go on behind what is in it.", self.name)
        self._end = os.lseek(self._file, 0, os.SEEK_END)

    def close(self) -> None:
        """Close the file."""
        os.close(self._file)


def to_file(path: str) -> JSONLines:
    """Open a file for lines; what is in it stays.

    Raises:
        FileError: it cannot be written, another run writes to it, or it has something else than lines of JSON.
    """
    with foreign(path, "a file that can be written"):
        file = _to_append(path)
        begins = os.pread(file, 20, 0) if stat.S_ISREG(os.fstat(file).st_mode) else b""
        if begins[:1] not in b"{\n":
            os.close(file)
            reject(path, "a file of JSON lines, or none", f"one that begins with {begins!a}", "Name another, or move that away.")
        return JSONLines(path, file, path)


def to_open(name: str, file: int) -> JSONLines:
    """Take a file that is open, such as standard output.

    Raises:
        FileError: another run writes to it.
    """
    _lock(file, name)
    return JSONLines(name, file)


def _to_append(path: str) -> int:
    """Open a file to write behind what is in it, which no other run does until it is closed."""
    if _is_pipe(path):
        # without a reader it can only be opened beside one: who read and wrote himself would fill it, and wait for himself
        reader = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
        try:
            return os.open(path, os.O_WRONLY | os.O_CLOEXEC)
        finally:
            os.close(reader)
    file = os.open(path, os.O_RDWR | os.O_CREAT | os.O_APPEND | os.O_CLOEXEC, 0o666)
    _lock(file, path)
    return file


def _is_pipe(path: str) -> bool:
    try:
        return stat.S_ISFIFO(os.stat(path).st_mode)
    except FileNotFoundError:
        return False


def _lock(file: int, name: str) -> None:
    """Have no other run write to an open file until it is closed; it is closed where another does."""
    if POSIX and stat.S_ISREG(os.fstat(file).st_mode):
        import fcntl

        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(file)
            reject(name, *IN_USE)
        except OSError:
            # some file systems have no locks
            return


def _is_at(file: int, path: str) -> bool:
    """Tell whether an open file is the one that a path leads to."""
    try:
        return os.path.samestat(os.fstat(file), os.stat(path))
    except FileNotFoundError:
        return False


def _mark_of(file: int, size: int) -> str:
    """Return what an open file is known by: the last of so many bytes, or what it is to the system where none can be read."""
    # a shell may have opened it to be written only
    with suppress(OSError):
        if size:
            return known_by(file, size)
    return f"{os.fstat(file).st_dev}:{os.fstat(file).st_ino}"


def _ends_a_line(file: int, size: int) -> bool:
    """Tell whether a line ends at a byte of an open file, or whether that is its beginning."""
    try:
        return size == 0 or os.pread(file, 1, size - 1) == b"\n"
    except OSError:
        # a shell opened it to be written only
        return True
