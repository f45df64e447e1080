"""Maps that look right and are not are refused with what is wrong, or told; well-formed ones are read, in meters on the ground."""

import struct
import sys
import warnings
import zipfile
from pathlib import Path

import numpy as np
import pytest
from told import refusal

from data import recorded
from motes.core.checks import MotesWarning

sys.path.insert(0, str(Path(__file__).parents[1] / "io"))
from raster_files import HEIGHTS, Affine, dted, geotiff, hgt, rasterio  # noqa: E402

from motes.io.rasters import read_raster  # noqa: E402

FIRST, RECORD = 80 + 648 + 2700, 12 + 2 * 121
"""Where the columns of the small DTED file begin, and the bytes of one."""


# maps: meters on the ground ------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("epsg", "east", "north"), [
    (3857, 1_100_000, 8_399_737), (3857, -13_000_000, 4_500_000), (3395, 400_000, 5_000_000),
    (32611, 400_000, 3_800_000), (25832, 5e5, 6e6),
])
def test_posts_are_as_far_apart_as_on_the_ground(tmp_path, epsg, east, north):
    pyproj = pytest.importorskip("pyproj")
    tile = read_raster(geotiff(tmp_path / "a.tif", crs=f"EPSG:{epsg}", transform=Affine(30, 0, east, 0, -30, north)))
    turn = pyproj.Transformer.from_crs(epsg, 4326, always_xy=True)
    rows, columns = tile.heights.shape
    middle = (tile.west + columns // 2 * tile.dx, tile.north - rows // 2 * tile.dy)
    geod, here = pyproj.Geod(ellps="WGS84"), turn.transform(*middle)
    north_m = geod.inv(*here, *turn.transform(middle[0], middle[1] + tile.dy))[2]
    east_m = geod.inv(*here, *turn.transform(middle[0] + tile.dx, middle[1]))[2]
    assert tile.spacing_m() == pytest.approx((north_m, east_m), rel=1.1e-3)
    if epsg == 3857 and north > 8e6:  # the scale taken for 1, as it once was, is far outside
        assert (tile.dy, tile.dx) != pytest.approx((north_m, east_m), rel=0.5)


def test_a_map_frame_of_web_mercator_has_meters_of_the_ground(tmp_path):
    from motes.models.terrain import terrain_map

    terrain = terrain_map(read_raster(geotiff(tmp_path / "a.tif", crs="EPSG:3857", transform=Affine(30, 0, 1.1e6, 0, -30, 8_399_737))))
    north, east = terrain.to_local(terrain.origin[0] + 300, terrain.origin[1] + 300)
    assert (float(north), float(east)) == pytest.approx((150, 150), rel=5e-3)
    assert [float(part) for part in terrain.to_geographic(north, east)] == pytest.approx([part + 300 for part in terrain.origin])


@pytest.mark.parametrize(("crs", "step", "word"), [
    ("EPSG:3857", 30_000, "varies"), ("+proj=merc +lat_ts=45 +datum=WGS84", 30, "EPSG number"), ("ESRI:54009", 30, "EPSG number"),
])
def test_projections_whose_meters_cannot_be_told_are_refused(tmp_path, crs, step, word):
    path = geotiff(tmp_path / "a.tif", np.tile(HEIGHTS, (4, 5)), crs=crs, transform=Affine(step, 0, 400_000, 0, -step, 5_000_000))
    refusal(lambda: read_raster(path), "a.tif", word)


@pytest.mark.parametrize(("epsg", "datum"), [(4267, "North American Datum 1927"), (27700, "Ordnance Survey of Great Britain 1936"),
                                             (4326, None), (4269, None), (4258, None), (32611, None)])
def test_other_datums_are_told(tmp_path, epsg, datum):
    step, corner = (0.001, (-100, 40)) if 4000 < epsg < 5000 else (30, (4e5, 4e5))
    path = geotiff(tmp_path / "a.tif", crs=f"EPSG:{epsg}", transform=Affine(step, 0, corner[0], 0, -step, corner[1]))
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        read_raster(path)
    told = [str(one.message) for one in said if issubclass(one.category, MotesWarning)]
    assert len(told) == (datum is not None) and all(datum in text and "a.tif" in text for text in told)


@pytest.mark.parametrize(("scale", "offset"), [(0.1, 0.0), (1.0, -100.0), (0.5, 12.25)])
def test_scale_and_offset_are_applied_and_voids_stay_voids(tmp_path, scale, offset):
    heights = HEIGHTS.copy()
    heights[0, :2] = -32768, -1
    path = geotiff(tmp_path / "a.tif", heights, nodata=-1)
    with rasterio.open(path, "r+") as file:
        file.scales, file.offsets = (scale,), (offset,)
    expected = HEIGHTS * scale + offset
    expected[0, :2] = np.nan
    np.testing.assert_allclose(read_raster(path).heights, expected, rtol=1e-6)
    with rasterio.open(path, "r+") as file:
        file.scales = (np.nan,)
    refusal(lambda: read_raster(path), "a.tif", "scale")


# DTED and HGT --------------------------------------------------------------------------------------------------------


def column(data, number):
    return slice(FIRST + number * RECORD, FIRST + (number + 1) * RECORD)


def swapped(data):
    one, other = data[column(data, 20)], data[column(data, 40)]
    data[column(data, 20)], data[column(data, 40)] = other, one


def doubled(data):
    data[column(data, 41)] = data[column(data, 40)]


def without_sentinel(data):
    record = data[column(data, 7)]
    record[0] = 0
    record[-4:] = struct.pack(">I", sum(record[:-4]))
    data[column(data, 7)] = record


def write_posts(path, row, columns, word):
    """Put two bytes at posts and make the checksums fit."""
    data = bytearray(path.read_bytes())
    for place in columns:
        record = data[column(data, place)]
        record[8 + 2 * row : 10 + 2 * row] = word
        record[-4:] = struct.pack(">I", sum(record[:-4]))
        data[column(data, place)] = record
    path.write_bytes(data)


@pytest.mark.parametrize(("spoil", "words"), [
    (swapped, ("column 21", "meridian 20", "40")), (doubled, ("column 42", "meridian 41", "40")), (without_sentinel, ("column 8", "0xaa"))])
def test_columns_of_dted_must_be_those_they_say_they_are(tmp_path, spoil, words):
    path = dted(tmp_path / "a.dt0")
    data = bytearray(path.read_bytes())
    spoil(data)
    path.write_bytes(data)
    with rasterio.open(path, driver="DTED") as file:  # the usual reader takes it
        assert file.read(1).shape == (121, 121)
    refusal(lambda: read_raster(path), "a.dt0", *words)


@pytest.mark.parametrize("low", [-2, -30, -430, -600])
def test_heights_in_twos_complement_are_refused(tmp_path, low):
    heights = np.full((121, 121), 5)
    heights[30, 40:44] = low
    good = read_raster(dted(tmp_path / "a.dt0", heights))
    assert np.nanmin(good.heights) == low
    path = dted(tmp_path / "b.dt0", heights)
    write_posts(path, 30, range(40, 44), struct.pack(">h", low))
    refusal(lambda: read_raster(path), "b.dt0", "two's complement", "column 41, row 31")


def test_minus_zero_is_a_void(tmp_path):
    path = dted(tmp_path / "a.dt0", np.full((121, 121), 700))
    write_posts(path, 30, [40], b"\x80\0")
    tile = read_raster(path)
    assert np.isnan(tile.heights[120 - 30, 40]) and np.isnan(tile.heights).sum() == 1


@pytest.mark.parametrize("inside", ["N44E005.hgt", "folder/N44E005.hgt"])
def test_zipped_hgt_is_read(tmp_path, inside):
    plain = read_raster(hgt(tmp_path))
    with zipfile.ZipFile(tmp_path / "tile.zip", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("readme.txt", "SRTM")
        archive.writestr(inside, (tmp_path / "N44E005.hgt").read_bytes())
    packed = read_raster(tmp_path / "tile.zip")
    np.testing.assert_array_equal(packed.heights, plain.heights)
    assert packed.extent == plain.extent == pytest.approx((44, 5, 45, 6))


@pytest.mark.parametrize(("members", "words"), [
    ({"N44E005.hgt": bytes(10)}, ("10 bytes",)), ({"tile.hgt": bytes(2884802)}, ("N44E005.hgt", "tile.hgt")),
    ({"N44E005.hgt": b"", "N44E006.hgt": b""}, ("one HGT tile", "2"))])
def test_zipped_hgt_that_is_none_is_refused(tmp_path, members, words):
    with zipfile.ZipFile(tmp_path / "tile.zip", "w") as archive:
        for name, data in members.items():
            archive.writestr(name, data)
    refusal(lambda: read_raster(tmp_path / "tile.zip"), "tile.zip", *words)


@pytest.mark.parametrize("name", ["dted/w122/n36.dt1", "dted/e000_n05.dt0", "hgt/N44E005.hgt", "geotiff/srtm_bigtujunga30m_utm11.tif"])
def test_recorded_maps_are_taken_without_a_word(name):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        read_raster(recorded(f"terrain/{name}"))
