"""Matrices of real numbers from MATLAB 5 files ("MAT-File Format", The MathWorks): every length is checked before it is believed.

The file is walked through here because the usual reader can end the whole process over a damaged file.
"""

import math
import os
import struct
import zlib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np

from motes.io.files import foreign, look, reject

HEADER = 128
ORDERS = {b"\x00\x01IM": "<", b"\x01\x00MI": ">"}
"""Version and byte order at the end of the header."""
LARGEST = 256 * 2**20
"""Bytes of a file, or of one variable of it, at most."""
UNPACKED, PACKED, NUMBERS = 2**26, 100, 2**23
"""Bytes that any compressed variable may have, how many times its packed size beyond that, and the numbers that any matrix may have."""
MATRIX, COMPRESSED = 14, 15
STORED = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
CLASSES = dict(enumerate("cell struct object char sparse double single int8 uint8 int16 uint16 int32 uint32 int64 uint64".split(), 1))
NUMERIC = range(6, 16)
COMPLEX = 0x0800


class _Variable(NamedTuple):
    name: str
    kind: int
    """Its class, with flags in the bits above the lowest eight."""
    shape: tuple[int, ...]
    rest: memoryview
    """What comes after the header: the numbers."""


def read_matrices(path: str | os.PathLike[str], widths: Mapping[str, int]) -> dict[str, np.ndarray]:
    """Read matrices of finite real numbers; other variables of the file are passed over.

    Args:
        path: the file.
        widths: number of columns of each variable wanted.

    Returns:
        A float64 array `(rows, columns)` per variable, with at least one row.

    Raises:
        FileError: the file is damaged or no MATLAB 5 file, or a variable is missing, has another shape, or holds something other than
            finite real numbers; the message names the variable.
    """
    size, order = _looked_at(path)
    found: dict[str, np.ndarray] = {}
    others = []
    with foreign(path, "an undamaged MATLAB 5 file"):
        for variable in _variables(memoryview(Path(path).read_bytes())[HEADER:], order):
            if variable.name in found:
                reject(path, "variables of different names", f"{variable.name} twice")
            if variable.name in widths:
                _check_size(path, variable, widths[variable.name], max(NUMBERS, size))
                found[variable.name] = _as_matrix(variable, order)
            else:
                others.append(variable.name)
    for name in widths:
        if name not in found:
            reject(path, f"a variable named {name}", ", ".join([*found, *others])[:160] or "no variable")
        bad = np.argwhere(~np.isfinite(found[name]))
        if len(bad):
            row, column = bad[0]
            reject(path, f"finite numbers in {name}", f"{found[name][row, column]} in row {row + 1}, column {column + 1}")
    return found


def read_all(path: str | os.PathLike[str]) -> dict[str, np.ndarray]:
    """Read all matrices of real numbers, NaN among them or not; other variables are passed over.

    Raises:
        FileError: the file is damaged or no MATLAB 5 file, or a matrix is larger than allowed.
    """
    size, order = _looked_at(path)
    found: dict[str, np.ndarray] = {}
    with foreign(path, "an undamaged MATLAB 5 file"):
        for variable in _variables(memoryview(Path(path).read_bytes())[HEADER:], order):
            real = not variable.kind & COMPLEX and variable.kind & 0xFF in NUMERIC and len(variable.shape) == 2 and variable.shape[0] > 0
            if real and variable.shape[1] > 0:
                _check_size(path, variable, variable.shape[1], max(NUMBERS, size))
                found[variable.name] = _as_matrix(variable, order)
    return found


def _looked_at(path: str | os.PathLike[str]) -> tuple[int, str]:
    """Return size and byte order of a file."""
    size, start = look(path, HEADER)
    if start[HEADER - 4 :] not in ORDERS:
        reject(path, "a MATLAB 5 file", f"one that starts with {start[:8]!r}")
    if size > LARGEST:
        reject(path, f"a file of at most {LARGEST} bytes", size)
    return size, ORDERS[start[HEADER - 4 :]]


def _check_size(path: str | os.PathLike[str], variable: _Variable, width: int, most: int) -> None:
    name, kind, shape, _ = variable
    given = ("complex " if kind & COMPLEX else "") + CLASSES.get(kind & 0xFF, "another class")
    if kind & COMPLEX or kind & 0xFF not in NUMERIC or len(shape) != 2 or shape[1] != width or shape[0] < 1:
        reject(path, f"{name} as a matrix of real numbers with {width} columns", f"{given} of shape {shape}")
    if shape[0] * width > most:
        reject(path, f"at most {most} numbers in {name}", f"{shape[0]} rows of {width}")


def _variables(data: memoryview, order: str) -> Iterator[_Variable]:
    at = 0
    while at < len(data):
        kind, body, at = _element(data, at, order)
        if kind == COMPRESSED:
            kind, body, _ = _element(_inflated(body), 0, order)
        if kind != MATRIX:
            raise ValueError(f"an element of type {kind} where a variable should be")
        yield _variable(body, order)


def _inflated(body: memoryview) -> memoryview:
    stream = zlib.decompressobj()
    most = min(LARGEST, max(UNPACKED, PACKED * len(body)))
    data = stream.decompress(body, most)
    if not stream.eof:
        raise ValueError(f"a compressed variable that is cut short or has more than {most} bytes")
    return memoryview(data)


def _element(data: memoryview, at: int, order: str) -> tuple[int, memoryview, int]:
    """Return type and body of the element that starts at `at`, and where the next one starts."""
    if len(data) - at < 8:
        raise ValueError("a variable that is cut short")
    kind, count = struct.unpack_from(f"{order}II", data, at)
    begin = at + 8
    if kind >> 16:
        # up to four bytes share the eight of the tag
        kind, count, begin = kind & 0xFFFF, kind >> 16, at + 4
    end = begin + count
    if end > len(data) or (begin == at + 4 and count > 4):
        raise ValueError(f"a variable that claims {count} bytes where {len(data) - begin} are left")
    return kind, data[begin:end], end if kind == COMPRESSED else -(-end // 8) * 8


def _variable(body: memoryview, order: str) -> _Variable:
    _, flags, at = _element(body, 0, order)
    _, sizes, at = _element(body, at, order)
    _, name, at = _element(body, at, order)
    (kind,) = struct.unpack_from(f"{order}I", flags)
    shape = struct.unpack(f"{order}{len(sizes) // 4}i", sizes)
    return _Variable(bytes(name).decode("ascii"), kind, shape, body[at:])


def _as_matrix(variable: _Variable, order: str) -> np.ndarray:
    kind, stored, _ = _element(variable.rest, 0, order)
    if kind not in STORED:
        raise ValueError(f"numbers of type {kind} in {variable.name}")
    values = np.frombuffer(stored, np.dtype(order + STORED[kind]))
    if values.size != math.prod(variable.shape):
        raise ValueError(f"{values.size} numbers in {variable.name} of shape {variable.shape}")
    return values.reshape(variable.shape, order="F").astype(np.float64)
