"""SRTM tiles (HGT): bare heights, whose place stands in the name of the file; plain, or in the zip archive they are handed out in."""

import os
import re
import zipfile
from pathlib import Path

import numpy as np

from motes.io.files import foreign, label, reject
from motes.io.raster_headers import check_size

SIZES = {2 * columns * rows: (rows, columns) for columns, rows in ((1201, 1201), (1801, 3601), (3601, 3601))}
SUFFIX = ".hgt"


def zipped_name(path: str | os.PathLike[str]) -> str | None:
    """Return the name of the HGT tile in a zip archive; None where there is none.

    Raises:
        FileError: the archive is damaged, or holds several tiles, or neither a tile nor an array.
    """
    with foreign(path, "an undamaged zip archive"), zipfile.ZipFile(path) as archive:
        names = archive.namelist()
    found = [name for name in names if name.lower().endswith(SUFFIX)]
    if not found and not any(name.endswith(".npy") for name in names):
        expected = "an npz map with an array 'elevation', or an HGT tile, in the archive"
        reject(path, expected, ", ".join(names)[:160] or "nothing", "Unpack it.")
    if len(found) > 1:
        reject(path, "one HGT tile in the archive", f"{len(found)}: {', '.join(found)[:120]}", "Unpack it and name the tiles.")
    return found[0] if found else None


def read_hgt(path: str | os.PathLike[str], largest: int, inside: str | None = None) -> tuple[np.ndarray, float, float, float, float]:
    """Read a tile.

    Args:
        path: the file.
        largest: number of heights allowed.
        inside: name of the tile where the file is a zip archive.

    Returns:
        The heights `(rows, columns)` as stored, row 0 in the north, then in degrees: latitude and longitude of the north-west post,
        spacing of the rows and of the columns.

    Raises:
        FileError: the name is no corner on the globe, the size is that of no tile, or the archive is damaged.
    """
    name = label(path)
    with foreign(path, "an undamaged HGT tile"):
        if inside is None:
            rows, columns, latitude, longitude = _tile_corner(name, Path(path).name, Path(path).stat().st_size, largest)
            data = Path(path).read_bytes()
        else:
            with zipfile.ZipFile(path) as archive:
                size = archive.getinfo(inside).file_size
                rows, columns, latitude, longitude = _tile_corner(name, inside.replace("\\", "/").rsplit("/", 1)[-1], size, largest)
                data = archive.read(inside)
        heights = np.frombuffer(data, ">i2").reshape(rows, columns)
    return heights, float(latitude + 1), float(longitude), 1 / (rows - 1), 1 / (columns - 1)


def _tile_corner(name: str, tile: str, size: int, largest: int) -> tuple[int, int, int, int]:
    """Return rows, columns, and latitude and longitude of the south-west corner."""
    parts = re.fullmatch(r"([NS])(\d\d)([EW])(\d\d\d)\.hgt", tile, re.IGNORECASE | re.ASCII)
    if not parts:
        reject(name, "a name such as N44E005.hgt (the south-west corner)", repr(tile[:80]))
    latitude = int(parts[2]) * (1 if parts[1] in "Nn" else -1)
    longitude = int(parts[4]) * (1 if parts[3] in "Ee" else -1)
    if not -90 <= latitude <= 89:
        reject(name, "a south edge between S90 and N89 in the name", f"{parts[1]}{parts[2]}")
    if not -180 <= longitude <= 179:
        reject(name, "a west edge between W180 and E179 in the name", f"{parts[3]}{parts[4]}")
    if size not in SIZES:
        sizes = ", ".join(f"{known} ({columns} x {rows})" for known, (rows, columns) in SIZES.items())
        reject(name, f"a size in bytes of {sizes}", f"{size} bytes", "The file is damaged or not an HGT tile.")
    check_size(name, *SIZES[size], largest)
    return *SIZES[size], latitude, longitude
