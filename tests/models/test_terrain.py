import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from data import recorded, refused
from motes.core.checks import MotesError
from motes.io.rasters import Raster, jacksboro, mosaic, read_raster
from motes.models.terrain import TerrainMap, terrain_map

# row 0 is south; 10 m between rows, 5 m between columns
GRID = np.array([[0.0, 1.0, 4.0], [10.0, 13.0, 11.0], [30.0, 20.0, 25.0], [7.0, 8.0, 9.0]])
MAP = TerrainMap(GRID, 10.0, 5.0)


def plane(rows=6, columns=5, dn=20.0, de=30.0):
    north, east = np.mgrid[:rows, :columns]
    return TerrainMap(100 + 0.5 * north * dn - 0.25 * east * de, dn, de)


def geographic(heights, north, west, dy, dx):
    return Raster(np.asarray(heights, np.float32), north, west, dy, dx, "geographic", 4326, "test")


def reference(heights, north, east, dn, de):
    """Bilinear height, the long way round."""
    row, column = np.clip(north / dn, 0, heights.shape[0] - 1), np.clip(east / de, 0, heights.shape[1] - 1)
    i, j = min(int(row), heights.shape[0] - 2), min(int(column), heights.shape[1] - 2)
    south = np.interp(column, [j, j + 1], heights[i, j : j + 2])
    return np.interp(row, [i, i + 1], [south, np.interp(column, [j, j + 1], heights[i + 1, j : j + 2])])


def test_posts_and_middles():
    np.testing.assert_allclose(MAP.height(np.arange(4)[:, None] * 10.0, np.arange(3) * 5.0), GRID)
    assert MAP.height(5.0, 2.5) == pytest.approx((0 + 1 + 10 + 13) / 4)
    assert MAP.height(25.0, 7.5) == pytest.approx((20 + 25 + 8 + 9) / 4)


@settings(max_examples=60, deadline=None)
@given(st.floats(-20, 50), st.floats(-20, 30))
def test_heights_agree_with_the_long_way_round(north, east):
    assert float(MAP.height(north, east)) == pytest.approx(reference(GRID, north, east, 10.0, 5.0), abs=2e-5)


def test_a_plane_has_its_slopes_everywhere():
    terrain = plane()
    north, east = np.random.default_rng(0).uniform(0, [[100], [120]], (2, 50))
    height, (to_north, to_east) = terrain.height_and_gradient(north, east)
    np.testing.assert_allclose(height, 100 + 0.5 * north - 0.25 * east, rtol=1e-5)
    np.testing.assert_allclose(to_north, 0.5, rtol=1e-4)
    np.testing.assert_allclose(to_east, -0.25, rtol=1e-4)


@pytest.mark.parametrize("bits", [32, 64])
def test_both_precisions(bits):
    with jax.enable_x64(bits == 64):
        terrain = TerrainMap(GRID.astype(f"float{bits}"), 10.0, 5.0)
        north, east = jnp.linspace(-5.0, 35.0, 41), jnp.linspace(-3.0, 13.0, 41)
        height, slopes = jax.jit(lambda m, n, e: m.height_and_gradient(n, e))(terrain, north, east)
        assert height.dtype == slopes[0].dtype == slopes[1].dtype == f"float{bits}"
        exact = [reference(GRID, n, e, 10.0, 5.0) for n, e in zip(np.asarray(north), np.asarray(east), strict=True)]
        np.testing.assert_allclose(height, exact, rtol=0, atol=1e-5 if bits == 32 else 1e-12)


@pytest.mark.parametrize("shapes", [((), ()), ((7,), ()), ((3, 7), (7,)), ((2, 1), (1, 4))])
def test_shapes_broadcast(shapes):
    north, east = (np.full(shape, 4.0) for shape in shapes)
    shape = np.broadcast_shapes(*shapes)
    assert MAP.height(north, east).shape == shape == MAP.inside(north, east).shape
    assert all(slope.shape == shape for slope in MAP.gradient(north, east))


