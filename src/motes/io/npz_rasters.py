"""Elevation maps in npz archives, read member by member: sizes are compared before anything is allocated."""

import math
import os

import numpy as np

from motes.io.files import label, reject
from motes.io.members import LARGEST, PACKED, Members, opened, too_large
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
    with opened(path, "an undamaged npz archive") as members:
        full, packed = members.sizes
        if too_large(full, packed):
            reject(name, f"at most {LARGEST} bytes, or {PACKED} times those of the file, when unpacked", f"{full} bytes")
        form = members.form("elevation")
        if len(form.shape) != 2 or form.dtype.kind not in "iuf":
            reject(name, "a matrix of real numbers as 'elevation'", f"{form.dtype} of shape {form.shape}")
        check_size(name, *form.shape, largest)
        heights = members.read("elevation")
        numbers = {key: _scalar(name, members, key) for key in ("xmin", "xmax", "ymin", "ymax", "dx", "dy")}
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


def _scalar(name: str, members: Members, key: str) -> float:
    form = members.form(key)
    if math.prod(form.shape) != 1 or form.dtype.kind not in "iuf":
        reject(name, f"one finite number as '{key}'", f"{form.dtype} of shape {form.shape}")
    value = float(members.read(key).item())
    if not math.isfinite(value):
        reject(name, f"one finite number as '{key}'", value)
    return value
