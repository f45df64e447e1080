"""Arrays by name from tables and from files of arrays: CSV, JSON, Parquet, NPZ, NetCDF and MAT."""

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from motes.core import checks
from motes.io.columns import Cells, Columns, MissingColumnError, check_names_of_units
from motes.io.dialect import PLAIN, Dialect
from motes.io.files import foreign, label, look, reject
from motes.io.guesses import guessed
from motes.io.matlab import read_all
from motes.io.members import LARGEST, PACKED, opened, too_large
from motes.io.tables import read_table

NETCDF = (b"\x89HDF", b"CDF\x01", b"CDF\x02", b"CDF\x05")


def read_arrays(
    path: str | os.PathLike[str], names: Sequence[str] | None = None, dialect: Dialect = PLAIN, time: str = ""
) -> dict[str, np.ndarray] | Columns:
    """Read arrays of a file, told apart by its content: columns of a table, or arrays of numbers with one axis or more.

    Args:
        path: the file.
        names: of the columns to read of a table; all if None, and all of a file of arrays.
        dialect: how a table is written; of a file of arrays its units, and what stands for nothing.
        time: name of times; "" where there are none.

    Raises:
        FileError: the file is missing, damaged, or holds no arrays of numbers; or a column is missing, with a proposal.
        MotesError: the dialect has no such unit, format or zone.
        MissingExtraError: it is NetCDF or Parquet, and what reads these is not installed.
    """
    if not os.fspath(path):
        checks.refuse("data file", "a file of measurements", "none", "Give --data.file, or --data FILE.")
    _, start = look(path, 128)
    expected = {time: "s"} if time else {}
    cells = Cells(path, "row", (), dialect, expected)
    if start[:4] == b"PK\x03\x04":
        return _numeric(path, _members(path), cells)
    if start.startswith(NETCDF):
        return _numeric(path, _netcdf(path), cells)
    if start[124:128] in (b"\x00\x01IM", b"\x01\x00MI"):
        return _numeric(path, read_all(path), cells)
    try:
        return read_table(path, names, (), dialect, expected)
    except MissingColumnError as reason:
        raise _with_likely_names(reason, names or ()) from None


def _with_likely_names(reason: MissingColumnError, names: Sequence[str]) -> checks.FileError:
    """Return a refusal with what the columns may be called instead."""
    lost = [name for name in names if name not in reason.names]
    found = guessed(lost, [name for name in reason.names if name not in names])
    meant = [f"{name!r}: {guess.column!r}" for name, guess in found.items()]
    return checks.FileError(str(reason) + (f" Perhaps {', '.join(meant)} is meant." if meant else ""))


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


def _numeric(path: str | os.PathLike[str], arrays: dict[str, np.ndarray], cells: Cells) -> dict[str, np.ndarray]:
    """Leave out what is no array of numbers or times; columns of one are rows of numbers, in the units that are expected."""
    found = {name: array[:, 0] if array.ndim == 2 and array.shape[1] == 1 else array
             for name, array in arrays.items() if array.ndim and array.dtype.kind in "biufMm"}  # fmt: skip
    if not found:
        reject(label(path), "at least one array of numbers", f"{', '.join(arrays)[:160] or 'none'}")
    check_names_of_units(path, list(found), cells.dialect)
    for name in (name for name, array in found.items() if array.dtype.kind == "M"):
        cells.refuse_unit(name)
    return {name: cells.plain(name, array.astype(np.float64)) if name in cells.dialect.units else
            cells.plain(name, array) if array.dtype.kind == "f" else array for name, array in found.items()}  # fmt: skip