def test_derivatives_equal_the_gradient():
    north, east = np.random.default_rng(1).uniform([[-10], [-5]], [[40], [15]], (2, 64)).astype(np.float32)
    to_north, to_east = MAP.gradient(north, east)
    reverse = jax.vmap(jax.grad(MAP.height, (0, 1)))(north, east)
    np.testing.assert_allclose(reverse, (to_north, to_east), rtol=1e-6)
    forward = jax.jvp(MAP.height, (north, east), (np.full(64, 2.0, np.float32), np.full(64, -3.0, np.float32)))[1]
    np.testing.assert_allclose(forward, 2 * to_north - 3 * to_east, rtol=1e-5, atol=1e-5)
    with jax.enable_x64(True):
        terrain, step = TerrainMap(GRID, 10.0, 5.0), 1e-6
        for at in ((3.0, 2.0), (17.0, 9.0), (29.0, 0.5), (45.0, 3.0), (5.0, -4.0)):
            for axis, slope in enumerate(terrain.gradient(*at)):
                ahead, behind = (tuple(x + s * step * (k == axis) for k, x in enumerate(at)) for s in (1, -1))
                difference = (terrain.height(*ahead) - terrain.height(*behind)) / (2 * step)
                assert float(difference) == pytest.approx(float(slope), abs=1e-7)


def test_slopes_on_the_lines_are_those_of_the_cell_ahead():
    for derivative in (MAP.gradient(10.0, 5.0), jax.grad(MAP.height, (0, 1))(10.0, 5.0)):
        assert [float(d) for d in derivative] == pytest.approx([(20 - 13) / 10, (11 - 13) / 5])
    # the outermost posts belong to the map: slopes of the last cell
    for derivative in (MAP.gradient(30.0, 10.0), jax.grad(MAP.height, (0, 1))(30.0, 10.0)):
        assert [float(d) for d in derivative] == pytest.approx([(9 - 25) / 10, (9 - 8) / 5])


def test_second_derivative_is_the_twist_of_the_cell():
    hessian = jax.hessian(lambda p: MAP.height(p[0], p[1]))(jnp.array([4.0, 2.0]))
    twist = (13 - 10 - 1 + 0) / (10 * 5)
    np.testing.assert_allclose(hessian, [[0, twist], [twist, 0]], atol=1e-6)


def test_derivative_for_the_heights_is_the_weights():
    weights = jax.grad(lambda h: TerrainMap(h, 10.0, 5.0).height(2.5, 6.0))(jnp.asarray(GRID))
    expected = np.zeros((4, 3))
    expected[:2, 1:] = np.outer([0.75, 0.25], [0.8, 0.2])
    np.testing.assert_allclose(weights, expected, rtol=1e-5)


def test_look_ups_beyond_the_edge_take_the_edge():
    assert float(MAP.height(-100.0, 2.5)) == pytest.approx(0.5)
    assert float(MAP.height(100.0, 1e9)) == 9.0
    assert [float(s) for s in MAP.gradient(-1.0, 2.5)] == pytest.approx([0.0, 0.2])
    assert [float(s) for s in MAP.gradient(100.0, 1e9)] == [0.0, 0.0]
    inside = MAP.inside(np.array([0.0, 30.0, -0.1, 30.1, 5.0, 5.0, np.nan]), np.array([0.0, 10.0, 5, 5, -0.1, 10.1, 1]))
    assert inside.tolist() == [True, True, False, False, False, False, False]
    assert [float(v) for v in MAP.size] == [30.0, 10.0]


def test_voids_are_nan_only_where_they_are_needed():
    holed = GRID.copy()
    holed[1, 1] = np.nan
    terrain = TerrainMap(holed, 10.0, 5.0)
    # cells around the void
    assert np.isnan(terrain.height(np.array([5.0, 10.0, 15.0, 10.0]), np.array([2.5, 5.0, 7.5, 2.5]))).all()
    # posts and lines of measured posts beside it, and a cell further away
    np.testing.assert_allclose(
        terrain.height(np.array([0.0, 20.0, 10.0, 0.0]), np.array([5.0, 5.0, 0.0, 2.5])), [1, 20, 10, 0.5]
    )
    assert float(terrain.height(25.0, 2.5)) == pytest.approx((30 + 20 + 7 + 8) / 4)
    # on such a line the slope along it is known and the slope across it is not
    for across, along in (terrain.gradient(0.0, 2.5), jax.grad(terrain.height, (0, 1))(0.0, 2.5)):
        assert np.isnan(across) and float(along) == pytest.approx(0.2)


def test_positions_that_are_nan_stay_nan():
    height, slopes = MAP.height_and_gradient(np.array([np.nan, 1.0]), np.array([1.0, np.nan]))
    assert np.isnan(height).all() and np.isfinite(MAP.height(1.0, 1.0)) and slopes[0].shape == (2,)


