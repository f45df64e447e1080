"""Terrain heights from files: DTED, SRTM HGT, GeoTIFF and the elevation map that matplotlib ships.

The kind of a file is decided by its first bytes, headers are compared with the size of the file before anything is
allocated, and GDAL is told the one driver it may use. Heights are meters, voids are NaN, row 0 is north, and
coordinates are those of the posts (the centers of the cells), whatever the file's own convention.
"""

import math
import os
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from motes.core.checks import need, warn
from motes.core.record import record, static
from motes.io.files import foreign, label, look, reject
from motes.io.georeference import georeference, ground_lengths, meters_per_degree, other_datum
from motes.io.hgt import read_hgt, zipped_name
from motes.io.npz_rasters import read_npz
from motes.io.raster_headers import HEADER_BYTES, check_dted, check_dted_records, check_size, kind_of

LARGEST = 36_000_000
LOWEST, HIGHEST = -600.0, 9500.0
UNDECLARED_VOIDS = (-32767.0, -32768.0)
METERS = ("", "m", "metre", "metres", "meter", "meters")


@record
class Raster:
    """A regular grid of heights.

    Attributes:
        heights: `(rows, columns)` float32, meters, NaN at voids; row 0 is the northernmost, column 0 the westernmost.
        north: latitude (degrees) or northing (meters) of the post in row 0.
        west: longitude (degrees) or easting (meters) of the post in column 0.
        dy: spacing of the rows in the same unit, positive.
        dx: spacing of the columns in the same unit, positive.
        crs: "geographic" (degrees) or "projected" (meters).
        epsg: number of the coordinate reference system, None where the file does not name one.
        source: name of the file.
    """

    heights: np.ndarray
    north: float
    west: float
    dy: float
    dx: float
    crs: str = static(default="geographic")
    epsg: int | None = static(default=None)
    source: str = static(default="raster")

    @property
    def south(self) -> float:
        """Coordinate of the southernmost row of posts."""
        return self.north - (self.heights.shape[0] - 1) * self.dy

    @property
    def east(self) -> float:
        """Coordinate of the easternmost column of posts."""
        return self.west + (self.heights.shape[1] - 1) * self.dx

    @property
    def extent(self) -> tuple[float, float, float, float]:
        """Outermost posts as (south, west, north, east), in degrees or meters."""
        return self.south, self.west, self.north, self.east

    @property
    def latitude(self) -> float | None:
        """Latitude of the middle, degrees; None on a projected raster whose reference system has no EPSG number."""
        if self.crs == "geographic":
            return self._middle[0]
        if self.epsg is None:
            return None
        north, east = self._middle
        warp = need("rasterio.warp", "terrain")
        return float(warp.transform(f"EPSG:{self.epsg}", "EPSG:4326", [east], [north])[1][0])

    @property
    def _middle(self) -> tuple[float, float]:
        return (self.north + self.south) / 2, (self.west + self.east) / 2

    def spacing_m(self, latitude: float | None = None) -> tuple[float, float]:
        """Return the distance on the ground between rows and between columns in meters.

        On a projected raster that is measured at its middle: a map meter of Web Mercator, for one, is half a meter at 60 degrees.

        Args:
            latitude: where to measure it on a geographic raster, degrees; the mean latitude if not given.

        Raises:
            MissingExtraError: the raster is a projected one and rasterio is not installed.
        """
        if self.crs == "projected":
            north, east = (1.0, 1.0) if self.epsg is None else ground_lengths(f"EPSG:{self.epsg}", *self._middle)
            return north * self.dy, east * self.dx
        per_north, per_east = meters_per_degree(self._middle[0] if latitude is None else latitude)
        return self.dy * per_north, self.dx * per_east


