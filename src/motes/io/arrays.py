"""Arrays by name from tables and from files of arrays: CSV, JSON, Parquet, NPZ, NetCDF and MAT."""

import os
from pathlib import Path
from typing import Any

import numpy as np

from motes.core import checks
from motes.io.files import foreign, label, look, reject
from motes.io.matlab import read_all
from motes.io.members import LARGEST, PACKED, opened, too_large
from motes.io.tables import read_table

NETCDF = (b"\x89HDF", b"CDF\x01", b"CDF\x02", b"CDF\x05")


def read_arrays(path: str | os.PathLike[str]) -> dict[str, np.ndarray]:
    """Read all arrays of a file, told apart by its content: columns of a table, or arrays of numbers with one axis or more.

    Raises:
        FileError: the file is missing, damaged, or holds no arrays of numbers.
        MissingExtraError: it is NetCDF or Parquet, and what reads these is not installed.
    """
    if not os.fspath(path):
        checks.refuse("data file", "a file of measurements", "none", "Give --data.file, or --data FILE.")
    _, start = look(path, 128)
    if start[:4] == b"PK\x03\x04":
        return _numeric(path, _members(path))
    if start.startswith(NETCDF):
        return _numeric(path, _netcdf(path))
    if start[124:128] in (b"\x00\x01IM", b"\x01\x00MI"):
        return _numeric(path, read_all(path))
    return dict(read_table(path))


def _members(path: str | os.PathLike[str]) -> dict[str, np.ndarray]:
    with opened(path, "an undamaged npz archive") as members:
        full, packed = members.sizes
        if too_large(full, packed):
            reject(path, f"at most {LARGEST} bytes, or {PACKED} times those of the file, when unpacked", f"{full} bytes")
        names = [name.removesuffix(".npy") for name in members.names if name.endswith(".npy")]
        return {name: members.read(name) for name in names if members.form(name)}


def _netcdf(path: str | os.PathLike[str]) -> dict[str, np.ndarray]:
    xarray: Any = checks.need("xarray", "results")
    checks.need("h5netcdf", "results")
    with foreign(path, "a NetCDF file"), xarray.open_dataset(Path(path)) as data:
        return {str(name): np.asarray(values) for name, values in {**data.coords, **data.data_vars}.items()}


def _numeric(path: str | os.PathLike[str], arrays: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Leave out what is no array of numbers or times; columns of one are rows of numbers."""
    found = {name: array[:, 0] if array.ndim == 2 and array.shape[1] == 1 else array
             for name, array in arrays.items() if array.ndim and array.dtype.kind in "biufMm"}  # fmt: skip
    if not found:
        reject(label(path), "at least one array of numbers", f"{', '.join(arrays)[:160] or 'none'}")
    return found
