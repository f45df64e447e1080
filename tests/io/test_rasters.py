import contextlib
import os
import socket
import struct
import zipfile

import numpy as np
import pytest
from raster_files import HEIGHTS, Affine, cut, dted, geotiff, hgt, lying, npz, patched, rasterio, sparse, written

from data import recorded, refused
from motes.core.checks import FileError
from motes.io.rasters import jacksboro, meters_per_degree, read_raster

pytestmark = pytest.mark.filterwarnings("error::pytest.PytestUnraisableExceptionWarning")


# good files ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "extent", "low", "high", "void"),
    [
        ("terrain/dted/w122/n36.dt1", (36, -122, 37, -121), -23, 1783, 0.0005),
        ("terrain/dted/w121/n36.dt1", (36, -121, 37, -120), 17, 1593, 0.00004),
        ("terrain/dted/e000_n05.dt0", (5, 0, 6, 1), 0, 268, 0),
        ("terrain/hgt/N44E005.hgt", (44, 5, 45, 6), 32, 2757, 0.0033),
    ],
)
def test_recorded_tiles_have_posts_on_whole_degrees(name, extent, low, high, void):
    tile = read_raster(recorded(name))
    assert tile.extent == pytest.approx(extent, abs=1e-9) and (tile.crs, tile.epsg) == ("geographic", 4326)
    assert (np.nanmin(tile.heights), np.nanmax(tile.heights)) == (low, high)
    assert np.isnan(tile.heights).mean() == pytest.approx(void, abs=6e-5) and tile.heights.dtype == np.float32


def test_recorded_geotiff_has_centers_of_cells():
    tile = read_raster(recorded("terrain/geotiff/srtm_bigtujunga30m_utm11.tif"))
    assert (tile.crs, tile.epsg, tile.dy, tile.dx) == ("projected", 32611, 30, 30)
    assert (tile.north, tile.west) == pytest.approx((3807917.8276283755 - 15, 376313.6554542635 + 15))
    assert tile.heights.shape == (643, 1197) and not np.isnan(tile.heights).any()


def test_dted_agrees_with_its_bytes(tmp_path):
    heights = np.arange(121 * 121).reshape(121, 121) % 5000 - 500
    heights[3, 4] = -32767
    tile = read_raster(dted(tmp_path / "any.name", heights, -44, -5, before=b"VOL".ljust(80) + b"HDR".ljust(80)))
    assert tile.extent == pytest.approx((-44, -5, -43, -4))
    expected = np.where(heights == -32767, np.nan, heights)[::-1]
    np.testing.assert_array_equal(tile.heights, expected)


def test_dted_above_50_degrees_has_wider_columns(tmp_path):
    tile = read_raster(dted(tmp_path / "n59.dt0", np.ones((121, 61), int), 59, 10, (300, 600)))
    assert tile.extent == pytest.approx((59, 10, 60, 11))
    assert (tile.dy, tile.dx) == pytest.approx((1 / 120, 1 / 60))
    assert tile.spacing_m() == pytest.approx((928.4, 944.6), rel=1e-3)


@pytest.mark.parametrize(("name", "south", "west"), [("N44E005.hgt", 44, 5), ("s01w180.HGT", -1, -180)])
def test_hgt_goes_by_its_name(tmp_path, name, south, west):
    tile = read_raster(hgt(tmp_path, name))
    assert tile.extent == pytest.approx((south, west, south + 1, west + 1))
    assert tile.heights[0, 0] == 250 and np.isnan(tile.heights[0, 1]) and tile.heights[1, 0] == 100


def test_hgt_of_one_arc_second_at_high_latitude(tmp_path):
    tile = read_raster(hgt(tmp_path, "N64E010.hgt", cells=1801 * 3601))
    assert tile.heights.shape == (3601, 1801) and tile.extent == pytest.approx((64, 10, 65, 11))


