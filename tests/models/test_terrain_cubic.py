"""Cubic heights: posts, planes, continuous slopes, derivatives, voids, edges; and what lies beyond the edge."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from data import recorded, refused
from motes.core.checks import MotesError
from motes.core.record import replace
from motes.io.rasters import Raster, read_raster
from motes.models.terrain import TerrainMap, terrain_map

GRID = np.random.default_rng(4).normal(0, 30, (6, 5))


def cubic(grid=GRID, **options):
    return TerrainMap(jnp.asarray(grid), 10.0, 5.0, interpolation="cubic", **options)


def spline(values, s):
    """Catmull-Rom through four values, by Hermite's formula."""
    before, a, b, after = values
    m, n = (b - before) / 2, (after - a) / 2
    return (2 * s**3 - 3 * s**2 + 1) * a + (s**3 - 2 * s**2 + s) * m + (3 * s**2 - 2 * s**3) * b + (s**3 - s**2) * n


def reference(grid, north, east):
    """The long way round: the grid extended along straight lines, then splines along columns and across."""
    wide = np.pad(np.asarray(grid, float), 1, mode="reflect", reflect_type="odd")
    row, column = np.clip(north / 10, 0, grid.shape[0] - 1), np.clip(east / 5, 0, grid.shape[1] - 1)
    i, j = min(int(row), grid.shape[0] - 2), min(int(column), grid.shape[1] - 2)
    return spline([spline(wide[i + m, j : j + 4], column - j) for m in range(4)], row - i)


def test_against_the_long_way_round(precision):
    at = np.random.default_rng(0).uniform([[-8], [-4]], [[58], [24]], (2, 300))
    found = cubic().height(*at)
    assert found.dtype == precision
    expected = [reference(GRID, *place) for place in at.T]
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-4 if precision == "float32" else 1e-11)


def test_posts_and_planes(double):
    np.testing.assert_allclose(cubic().height(np.arange(6)[:, None] * 10.0, np.arange(5) * 5.0), GRID, atol=1e-12)
    north, east = np.mgrid[:4, :2]
    plane = cubic(100 + 3.0 * north - 2.0 * east)  # two columns only: both neighbors are beyond the edge
    at = np.random.default_rng(1).uniform(0, [[30], [5]], (2, 40))
    height, (to_north, to_east) = plane.height_and_gradient(*at)
    np.testing.assert_allclose(height, 100 + 0.3 * at[0] - 0.4 * at[1], rtol=1e-12)
    np.testing.assert_allclose(to_north, 0.3, rtol=1e-10)
    np.testing.assert_allclose(to_east, -0.4, rtol=1e-10)


def test_slopes_do_not_jump(double):
    """Across lines of posts the slope changes by what its own slope allows; bilinear slopes jump by tens of percent."""
    for line, terrain in ((20.0, cubic()), (20.0, replace(cubic(), interpolation="bilinear"))):
        before, after = (np.array(terrain.gradient(line + d, np.linspace(0.3, 19.7, 30))) for d in (-1e-7, 1e-7))
        jump = np.abs(after - before).max()
        assert jump < 1e-5 if terrain.interpolation == "cubic" else jump > 1


def test_derivatives(double):
    terrain = cubic()
    at = np.random.default_rng(2).uniform([[-5], [-3]], [[55], [23]], (2, 200))
    at = at[:, (np.abs(at / [[10], [5]] - np.round(at / [[10], [5]])) > 1e-3).all(axis=0)]
    slopes = np.array(terrain.gradient(*at))
    np.testing.assert_allclose(jax.vmap(jax.grad(terrain.height, (0, 1)))(*at), slopes, atol=1e-12)
    tangent = jax.jvp(terrain.height, tuple(at), (np.full(at.shape[1], 2.0), np.full(at.shape[1], -3.0)))[1]
    np.testing.assert_allclose(tangent, 2 * slopes[0] - 3 * slopes[1], atol=1e-10)
    h = 1e-5
    for axis in (0, 1):
        ahead, behind = (terrain.height(*(x + s * h * (k == axis) for k, x in enumerate(at))) for s in (1, -1))
        np.testing.assert_allclose((ahead - behind) / (2 * h), slopes[axis], atol=1e-6)
    weights = jax.grad(lambda grid: cubic(grid).height(23.0, 7.0))(jnp.asarray(GRID))
    np.testing.assert_allclose(jnp.sum(weights * GRID), terrain.height(23.0, 7.0), atol=1e-10)
    assert jnp.count_nonzero(weights) == 16


def test_voids_are_nan_only_where_they_are_needed():
    holed = GRID.copy()
    holed[3, 2] = np.nan
    terrain = cubic(holed)
    # each cell with the void among its 16 posts
    cells = np.array([[bool(np.isnan(terrain.height(10 * i + 4.0, 5 * j + 2.0))) for j in range(4)] for i in range(5)])
    assert cells.tolist() == [[False] * 4, [True] * 4, [True] * 4, [True] * 4, [True] * 4]
    assert float(terrain.height(20.0, 10.0)) == pytest.approx(GRID[2, 2], rel=1e-6)
    np.testing.assert_allclose(terrain.height(23.0, 20.0), reference(GRID, 23.0, 20.0), rtol=1e-4)


def test_beyond_the_edge():
    held, void = cubic(), cubic(beyond="void")
    assert float(held.height(-7.0, 5.0)) == pytest.approx(GRID[0, 1], rel=1e-6)
    assert [float(slope) for slope in held.gradient(80.0, 90.0)] == [0.0, 0.0]
    for terrain in (void, replace(void, interpolation="bilinear")):
        assert np.isnan(terrain.height(np.array([-0.1, 50.1, 5.0, 5.0]), np.array([5.0, 5.0, -0.1, 20.1]))).all()
        inside = (np.array([0.0, 50.0, 7.0]), np.array([0.0, 20.0, 3.0]))
        np.testing.assert_array_equal(terrain.height(*inside), replace(terrain, beyond="edge").height(*inside))
        assert np.isnan(terrain.height_and_gradient(-1.0, 5.0)[0])
        assert np.isfinite(jax.grad(terrain.height)(12.0, 5.0))


@pytest.mark.parametrize(("options", "words"), [
    ({"interpolation": "linear"}, ("interpolation", "'cubic'", "'linear'")),
    ({"beyond": "sea"}, ("beyond", "'void'", "'sea'")),
])
def test_other_words_are_refused(options, words):
    with pytest.raises(MotesError) as error:
        TerrainMap(GRID, 10.0, 5.0, **options)
    refused(error, *words)


def test_latitude_of_the_middle():
    tile = Raster(np.ones((3, 3), np.float32), 45.0, 5.0, 0.5, 0.5, "geographic", 4326, "test")
    assert terrain_map(tile, 45.0, "cubic").latitude == 44.5
    assert terrain_map(tile, 45.0, "cubic").interpolation == "cubic"
    assert Raster(np.ones((3, 3), np.float32), 4e6, 4e5, 30.0, 30.0, "projected", None, "test").latitude is None
    utm = read_raster(recorded("terrain/geotiff/srtm_bigtujunga30m_utm11.tif"))
    assert utm.latitude == pytest.approx(34.32, abs=0.01)
