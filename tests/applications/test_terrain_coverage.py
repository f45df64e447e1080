"""Flights that leave their map, and whether terrain is rough enough to navigate by."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import motes as mo
from data import recorded
from motes.applications.terrain import scenario
from motes.applications.terrain.coverage import without_far_voids
from motes.applications.terrain.model import Track, error_model
from motes.applications.terrain.roughness import roughness
from motes.applications.terrain.settings import FIRST, MapFiles, Noises, Prior, Recording
from motes.io.rasters import jacksboro, mosaic, read_raster
from motes.models.terrain import TerrainMap, terrain_map

LEAVING = replace(FIRST, north=20_000.0, east=20_000.0, fixes=80, step=1.0)


@pytest.fixture(scope="module")
def terrain():
    return terrain_map(jacksboro())


@pytest.fixture(scope="module")
def leaving(terrain):
    return scenario.simulated(2, terrain, LEAVING, outside="missing")


def inside(terrain, track):
    height, width = terrain.size
    return np.asarray((track.north >= 0) & (track.north <= height) & (track.east >= 0) & (track.east <= width))


def test_fixes_off_the_map_are_missing(terrain, leaving):
    on = inside(terrain, leaving.inputs)
    assert 30 < on.sum() < 60
    np.testing.assert_array_equal(np.isnan(leaving.ys[:, 0]), ~on)
    with pytest.raises(mo.MotesError, match="outside"):
        scenario.simulated(2, terrain, LEAVING)
    above = leaving.inputs.altitude - leaving.errors[:, 2] - terrain.height(leaving.truth[:, 0], leaving.truth[:, 1])
    assert np.abs(np.asarray(leaving.ys[:, 0] - above)[on][:10]).max() < 5.2 * 15  # ten normal numbers, at a level of 2e-6


@pytest.mark.night
def test_particles_off_the_map_are_over_a_void(terrain, leaving):
    law, heights = leaving.model.sensor, np.asarray(terrain.heights)
    u = Track(*(jnp.float32(value) for value in (terrain.size[0] - 100.0, 15_000.0, 2000.0)))
    on, off = jnp.zeros(9), jnp.zeros(9).at[0].set(101.0)
    assert float(law.cov(on, u, 0)[0, 0]) == 225
    assert float(law.cov(off, u, 0)[0, 0]) == pytest.approx(225 + heights.var(), rel=1e-4)
    assert float(law.mean(off, u, 0)[0]) == pytest.approx(2000 - heights.mean(), rel=1e-4)
    history = mo.run(0, mo.MarginalizedParticleFilter(n=100), leaving.model, leaving.ys, leaving.inputs)
    assert np.isfinite(np.asarray(history.mean)).all() and not np.asarray(history.info.invalid).any()
    # beyond the map nothing is measured: the uncertainty grows to the end
    spread = np.sqrt(np.asarray(history.cov)[:, 0, 0])
    assert spread[-1] > spread[np.argmin(inside(terrain, leaving.inputs))]


def test_an_edge_out_of_reach_costs_nothing(terrain, leaving):
    whole = error_model(unbounded(terrain), step=LEAVING.step)
    near, far = (jax.tree.map(lambda leaf, at=at: jnp.full(80, at, leaf.dtype), leaving.inputs) for at in (2_000.0, 15_000.0))
    assert callable(without_far_voids(whole, near, 15.0).sensor.Q) and callable(whole.sensor.Q)
    assert not callable(without_far_voids(whole, far, 15.0).sensor.Q)
    assert leaving.model.sensor.f.terrain.beyond == leaving.terrain.beyond == "void"


def unbounded(terrain):
    return TerrainMap(terrain.heights, terrain.dn, terrain.de, beyond="void")


def test_recorded_flight_that_leaves_the_map(tmp_path, terrain, leaving):
    inputs = leaving.inputs
    height = inputs.altitude - float(np.nanmean(np.asarray(terrain.heights)))
    columns = np.stack([leaving.seconds, inputs.north, inputs.east, inputs.altitude, height], axis=1)
    np.savetxt(tmp_path / "flight.csv", columns, delimiter=",", header="time,ins_north,ins_east,ins_altitude,height", comments="")
    files = MapFiles(files=(str(scenario.jacksboro_file()),), outside="missing")
    loaded = scenario.loaded(files, Recording(file=str(tmp_path / "flight.csv")))
    np.testing.assert_array_equal(np.isnan(loaded.ys), np.isnan(leaving.ys))
    assert callable(loaded.model.sensor.Q)
    with pytest.raises(mo.MotesError, match="covers the inertial track in flight.csv"):
        scenario.loaded(replace(files, outside="refuse"), Recording(file=str(tmp_path / "flight.csv")))


# roughness -----------------------------------------------------------------------------------------------------------

STEP, FIXES = 0.6, 200


def track(north, east, heading, altitude=3000.0):
    along = np.arange(FIXES) * STEP * 250
    return Track(jnp.asarray(north + along * np.cos(np.radians(heading)), jnp.float32),
                 jnp.asarray(east + along * np.sin(np.radians(heading)), jnp.float32), jnp.full(FIXES, altitude))


def test_a_plane_leaves_nothing_unexplained():
    """On a plane the regression is the slope, whatever the covariance, so that the expected error is the bound."""
    north, east = np.mgrid[:70, :70] * 1000.0
    plane = TerrainMap(0.03 * north - 0.01 * east, 1000.0, 1000.0)
    found = roughness(error_model(plane, Noises(position=0.5), Prior(vertical_position=1.0), STEP), track(10_000, 10_000, 60))
    np.testing.assert_allclose(found.expected, found.bound, rtol=2e-3)
    assert found.slopes < 1e-4 and found.heights > 10 and found.flat == 0
    assert found.unaided[0] == pytest.approx(1000 * np.sqrt(2))
    # one direction is found, the other is not: the altimeter alone cannot tell where along the contour lines
    assert found.verdict == "poor" and 0.5 < found.expected[-1] / found.unaided[-1] < 0.9


def after_one_fix(terrain, north, east):
    """Horizontal error after the first fix by regression over the five points, prior 1000 m, 1000 m and 100 m, the long way round."""
    reach = np.sqrt(3) * 1000
    ground = np.asarray(terrain.height(north + np.array([0, reach, -reach, 0, 0]), east + np.array([0, 0, 0, reach, -reach])), float)
    slopes = np.array([ground[1] - ground[2], ground[3] - ground[4]]) / (2 * reach)
    variance = np.average((ground - np.average(ground, weights=[2, 1, 1, 1, 1])) ** 2, weights=[2, 1, 1, 1, 1])
    left = variance - 1e6 * (slopes**2).sum()
    P, H = np.diag([1e6, 1e6, 1e4]), np.array([*-slopes, -1.0])
    return np.sqrt(np.trace((P - np.outer(P @ H, P @ H) / (H @ P @ H + 225 + left))[:2, :2]))


def test_the_demonstration_is_rough_enough(terrain):
    model, flown = error_model(terrain, step=STEP), track(4000, 3000, 45, 1576.0)
    found = roughness(model, flown)
    smooth = error_model(terrain_map(jacksboro(), interpolation="cubic"), step=STEP)
    local = mo.bounds.kalman_at_truth(smooth, jnp.zeros((FIXES, 9)), flown).rmse(("rN", "rE"))
    np.testing.assert_allclose(found.bound, local, rtol=1e-5)
    assert found.expected[0] == pytest.approx(after_one_fix(terrain, 4000.0, 3000.0), rel=1e-4)
    assert found.verdict == "rough enough" and found.flat == 0 and 60 < found.heights < 120 and 0.15 < found.slopes < 0.3
    assert found.bound[-1] <= found.expected[-1] < 60 and (found.expected <= found.unaided * 1.001).all()
    line = str(found)
    assert line.isprintable() and line.startswith("Terrain: rough enough: heights vary by ") and f"about {found.expected[-1]:.0f} m" in line


def test_recorded_relief():
    """Santa Cruz mountains, Pacific, San Joaquin valley: what the data sheet says of them, in the words of a verdict."""
    tiles = [read_raster(recorded(f"terrain/dted/{side}/n36.dt1")) for side in ("w122", "w121")]
    model = error_model(terrain_map(mosaic(tiles)), Noises(position=0.5), step=STEP)
    rough, sea, valley = (roughness(model, track(*place)) for place in ((30e3, 75e3, 90), (60e3, 1e3, 5), (60e3, 160e3, 0)))
    assert rough.verdict == "rough enough" and rough.expected[-1] < 60 and rough.flat < 0.2
    for ground in (sea, valley):
        assert ground.verdict == "flat" and ground.flat > 0.6 and ground.heights < 5, str(ground)
        assert "next to nothing" in str(ground) and ground.expected[-1] > 0.5 * ground.unaided[-1]
    # in the valley the local bound is taken in by the meter steps of the map
    assert valley.bound[-1] < 250 and valley.slopes < 0.05


def test_voids_and_what_lies_beyond_tell_nothing(terrain):
    holed = np.array(terrain.heights)
    holed[100:, :] = np.nan
    model = error_model(TerrainMap(jnp.asarray(holed), terrain.dn, terrain.de, beyond="void"), step=STEP)
    found = roughness(model, track(12_000, 15_000, 0))
    assert found.verdict == "flat" and found.flat == 1 and found.heights == 0