@pytest.mark.parametrize("options", [{}, {"compress": "deflate"}, {"BIGTIFF": "YES"}, {"ENDIANNESS": "BIG"}])
def test_geotiff_layouts(tmp_path, options):
    tile = read_raster(geotiff(tmp_path / "map.dat", **options))
    np.testing.assert_array_equal(tile.heights, HEIGHTS)
    assert (tile.north, tile.west) == pytest.approx((44.9995, 5.0005))


def test_geotiff_of_points_equals_that_of_areas(tmp_path):
    path = tmp_path / "point.tif"
    with rasterio.open(geotiff(path), "r+") as file:
        file.update_tags(AREA_OR_POINT="Point")
    tile = read_raster(path)
    assert (tile.north, tile.west) == pytest.approx((44.9995, 5.0005))


def test_geotiff_stored_from_the_south_is_turned(tmp_path):
    tile = read_raster(
        geotiff(tmp_path / "up.tif", HEIGHTS[::-1].copy(), transform=Affine(0.001, 0, 5, 0, 0.001, 44.988))
    )
    np.testing.assert_array_equal(tile.heights, HEIGHTS)
    assert tile.north == pytest.approx(44.9995)


def test_undeclared_voids_of_whole_numbers_are_voids(tmp_path):
    heights = HEIGHTS.copy()
    heights[0, :3] = -32768, -32767, -600
    tile = read_raster(geotiff(tmp_path / "a.tif", heights))
    np.testing.assert_array_equal(np.isnan(tile.heights).nonzero(), ([0, 0], [0, 1]))


@pytest.mark.parametrize("void", [-9999.0, 9999.0, -3.4028234663852886e38])
def test_declared_and_named_voids(tmp_path, void):
    heights = HEIGHTS.astype(np.float32)
    heights[2, 3] = void
    declared = read_raster(geotiff(tmp_path / "a.tif", heights, nodata=void))
    named = read_raster(geotiff(tmp_path / "b.tif", heights), nodata=void)
    for tile in (declared, named):
        np.testing.assert_array_equal(np.isnan(tile.heights).nonzero(), ([2], [3]))


def test_meters_may_be_declared(tmp_path):
    assert read_raster(geotiff(tmp_path / "a.tif", unit="metre")).heights.shape == HEIGHTS.shape
    assert read_raster(geotiff(tmp_path / "b.tif", crs="EPSG:4326+5773")).epsg == 9707


def test_no_file_is_written_and_no_connection_opened(tmp_path, monkeypatch, capfd):
    def never(*_):
        raise AssertionError("connected")

    monkeypatch.setattr(socket.socket, "connect", never)
    for path in (geotiff(tmp_path / "a.tif"), dted(tmp_path / "b.dt0"), hgt(tmp_path), npz(tmp_path / "c.npz")):
        read_raster(path)
    assert sorted(os.listdir(tmp_path)) == ["N44E005.hgt", "a.tif", "b.dt0", "c.npz"]
    assert capfd.readouterr() == ("", "")


def test_files_beside_the_map_change_nothing(tmp_path):
    path = geotiff(tmp_path / "a.tif")
    geotiff(tmp_path / "mask.tif", np.zeros((12, 9), np.uint8)).rename(tmp_path / "a.tif.msk")
    (tmp_path / "a.tif.aux.xml").write_text(
        "<PAMDataset><PAMRasterBand band='1'><NoDataValue>20</NoDataValue></PAMRasterBand></PAMDataset>"
    )
    np.testing.assert_array_equal(read_raster(path).heights, HEIGHTS)
    placeless = geotiff(tmp_path / "b.tif", transform=Affine.identity())
    (tmp_path / "b.tfw").write_text("0.001\n0\n0\n-0.001\n5\n45\n")
    with pytest.raises(FileError) as error:
        read_raster(placeless)
    refused(error, "georeference")