def read_raster(path: str | os.PathLike[str], *, nodata: float | None = None, largest: int = LARGEST) -> Raster:
    """Read terrain heights from a DTED, HGT, GeoTIFF or npz file.

    Args:
        path: the file; its kind is decided by its first bytes (HGT, which has no mark, by its name and exact size; it may be zipped).
        nodata: a height that means "void", beside the declared one and, in whole numbers, -32767 and -32768.
        largest: refuse files with more heights than this, before reading them.

    Returns:
        The raster, heights `(rows, columns)` in meters with row 0 in the north and NaN at voids.

    Raises:
        FileError: the file is damaged, is none of these kinds, has no usable georeference, or holds heights outside
            -600 m to 9500 m that no void value explains.
        MissingExtraError: rasterio is not installed.

    Warns:
        MotesWarning: the file's coordinates belong to a datum other than WGS 84 and its kin; they are taken as they are.
    """
    size, start = look(path, HEADER_BYTES)
    name, file_name = label(path), Path(path).name
    kind = kind_of(name, file_name, start)
    if kind in ("npz", "HGT"):
        inside = zipped_name(path) if kind == "npz" else None
        grid, *place = read_hgt(path, largest, inside) if kind == "HGT" or inside else read_npz(path, largest)
        heights = _cleaned(name, grid.astype(np.float32), grid.dtype, nodata)
        north, west, dy, dx = place
        return Raster(heights, north, west, dy, dx, "geographic", 4326, file_name)
    if kind == "GTiff":
        return _read_gdal(path, kind, nodata, largest)
    check_dted(name, start, size, largest)
    with foreign(path, "an undamaged DTED file"):
        minus_zero = check_dted_records(name, Path(path).read_bytes(), largest)
    raster = _read_gdal(path, kind, nodata, largest)
    raster.heights[minus_zero] = np.nan
    return raster


def jacksboro() -> Raster:
    """Return the map of the Jacksboro fault (Tennessee) that matplotlib ships: 344 by 403 posts, 3 arc-seconds apart.

    Raises:
        MissingExtraError: matplotlib is not installed.
    """
    cbook = need("matplotlib.cbook", "results")
    return read_raster(cbook.get_sample_data("jacksboro_fault_dem.npz", asfileobj=False))


def mosaic(rasters: Sequence[Raster]) -> Raster:
    """Join rasters on one grid, without seams.

    Where rasters share posts the first measured height counts, so that a void never hides a measurement. Gaps are NaN.

    Args:
        rasters: with the same reference system and spacing, and posts on the same lattice.

    Raises:
        FileError: a raster does not fit the first one, or the whole would have more than 36 million posts.
    """
    if not rasters:
        reject("rasters", "at least one raster", "none")
    first = rasters[0]
    places = [_place(first, raster) for raster in rasters]
    top, left = min(row for row, _ in places), min(column for _, column in places)
    sizes = [raster.heights.shape for raster in rasters]
    rows = max(row + size[0] for (row, _), size in zip(places, sizes, strict=True)) - top
    columns = max(column + size[1] for (_, column), size in zip(places, sizes, strict=True)) - left
    names = "+".join(raster.source for raster in rasters)
    check_size(names if len(names) <= 160 else names[:157] + "...", rows, columns, LARGEST)
    whole = np.full((rows, columns), np.nan, np.float32)
    for (row, column), raster in zip(places, rasters, strict=True):
        height, width = raster.heights.shape
        part = whole[row - top : row - top + height, column - left : column - left + width]
        np.copyto(part, raster.heights, where=np.isnan(part))
    north, west = first.north - top * first.dy, first.west + left * first.dx
    return Raster(whole, north, west, first.dy, first.dx, first.crs, first.epsg, names)


def _place(first: Raster, other: Raster) -> tuple[int, int]:
    if (first.crs, first.epsg) != (other.crs, other.epsg):
        expected = f"the reference system of {first.source} ({first.crs}, EPSG {first.epsg})"
        reject(other.source, expected, f"{other.crs}, EPSG {other.epsg}")
    if first.crs == "projected" and first.epsg is None and other is not first:
        reject(other.source, "projected maps that name their EPSG number", "a reference system without one")
    # over a whole tile the posts may drift apart by no more than a hundredth of a cell
    steps = max(*first.heights.shape, *other.heights.shape)
    if abs(other.dy / first.dy - 1) * steps > 0.01 or abs(other.dx / first.dx - 1) * steps > 0.01:
        expected = f"the spacing of {first.source} ({first.dy:.8g} by {first.dx:.8g})"
        reject(other.source, expected, f"{other.dy:.8g} by {other.dx:.8g}", "Resample one of them.")
    row, column = (first.north - other.north) / first.dy, (other.west - first.west) / first.dx
    if abs(row - round(row)) > 0.01 or abs(column - round(column)) > 0.01:
        shift = f"posts {row - round(row):.3g} rows and {column - round(column):.3g} columns off"
        reject(other.source, f"posts on the lattice of {first.source}", shift, "Resample one of them.")
    return round(row), round(column)


