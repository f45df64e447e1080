"""Results as lines of JSON, in a file or on standard output: only whole lines are ever there."""

import os
import stat
from typing import Any

from motes.io.files import foreign
from motes.live.sink import Sink, line_of


class JSONLines(Sink):
    """Writes each record as a line, at once."""

    def __init__(self, name: str, file: int):
        """Write to an open file, by its number, which is closed in the end."""
        self.name, self._file = name, file
        self._plain = stat.S_ISREG(os.fstat(file).st_mode)

    def write(self, record: dict[str, Any]) -> None:
        """Write a line; of a file that is full what is only half of one is taken back."""
        line = line_of(record) + b"\n"
        if not self._plain:
            while line:
                line = line[os.write(self._file, line) :]
            return
        written = os.write(self._file, line)
        if written < len(line):
            os.ftruncate(self._file, os.lseek(self._file, 0, os.SEEK_CUR) - written)
            os.lseek(self._file, 0, os.SEEK_END)
            raise OSError(f"the disk took {written} of {len(line)} bytes")

    def secure(self) -> None:
        """Force the lines to disk."""
        if self._plain:
            os.fsync(self._file)

    def kept(self) -> int | None:
        """Return how many bytes the lines are."""
        return os.lseek(self._file, 0, os.SEEK_CUR) if self._plain else None

    def go_on(self, kept: int | None, cut: bool) -> None:
        """Go on behind the lines that are there, or that were there at the checkpoint."""
        if self._plain:
            if cut and kept is not None and kept <= os.fstat(self._file).st_size:
                os.ftruncate(self._file, kept)
            os.lseek(self._file, 0, os.SEEK_END)

    def close(self) -> None:
        """Close the file."""
        os.close(self._file)


def to_file(path: str) -> JSONLines:
    """Open a file for lines; what is in it stays.

    Raises:
        FileError: it cannot be written.
    """
    with foreign(path, "a file that can be written"):
        file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_CLOEXEC, 0o666)
        os.lseek(file, 0, os.SEEK_END)
        return JSONLines(path, file)
