"""Elevation maps in npz archives, read member by member: sizes are compared before anything is allocated."""

import math
import os
import zipfile

import numpy as np

from motes.io.files import foreign, label, reject
from motes.io.raster_headers import check_size


def read_npz(path: str | os.PathLike[str], largest: int) -> tuple[np.ndarray, float, float, float, float]:
    """Read `elevation` with its outer edges `xmin`, `xmax`, `ymin`, `ymax` and its spacing `dx`, `dy` (degrees).

    The first row lies at `ymin`, which is the northern edge in the map that matplotlib ships.

    Args:
        path: the file.
        largest: number of heights allowed.

    Returns:
        The heights `(rows, columns)` as stored, then in degrees: latitude and longitude of the north-west post, spacing
        of the rows and of the columns.

    Raises:
        FileError: the archive is damaged or is no such map.
    """
    name = label(path)
    with foreign(path, "an undamaged npz archive"), zipfile.ZipFile(path) as archive:
        heights = _member(name, archive, "elevation", largest)
        if heights.ndim != 2 or heights.dtype.kind not in "iuf":
            reject(name, "a matrix of real numbers as 'elevation'", f"{heights.dtype} of shape {heights.shape}")
        check_size(name, heights.shape[0], heights.shape[1], largest)
        numbers = {key: _number(name, archive, key) for key in ("xmin", "xmax", "ymin", "ymax", "dx", "dy")}
    (rows, columns), dy, dx = heights.shape, numbers["dy"], numbers["dx"]
    if not (dx > 0 and dy > 0):
        reject(name, "positive 'dx' and 'dy'", f"{dx} and {dy}")
    south, north, west, east = numbers["ymax"], numbers["ymin"], numbers["xmin"], numbers["xmax"]
    if abs(north - south - rows * dy) > 0.01 * dy or abs(east - west - columns * dx) > 0.01 * dx:
        expected = f"edges {rows} x dy and {columns} x dx apart, 'ymin' being the edge of row 0 in the north"
        reject(name, expected, f"{north - south:.6g} and {east - west:.6g}")
    if south < -90 or north > 90 or west < -180 or east > 360:
        reject(name, "edges on the globe", f"{south:.6g} to {north:.6g} and {west:.6g} to {east:.6g}")
    return heights, north - dy / 2, west + dx / 2, dy, dx


def _number(name: str, archive: zipfile.ZipFile, key: str) -> float:
    value = _member(name, archive, key, 1)
    if value.size != 1 or value.dtype.kind not in "iuf" or not math.isfinite(value.item()):
        reject(name, f"one finite number as '{key}'", f"{value.dtype} of shape {value.shape}")
    return float(value.item())


def _member(name: str, archive: zipfile.ZipFile, key: str, largest: int) -> np.ndarray:
    names = archive.namelist()
    if f"{key}.npy" not in names:
        reject(name, f"an array named '{key}'", f"{', '.join(names)[:160] or 'no array'}")
    stored = archive.getinfo(f"{key}.npy").file_size
    with archive.open(f"{key}.npy") as file:
        version = np.lib.format.read_magic(file)
        read_header = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        shape, by_columns, kind = read_header(file)
        count = math.prod(shape)
        if kind.hasobject or count * kind.itemsize != stored - file.tell() or count > largest:
            reject(name, f"'{key}' of at most {largest} numbers that fill its member", f"{kind} of shape {shape}")
        values = np.frombuffer(file.read(), kind)
    return values.reshape(shape, order="F" if by_columns else "C")
