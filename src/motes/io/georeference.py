"""Where the posts of a raster are: its reference system, and how long its degrees or meters are on the ground."""

import math
import re
from typing import Any

import numpy as np

from motes.core.checks import need
from motes.io.files import reject

FINEST = 0.05
"""Meters; posts of a projected map that seem nearer to each other are degrees."""
UNEVEN, TRUE = 0.05, 0.001
"""Shares by which a meter may vary over a projected map, and by which it may be off to be taken for one."""
GEOCENTRIC = ("WGS 84", "GRS 1980", "CGCS2000")
"""Ellipsoids of the datums that agree with WGS 84 within two meters."""
SEMI_MAJOR, ECCENTRICITY_SQUARED = 6378137.0, 6.69437999014e-3  # WGS 84


def meters_per_degree(latitude: float) -> tuple[float, float]:
    """Return the lengths of one degree of latitude and of longitude on the WGS 84 ellipsoid, meters.

    They follow from the radii of curvature along the meridian and along the normal section at right angles to it.

    Args:
        latitude: degrees.
    """
    phi = math.radians(latitude)
    bulge = 1.0 - ECCENTRICITY_SQUARED * math.sin(phi) ** 2
    meridian, normal = SEMI_MAJOR * (1.0 - ECCENTRICITY_SQUARED) / bulge**1.5, SEMI_MAJOR / math.sqrt(bulge)
    return math.radians(meridian), math.radians(normal * math.cos(phi))


def ground_lengths(crs: Any, north: float, east: float) -> tuple[float, float]:
    """Return the meters on the ground, to the north and to the east, per meter of a projected reference system at a place.

    Both are 1 where they are it within a thousandth, as everywhere in a zone of UTM.

    Args:
        crs: the system.
        north: northing of the place, meters.
        east: its easting.

    Raises:
        MissingExtraError: rasterio is not installed.
    """
    warp, step = need("rasterio.warp", "terrain"), 50.0
    easts, norths = [east, east, east - step, east + step], [north - step, north + step, north, north]
    longitude, latitude = (np.array(part) for part in warp.transform(crs, "EPSG:4326", easts, norths))
    per_north, per_east = meters_per_degree(float(latitude.mean()))
    legs = np.hypot(per_north * np.diff(latitude)[::2], per_east * np.diff(longitude)[::2]) / (2 * step)
    return (1.0, 1.0) if (np.abs(legs - 1) <= TRUE).all() else (float(legs[0]), float(legs[1]))


def georeference(name: str, file: Any) -> tuple[float, float, float, float, str, int | None]:
    """Return north, west, dy, dx, crs and EPSG number of a file that GDAL has opened.

    Args:
        name: the file as messages show it.
        file: as rasterio gives it.

    Raises:
        FileError: it has no georeference, one that is turned or not in meters or degrees, or one whose meters differ over the map.
    """
    step, crs = file.transform, file.crs
    if not crs or step.is_identity:
        hint = "Write it with gdal_translate -a_srs -a_ullr."
        reject(name, "a georeference (reference system and position)", "none", hint)
    numbers = tuple(step)[:6]
    if not all(map(math.isfinite, numbers)) or step.b or step.d or step.a <= 0 or step.e == 0:
        reject(name, "rows that run east and columns north or south", f"the transform {numbers}", "Resample it.")
    if not (crs.is_geographic or crs.is_projected):
        reject(name, "a geographic or projected reference system", crs.to_string())
    unit, factor = crs.units_factor
    if abs(factor - (math.radians(1) if crs.is_geographic else 1.0)) > 1e-9:
        reject(name, "coordinates in degrees or meters", f"the unit {unit!r}", "Reproject the file.")
    dy, dx = abs(step.e), step.a
    # GDAL gives the outer corners of cells also for files of points
    north = step.f - dy / 2 if step.e < 0 else step.f + (file.height - 0.5) * dy
    west = step.c + dx / 2
    south, east = north - (file.height - 1) * dy, west + (file.width - 1) * dx
    if crs.is_projected and max(dy, dx) < FINEST:
        reject(name, f"posts at least {FINEST} m apart in {crs.to_string()}", f"{max(dy, dx):.3g} m",
               "These look like degrees: the reference system is a wrong one.")
    if crs.is_geographic and not (-90 - dy <= south and north <= 90 + dy and -180 - dx <= west and east <= 360 + dx):
        given = f"latitudes {south:.6g} to {north:.6g} and longitudes {west:.6g} to {east:.6g}"
        reject(name, "latitudes within 90 and longitudes within 180 degrees", given)
    if crs.is_projected:
        _check_ground(name, crs, (south, west, north, east))
    return north, west, dy, dx, "geographic" if crs.is_geographic else "projected", crs.to_epsg()


def _check_ground(name: str, crs: Any, extent: tuple[float, float, float, float]) -> None:
    """Refuse a projected map on which a meter is not nearly the same everywhere, or nobody could tell later how long it is."""
    south, west, north, east = extent
    middle = ground_lengths(crs, (south + north) / 2, (west + east) / 2)
    sides = [ground_lengths(crs, y, x) for y, x in ((south, west), (south, east), (north, west), (north, east))]
    spread = max(abs(side[axis] / middle[axis] - 1) for side in sides for axis in (0, 1))
    if not spread <= UNEVEN:
        reject(name, f"a map on which a meter varies by at most {UNEVEN:.0%}", f"{spread:.1%}", "Cut it, or reproject it to UTM.")
    if crs.to_epsg() is None and middle != (1.0, 1.0):
        reject(name, "a projected reference system with an EPSG number, or one without a scale",
               f"{middle[0]:.4g} m on the ground for one on the map", "Reproject it to UTM.")  # fmt: skip


def other_datum(crs: Any) -> str | None:
    """Return the datum of a reference system whose ellipsoid is not that of WGS 84 and its kin, which agree within two meters."""
    text = crs.to_wkt()
    ellipsoid, datum = (re.search(rf'{word}\["([^"]*)"', text) for word in ("SPHEROID", "DATUM"))
    if ellipsoid and ellipsoid[1] in GEOCENTRIC:
        return None
    return (datum[1].replace("_", " ") or "without a name")[:80] if datum else "without a name"