def _read_gdal(path: str | os.PathLike[str], driver: str, nodata: float | None, largest: int) -> Raster:
    rasterio = need("rasterio", "terrain")
    name = label(path)
    # no sidecar files are read or written, and neighbors in the folder are not looked at
    options = {"DTED_VERIFY_CHECKSUM": "YES", "GDAL_PAM_ENABLED": "NO", "GDAL_DISABLE_READDIR_ON_OPEN": "EMPTY_DIR"}
    with warnings.catch_warnings(), foreign(path, f"an undamaged {driver} file"), rasterio.Env(**options):
        warnings.simplefilter("ignore", rasterio.errors.NotGeoreferencedWarning)
        with rasterio.open(Path(path).absolute(), driver=driver) as file:
            _check_layout(name, file, largest)
            grid = georeference(name, file)
            heights = file.read(1, out_dtype="float32")
            heights[file.read_masks(1) == 0] = np.nan
            stored, (scale,), (offset,) = np.dtype(file.dtypes[0]), file.scales, file.offsets
            if not (math.isfinite(scale) and math.isfinite(offset) and scale > 0):
                reject(name, "a positive scale and a finite offset of heights", f"{scale} and {offset}")
            heights = heights[::-1] if file.transform.e > 0 else heights
            heights = _cleaned(name, heights, stored, nodata, scale, offset)
            datum = other_datum(file.crs)
    if datum:
        warn(f"{name}: coordinates are those of the datum {datum}, which may lie hundreds of meters from WGS 84. Give positions in it too, "
             "or convert the file.")  # fmt: skip
    return Raster(heights, *grid, Path(path).name)


def _check_layout(name: str, file: Any, largest: int) -> None:
    if file.count != 1 or file.subdatasets:
        reject(name, "one band, the heights", f"{file.count} bands or several pictures")
    if np.dtype(file.dtypes[0]).kind not in "iuf":
        reject(name, "real numbers as heights", file.dtypes[0])
    check_size(name, file.height, file.width, largest)
    block = math.prod(file.block_shapes[0])
    if block > max(4 * file.height * file.width, 1 << 20):
        reject(name, "blocks not larger than the picture", f"blocks of {file.block_shapes[0]} posts")
    unit = (file.units[0] or "").strip()
    if unit.lower() not in METERS:
        reject(name, "heights in meters", f"the unit {unit!r}", "Convert the file to meters.")
    if file.driver == "GTiff" and file.nodata is None:
        _check_blocks(name, file)


def _check_blocks(name: str, file: Any) -> None:
    # GDAL reads a block that was never written as zeros, which would turn land into sea
    for (row, column), _ in file.block_windows(1):
        if file.get_tag_item(f"BLOCK_OFFSET_{column}_{row}", "TIFF", bidx=1) is None:
            reject(name, "every block of heights to be there", f"block {row}, {column} missing", "The file is damaged.")


def _cleaned(
    name: str, heights: np.ndarray, stored: np.dtype, nodata: float | None, scale: float = 1.0, offset: float = 0.0
) -> np.ndarray:
    """Put NaN at voids, turn what is stored into meters, and refuse heights that no place on Earth has."""
    voids = UNDECLARED_VOIDS if stored.kind in "iu" else ()
    for value in (*voids, *(() if nodata is None else (nodata,))):
        heights[heights == np.float32(value)] = np.nan
    if (scale, offset) != (1.0, 0.0):
        heights = (heights.astype(np.float64) * scale + offset).astype(np.float32)
    if np.isnan(heights).all():
        reject(name, "at least one measured height", "voids only")
    for extreme, beyond in ((np.nanargmin(heights), np.less), (np.nanargmax(heights), np.greater)):
        row, column = np.unravel_index(extreme, heights.shape)
        height = heights[row, column]
        if beyond(height, LOWEST if beyond is np.less else HIGHEST):
            expected = f"heights between {LOWEST:.0f} m and {HIGHEST:.0f} m"
            hint = f"If it marks voids, say so: nodata={height:.9g}."
            reject(name, expected, f"{height:.9g} in row {row}, column {column} (0-based, from the north-west)", hint)
    return np.ascontiguousarray(heights)
