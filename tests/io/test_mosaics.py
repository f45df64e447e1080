import numpy as np
import pytest

from data import recorded, refused
from motes.core.checks import FileError
from motes.io.rasters import Raster, mosaic, read_raster


def raster(heights, north, west, **changes):
    fields = {"dy": 0.5, "dx": 0.25, "crs": "geographic", "epsg": 4326, "source": "tile"}
    return Raster(np.asarray(heights, np.float32), north, west, **{**fields, **changes})


def test_recorded_neighbors_join_without_a_seam():
    west, east = (read_raster(recorded(f"terrain/dted/{side}/n36.dt1")) for side in ("w122", "w121"))
    for pair in ((west, east), (east, west)):
        whole = mosaic(pair)
        assert whole.heights.shape == (1201, 2401) and whole.extent == pytest.approx((36, -122, 37, -120))
        np.testing.assert_array_equal(whole.heights[:, :1200], west.heights[:, :1200])
        np.testing.assert_array_equal(whole.heights[:, 1201:], east.heights[:, 1:])
        shared = whole.heights[:, 1200]
        np.testing.assert_array_equal(np.isnan(shared), np.isnan(west.heights[:, -1]) & np.isnan(east.heights[:, 0]))


def test_measured_values_win_over_voids_on_shared_posts():
    west = raster([[1, np.nan], [3, 4]], 10.0, 0.0)
    east = raster([[20, 5], [40, 6]], 10.0, 0.25, source="east")
    np.testing.assert_array_equal(mosaic([west, east]).heights, [[1, 20, 5], [3, 4, 6]])
    np.testing.assert_array_equal(mosaic([east, west]).heights, [[1, 20, 5], [3, 40, 6]])


def test_abutting_tiles_and_gaps():
    north_west, south_east = raster([[1, 2], [3, 4]], 10.0, 0.0), raster([[5, 6], [7, 8]], 9.0, 0.5)
    whole = mosaic([south_east, north_west])
    nan = np.nan
    np.testing.assert_array_equal(
        whole.heights, [[1, 2, nan, nan], [3, 4, nan, nan], [nan, nan, 5, 6], [nan, nan, 7, 8]]
    )
    assert whole.extent == (8.5, 0.0, 10.0, 0.75)


@pytest.mark.parametrize(
    ("other", "word"),
    [
        ({"dx": 0.5}, "spacing"),
        ({"dy": 0.51}, "spacing"),
        ({"west": 0.6}, "lattice"),
        ({"north": 10.2}, "lattice"),
        ({"crs": "projected", "epsg": 32611}, "EPSG 32611"),
        ({"epsg": 4269}, "4269"),
        ({"west": 1e9}, "at most"),
    ],
)
def test_tiles_that_do_not_fit_are_refused(other, word):
    first = raster(np.ones((2, 2)), 10.0, 0.0)
    with pytest.raises(FileError) as error:
        mosaic([first, raster(np.ones((2, 2)), **{"north": 10.0, "west": 0.5, "source": "n36.dt1", **other})])
    refused(error, word, "n36.dt1")


def test_nothing_to_join_is_refused():
    with pytest.raises(FileError) as error:
        mosaic([])
    refused(error, "rasters")
    unnamed = raster(np.ones((2, 2)), 0.0, 0.0, crs="projected", epsg=None)
    with pytest.raises(FileError) as error:
        mosaic([unnamed, raster(np.ones((2, 2)), 0.0, 0.5, crs="projected", epsg=None, source="b.tif")])
    refused(error, "b.tif", "EPSG")