def test_jacksboro_has_row_0_in_the_north():
    tile = jacksboro()
    assert tile.heights.shape == (344, 403) and (tile.heights.min(), tile.heights.max()) == (236, 1076)
    # posts of SRTM lie on whole multiples of 3 arc-seconds, which the centers do and the edges in the file do not
    assert (tile.north * 1200, tile.west * 1200) == pytest.approx((44079, -101296), abs=1e-6)
    assert tile.south < tile.north
    # the fault's straight scarp north-west of the valley: plateau in the north-west, low ground in the south-east
    rows, columns = (size // 2 for size in tile.heights.shape)
    assert tile.heights[:rows, :columns].mean() > tile.heights[rows:, columns:].mean()


def test_npz_by_matplotlib_convention(tmp_path):
    tile = read_raster(npz(tmp_path / "map.npz", elevation=np.asfortranarray(HEIGHTS)))
    np.testing.assert_array_equal(tile.heights, HEIGHTS)
    assert (tile.north, tile.west) == pytest.approx((44.9995, 5.0005))


def test_degrees_have_their_geodetic_lengths():
    # published lengths of a degree on WGS 84
    assert meters_per_degree(0) == pytest.approx((110574.3, 111319.5), abs=0.1)
    assert meters_per_degree(45) == pytest.approx((111131.8, 78846.8), abs=0.1)
    pyproj = pytest.importorskip("pyproj")
    geod = pyproj.Geod(ellps="WGS84")
    _, _, north = geod.inv(10, 59.999, 10, 60.001)
    _, _, east = geod.inv(9.999, 60, 10.001, 60)
    assert (north / 0.002, east / 0.002) == pytest.approx(meters_per_degree(60), rel=1e-6)


# refusals ------------------------------------------------------------------------------------------------------------

VRT = b'<VRTDataset rasterXSize="2" rasterYSize="2"><VRTRasterBand dataType="Int16"/></VRTDataset>'


def with_height(value, kind=np.float32):
    heights = HEIGHTS.astype(kind)
    heights[7, 2] = value
    return heights


REFUSED = {
    "missing": (lambda d: d / "none.tif", "No such file"),
    "folder": (lambda d: d, "plain file"),
    "empty": (lambda d: written(d / "a.tif", b""), "empty"),
    "unknown": (lambda d: written(d / "a.tif", b"\x89PNG\r\n\x1a\n" + bytes(99)), "first bytes"),
    "vrt": (lambda d: written(d / "a.tif", VRT), "first bytes"),
    "vrt as hgt": (lambda d: written(d / "N44E005.hgt", VRT), "bytes"),
    "tiff cut": (
        lambda d: cut(geotiff(d / "a.tif", np.tile(HEIGHTS, (30, 30)), tiled=True, blockxsize=64, blockysize=64), 0.7),
        "",
    ),
    "tiff head only": (lambda d: written(d / "a.tif", b"II*\0\x08\0\0\0"), "GTiff"),
    "tiff lying": (lambda d: lying(d / "a.tif"), "60000"),
    "tiff sparse": (lambda d: sparse(d / "a.tif"), "block"),
    "tiff no crs": (lambda d: geotiff(d / "a.tif", crs=None), "georeference"),
    "tiff no position": (lambda d: geotiff(d / "a.tif", transform=Affine.identity()), "georeference"),
    "tiff rotated": (lambda d: geotiff(d / "a.tif", transform=Affine(0.001, 0.0002, 5, 0, -0.001, 45)), "rows"),
    "tiff mirrored": (lambda d: geotiff(d / "a.tif", transform=Affine(-0.001, 0, 5, 0, -0.001, 45)), "rows"),
    "tiff bands": (lambda d: geotiff(d / "a.tif", np.stack([HEIGHTS] * 3)), "3 bands"),
    "tiff pictures": (lambda d: geotiff(geotiff(d / "a.tif"), APPEND_SUBDATASET="YES"), "several pictures"),
    "tiff complex": (lambda d: geotiff(d / "a.tif", HEIGHTS.astype(np.complex64)), "complex64"),
    "tiff feet": (lambda d: geotiff(d / "a.tif", unit="ft"), "'ft'"),
    "tiff vertical feet": (lambda d: geotiff(d / "a.tif", crs="EPSG:4326+6360"), "US survey foot"),
    "tiff map in feet": (
        lambda d: geotiff(d / "a.tif", crs="EPSG:2229", transform=Affine(30, 0, 6e6, 0, -30, 2e6)),
        "foot",
    ),
    "tiff geocentric": (lambda d: geotiff(d / "a.tif", crs="EPSG:4978"), "reference system"),
    "tiff beyond pole": (lambda d: geotiff(d / "a.tif", transform=Affine(0.001, 0, 5, 0, -0.001, 95)), "95"),
    "tiff meters as degrees": (lambda d: geotiff(d / "a.tif", transform=Affine(30, 0, 376e3, 0, -30, 38e5)), "latitudes"),
    "tiff degrees as meters": (lambda d: geotiff(d / "a.tif", crs="EPSG:32611"), "look like degrees"),
    "tiff one row": (lambda d: geotiff(d / "a.tif", HEIGHTS[:1]), "1 rows"),
    "tiff 9999": (lambda d: geotiff(d / "a.tif", with_height(9999)), "nodata=9999"),
    "tiff -9999": (lambda d: geotiff(d / "a.tif", with_height(-9999)), "row 7, column 2"),
    "tiff -601": (lambda d: geotiff(d / "a.tif", with_height(-601, np.int16)), "-601"),
    "tiff infinite": (lambda d: geotiff(d / "a.tif", with_height(np.inf)), "inf"),
    "tiff all void": (lambda d: geotiff(d / "a.tif", np.full_like(HEIGHTS, -32768)), "voids only"),
    "dted flipped bit": (lambda d: patched(dted(d / "a.dt0"), 3428 + 254 * 5 + 101, b"\x7f"), "checksum"),
    "dted checksum": (lambda d: patched(dted(d / "a.dt0"), 3428 + 254 * 6 - 1, b"\xee"), "checksum"),
    "dted columns": (lambda d: patched(dted(d / "a.dt0"), 47, b"0242"), "columns"),
    "dted columns halved": (lambda d: patched(patched(dted(d / "a.dt0"), 47, b"0061"), 365, b"0061"), "bytes for 61"),
    "dted letters": (lambda d: patched(dted(d / "a.dt0"), 47, b"12x1"), "UHL columns"),
    "dted hemisphere": (lambda d: patched(dted(d / "a.dt0"), 19, b"S"), "DSI latitude"),
    "dted interval": (lambda d: patched(dted(d / "a.dt0"), 20, b"0030"), "longitude interval"),
    "dted datum": (lambda d: patched(dted(d / "a.dt0"), 224, b"NAD27"), "NAD27"),
    "dted datum rubbish": (lambda d: patched(dted(d / "a.dt0"), 228, b"\xc1"), "horizontal datum"),
    "dted latitude": (lambda d: patched(dted(d / "a.dt0"), 12, b"095"), "90 degrees"),
    "dted cut": (lambda d: cut(dted(d / "a.dt0"), 0.5), "bytes"),
    "dted head only": (lambda d: written(d / "a.dt0", b"UHL1"), "DSI"),
    "dted all void": (lambda d: dted(d / "a.dt0", np.full((121, 121), -32767)), "voids only"),
    "hgt size": (lambda d: hgt(d, cells=1200 * 1200), "2880000 bytes"),
    "hgt name": (lambda d: hgt(d, "tile.hgt"), "N44E005.hgt"),
    "hgt latitude": (lambda d: hgt(d, "N95E005.hgt"), "N95"),
    "hgt longitude": (lambda d: hgt(d, "N44E180.hgt"), "E180"),
    "hgt all void": (lambda d: written(d / "N44E005.hgt", b"\x80\0" * 1201 * 1201), "voids only"),
    "npz cut": (lambda d: cut(npz(d / "a.npz"), 0.6), "npz"),
    "npz other": (lambda d: npz(d / "a.npz", elevation=np.ones(4)), "matrix"),
    "npz upside down": (lambda d: npz(d / "a.npz", ymin=44.988, ymax=45.0), "ymin"),
    "npz objects": (lambda d: npz(d / "a.npz", elevation=np.array([[1, "a"], [None, 2]], object)), "object"),
    "npz scale": (lambda d: npz(d / "a.npz", dx=np.nan), "'dx'"),
    "npz pole": (lambda d: npz(d / "a.npz", ymin=95.0, ymax=94.988), "globe"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_bad_files_are_refused_in_one_line(case, tmp_path, capfd):
    make, word = REFUSED[case]
    path = make(tmp_path)
    with pytest.raises(FileError) as error:
        read_raster(path)
    refused(error, word, path.name)
    assert capfd.readouterr() == ("", "")


def test_npz_that_is_another_archive(tmp_path):
    with zipfile.ZipFile(tmp_path / "a.npz", "w") as archive:
        archive.writestr("readme.txt", "hello")
    with pytest.raises(FileError) as error:
        read_raster(tmp_path / "a.npz")
    refused(error, "elevation", "readme.txt", "a.npz")


def test_a_lying_npz_member_is_refused_before_memory_is_taken(tmp_path):
    head = b"{'descr': '<f8', 'fortran_order': False, 'shape': (90000, 90000), }".ljust(117) + b"\n"
    with zipfile.ZipFile(tmp_path / "a.npz", "w") as archive:
        archive.writestr("elevation.npy", b"\x93NUMPY\x01\x00" + struct.pack("<H", len(head)) + head)
    with pytest.raises(FileError) as error:
        read_raster(tmp_path / "a.npz")
    refused(error, "(90000, 90000)")


def test_largest_is_a_limit_on_heights(tmp_path):
    for path in (geotiff(tmp_path / "a.tif"), dted(tmp_path / "b.dt0"), npz(tmp_path / "c.npz"), hgt(tmp_path)):
        with pytest.raises(FileError) as error:
            read_raster(path, largest=107)
        refused(error, "107", path.name)


def test_long_and_strange_names_stay_on_one_line(tmp_path):
    path = written(tmp_path / ("x" * 180 + "\n\x1b[31m.tif"), b"junk")
    with pytest.raises(FileError) as error:
        read_raster(path)
    refused(error, ".tif", "first bytes")


# mutations -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "make",
    [
        lambda d: geotiff(d / "a.tif"),
        lambda d: geotiff(
            d / "b.tif", np.tile(HEIGHTS, (4, 4)), tiled=True, blockxsize=16, blockysize=16, compress="lzw"
        ),
        lambda d: dted(d / "c.dt0", np.ones((21, 21), int), interval=(1800, 1800)),
        lambda d: npz(d / "d.npz"),
    ],
    ids=["geotiff", "compressed geotiff", "dted", "npz"],
)
def test_mutated_files_are_read_or_refused(make, tmp_path):
    path = make(tmp_path)
    good = path.read_bytes()
    draw = np.random.default_rng(20)
    read_raster(path)
    for _ in range(200):
        data = np.frombuffer(good, np.uint8).copy()
        # headers matter most: every second change falls into the first bytes
        limit = len(data) if draw.random() < 0.5 else min(len(data), 800)
        data[draw.integers(limit, size=draw.integers(1, 5))] = draw.integers(256)
        path.write_bytes(data.tobytes()[: len(data) if draw.random() < 0.8 else int(draw.integers(1, len(data)))])
        with contextlib.suppress(FileError):
            assert np.isfinite(read_raster(path).heights).any()