def test_maps_travel_through_jit_and_vmap():
    traces = []

    @jax.jit
    def look(terrain, north, east):
        traces.append(1)
        return terrain.height(north, east)

    for lift in (0.0, 5.0):
        assert float(look(TerrainMap(GRID + lift, 10.0, 5.0), 10.0, 5.0)) == 13.0 + lift
    assert len(traces) == 1
    stack = jax.tree.map(
        lambda *leaves: jnp.stack([jnp.asarray(leaf) for leaf in leaves]), MAP, TerrainMap(GRID * 2, 20.0, 10.0)
    )
    np.testing.assert_allclose(
        jax.vmap(lambda m: m.height(10.0, 5.0))(stack), [13.0, 2 * reference(GRID, 5.0, 2.5, 10.0, 5.0)]
    )


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        ((np.ones(4), 1.0, 1.0), "heights"),
        ((np.ones((1, 4)), 1.0, 1.0), "heights"),
        ((GRID, 0.0, 1.0), "dn"),
        ((GRID, 1.0, np.nan), "de"),
        ((GRID, 1.0, -1.0), "de"),
        ((np.full((2, 2), "a"), 1.0, 1.0), "heights"),
    ],
)
def test_bad_maps_are_refused(arguments, word):
    with pytest.raises(MotesError) as error:
        TerrainMap(*arguments)
    refused(error, word)


# from rasters --------------------------------------------------------------------------------------------------------


def test_north_is_up_and_east_is_right():
    terrain = terrain_map(geographic([[1, 2, 3], [4, 5, 6]], 10.0, 20.0, 0.5, 0.25))
    np.testing.assert_array_equal(terrain.heights, [[4, 5, 6], [1, 2, 3]])
    assert terrain.origin == (9.5, 20.0)
    assert float(terrain.height(0.0, 0.0)) == 4 and float(terrain.height(*terrain.size)) == 3
    north, east = terrain.to_local([9.5, 10.0], [20.0, 20.25])
    np.testing.assert_allclose((north[1], east[1]), (float(terrain.dn), float(terrain.de)))
    np.testing.assert_allclose(terrain.height(north, east), [4, 2])
    np.testing.assert_allclose(terrain.to_geographic(north, east), ([9.5, 10.0], [20.0, 20.25]), rtol=0, atol=1e-12)


def test_jacksboro_agrees_with_the_convention_of_the_scenarios():
    raster = jacksboro()
    terrain = terrain_map(raster)
    mean = math.radians((raster.north + raster.south) / 2)
    assert terrain.dn == pytest.approx(raster.dy * 111132.954, rel=5e-3)
    assert terrain.de == pytest.approx(raster.dx * 111319.49 * math.cos(mean), rel=5e-3)
    assert terrain.heights.shape == (344, 403)
    # (4000 m, 3000 m) from the south-west corner lies at row 43, column 40 from there
    around = raster.heights[::-1][43:45, 40:42]
    assert around.min() <= float(terrain.height(4000.0, 3000.0)) <= around.max()


def test_another_latitude_for_the_lengths():
    raster = geographic(np.ones((3, 3)), 45.0, 5.0, 0.5, 0.5)
    assert terrain_map(raster, 45.0).scale == pytest.approx((111131.8, 78846.8), abs=0.1)
    assert terrain_map(raster).scale[1] > terrain_map(raster, 45.0).scale[1]


def test_projected_maps_keep_their_meters():
    raster = Raster(np.ones((3, 4), np.float32), 3_800_100.0, 376_000.0, 30.0, 20.0, "projected", 32611, "utm")
    terrain = terrain_map(raster)
    assert (terrain.dn, terrain.de, terrain.origin) == (30.0, 20.0, (3_800_040.0, 376_000.0))
    assert [float(x) for x in terrain.to_local(3_800_040.5, 376_010.0)] == [0.5, 10.0]


def test_heights_do_not_jump_at_the_seam_of_recorded_tiles():
    west, east = (read_raster(recorded(f"terrain/dted/{side}/n36.dt1")) for side in ("w122", "w121"))
    whole = terrain_map(mosaic([west, east]), 36.5)
    alone = terrain_map(west, 36.5)
    north = np.random.default_rng(2).uniform(0, 110e3, 400)
    at = 1200 * float(whole.de)
    np.testing.assert_allclose(whole.height(north, at - 30.0), alone.height(north, at - 30.0), atol=0.5)
    step = np.abs(np.asarray(whole.height(north, at + 1.0) - whole.height(north, at - 1.0)))
    assert np.nanmax(step) < 2.5
