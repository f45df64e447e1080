"""Arrays in NumPy's zip format, member by member: what a header claims is compared with the file before anything is allocated."""

import math
import os
import zipfile
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple

import numpy as np

from motes.io.files import foreign, reject

LARGEST = 1 << 27
"""Bytes that any file may unpack to."""
PACKED = 100
"""Beyond that, a file may unpack to so many times its own size."""


class Form(NamedTuple):
    """What a header says of an array.

    Attributes:
        shape: of the array.
        dtype: of the array once it is read, in the byte order of the machine.
    """

    shape: tuple[int, ...]
    dtype: np.dtype


class Members:
    """The arrays of an open archive, by name without `.npy`."""

    def __init__(self, path: str | os.PathLike[str], archive: zipfile.ZipFile):
        """Look at the list of members.

        Raises:
            FileError: two members have one name.
        """
        self._path, self._archive = path, archive
        self.names = archive.namelist()
        twice = next((name for name, count in Counter(self.names).items() if count > 1), None)
        if twice is not None:
            reject(path, "members of different names", f"{twice[:80]!r} more than once")

    @property
    def sizes(self) -> tuple[int, int]:
        """Bytes that all members unpack to, and those that they take in the file."""
        return unpacked(self._archive)

    def form(self, name: str) -> Form:
        """Return shape and type of an array, which is known to fill its member exactly.

        Raises:
            FileError: there is no such array, it holds objects, or it does not fill its member.
        """
        if f"{name}.npy" not in self.names:
            reject(self._path, f"an array named '{name}'", f"{', '.join(self.names)[:160] or 'no array'}")
        stored = self._archive.getinfo(f"{name}.npy").file_size
        with self._archive.open(f"{name}.npy") as file:
            version = np.lib.format.read_magic(file)
            read_header = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
            shape, _, kind = read_header(file)
            if kind.hasobject or min(shape, default=1) < 0 or math.prod(shape) * kind.itemsize != stored - file.tell():
                reject(self._path, f"'{name}' of numbers that fill its member of {stored} bytes", f"{kind} of shape {shape}")
        return Form(shape, kind.newbyteorder("="))

    def read(self, name: str) -> np.ndarray:
        """Return an array as it is stored; ask for its form first."""
        with self._archive.open(f"{name}.npy") as file:
            return np.lib.format.read_array(file, allow_pickle=False)

    def text(self, name: str, most: int) -> Any:
        """Return the bytes of a member that is no array.

        Raises:
            FileError: there is none, or it is longer than allowed.
        """
        if name not in self.names:
            reject(self._path, f"a member {name!r}", f"{', '.join(self.names)[:160] or 'no member'}")
        size = self._archive.getinfo(name).file_size
        if size > most:
            reject(self._path, f"at most {most} bytes in {name!r}", size)
        return self._archive.read(name)


@contextmanager
def opened(path: str | os.PathLike[str], expected: str) -> Iterator[Members]:
    """Open an archive; whatever goes wrong with it inside of the block becomes a FileError.

    Args:
        path: the file.
        expected: what a good file would have been.

    Raises:
        FileError: the file is missing or damaged.
    """
    with foreign(path, expected), zipfile.ZipFile(path) as archive:
        yield Members(path, archive)


def unpacked(archive: zipfile.ZipFile) -> tuple[int, int]:
    """Return the bytes that the members of an archive unpack to, and those that they take in it."""
    members = archive.infolist()
    return sum(member.file_size for member in members), sum(member.compress_size for member in members)


def too_large(full: int, packed: int) -> bool:
    """Whether a file promises so much more than it holds that it is rather made to exhaust memory."""
    return full > max(LARGEST, PACKED * packed)
