"""Writers of small rasters, good and damaged, for the tests of the readers."""

import struct
import warnings

import numpy as np
import pytest

rasterio = pytest.importorskip("rasterio")
Affine = rasterio.transform.Affine
NORTH_UP = Affine(0.001, 0, 5, 0, -0.001, 45)
HEIGHTS = np.add.outer(np.arange(12) * 10, np.arange(9)).astype(np.int16)


def geotiff(path, heights=HEIGHTS, crs="EPSG:4326", transform=NORTH_UP, unit=None, **options):
    bands = heights if heights.ndim == 3 else heights[None]
    shape = {"width": bands.shape[2], "height": bands.shape[1], "count": bands.shape[0], "dtype": bands.dtype.name}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        with rasterio.open(path, "w", driver="GTiff", crs=crs, transform=transform, **shape, **options) as file:
            file.write(bands)
            if unit:
                file.units = (unit,) * len(bands)
    return path


def dted(path, heights=None, latitude=44, longitude=5, interval=(300, 300), before=b""):
    """Write a DTED file byte by byte; heights have row 0 in the south, like the profiles of the format."""
    heights = np.add.outer(np.arange(121), np.arange(121)) if heights is None else heights
    rows, columns = heights.shape
    sides = b"N" if latitude >= 0 else b"S", b"E" if longitude >= 0 else b"W"
    y, x = abs(latitude), abs(longitude)
    uhl = b"UHL1%03d0000%s%03d0000%s%04d%04d" % (x, sides[1], y, sides[0], interval[1], interval[0])
    uhl = (uhl + b"0010U  " + b" " * 12 + b"%04d%04d0" % (columns, rows)).ljust(80)
    dsi = bytearray(b" " * 648)
    dsi[0:4], dsi[59:64] = b"DSIU", b"DTED1"
    dsi[141:144], dsi[144:149] = b"MSL", b"WGS84"
    dsi[185:204] = b"%02d0000.0%s%03d0000.0%s" % (y, sides[0], x, sides[1])
    dsi[273:289] = b"%04d%04d%04d%04d" % (*interval, rows, columns)
    records = []
    for column in range(columns):
        words = [abs(int(v)) | (0x8000 if v < 0 else 0) for v in heights[:, column]]
        body = struct.pack(f">BBHHH{rows}H", 0xAA, 0, column, column, 0, *words)
        records.append(body + struct.pack(">I", sum(body)))
    path.write_bytes(before + uhl + bytes(dsi) + b"ACC".ljust(2700) + b"".join(records))
    return path


def hgt(folder, name="N44E005.hgt", value=100, cells=1201 * 1201):
    heights = np.full(cells, value, ">i2")
    heights[:2] = 250, -32768
    (folder / name).write_bytes(heights.tobytes())
    return folder / name


def npz(path, **changes):
    values = {"elevation": HEIGHTS, "xmin": 5.0, "xmax": 5.009, "ymin": 45.0, "ymax": 44.988, "dx": 0.001, "dy": 0.001}
    np.savez(path, **{**values, **changes})
    return path


def patched(path, at, new):
    data = bytearray(path.read_bytes())
    data[at : at + len(new)] = new
    path.write_bytes(data)
    return path


def sparse(path):
    return geotiff(path, SPARSE_OK=True, tiled=True, blockxsize=16, blockysize=16, heights=np.zeros((40, 40), np.int16))


def lying(path):
    """A GeoTIFF of a few hundred bytes whose header asks for 60000 by 60000 heights."""
    geotiff(path)
    data = path.read_bytes()
    for tag, value in ((256, 60000), (257, 60000)):
        at = data.index(struct.pack("<HHI", tag, 3, 1))
        data = data[: at + 8] + struct.pack("<H", value) + data[at + 10 :]
    path.write_bytes(data)
    return path


def cut(path, share):
    path.write_bytes(path.read_bytes()[: int(path.stat().st_size * share)])
    return path


def written(path, data):
    path.write_bytes(data)
    return path
