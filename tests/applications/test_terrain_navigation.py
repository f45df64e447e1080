"""Terrain-aided navigation: signs, structure, voids, loading of flights, and one flight that finds its way."""

import csv
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import motes as mo
from data import refused
from motes.applications.terrain import scenario
from motes.applications.terrain.model import HeightAboveTerrain, Track, altimeter, error_model, process_cov, transition
from motes.applications.terrain.settings import FIRST, MapFiles, Noises, Prior, Recording
from motes.io.rasters import jacksboro
from motes.models.terrain import TerrainMap, terrain_map

GROUND = 300.0


@pytest.fixture(scope="module")
def terrain():
    return terrain_map(jacksboro())


@pytest.fixture(scope="module")
def flight(terrain):
    return scenario.simulated(3, terrain, replace(FIRST, fixes=120))


def flat(north=2, east=2):
    return TerrainMap(jnp.full((north, east), GROUND), 1e4, 1e4)


def step_of(inputs, step=0):
    return jax.tree.map(lambda leaf: leaf[step], inputs)


@pytest.mark.night
def test_signs_over_a_flat_map(double):
    """Over flat ground only the vertical channel is measured, and linearly: the marginalized filter must give the Kalman filter's law."""
    steps = 30
    model = error_model(flat(), Noises(), Prior(), 0.3)
    track = Track(jnp.full(steps, 5e3), jnp.full(steps, 5e3), jnp.full(steps, 1000.0))
    errors, ys = mo.simulate(5, model, steps, track)
    history = mo.run(0, mo.MarginalizedParticleFilter(n=20), model, ys, track)

    vertical = np.ix_([2, 5, 8], [2, 5, 8])
    A, Q = np.asarray(transition(0.3)), np.asarray(process_cov(0.3, 2.0, 0.02, 1e-4))
    initial = np.asarray(model.initial.cov())[vertical]
    linear = mo.StateSpaceModel(
        mo.Gaussian(jnp.zeros(3), initial), mo.LinearGaussian(A[vertical], Q[vertical]),
        mo.LinearGaussian([[-1.0, 0.0, 0.0]], [[225.0]]),
    )
    exact = mo.run(0, mo.KalmanFilter(), linear, ys - (1000.0 - GROUND))
    np.testing.assert_allclose(history.mean[:, [2, 5, 8]], exact.mean, rtol=1e-8, atol=1e-8)
    np.testing.assert_allclose(np.asarray(history.cov)[:, [[2], [5], [8]], [2, 5, 8]], exact.cov, rtol=1e-8, atol=1e-10)
    # true altitude = inertial altitude - rD
    np.testing.assert_allclose(np.mean(np.asarray(ys)[:, 0] - (1000.0 - np.asarray(errors)[:, 2] - GROUND)), 0, atol=15)


def test_signs_over_slopes():
    terrain = TerrainMap(jnp.array([[0.0, 200.0], [100.0, 300.0]]), 1000.0, 1000.0)
    track = Track(jnp.float32(500.0), jnp.float32(500.0), jnp.float32(1000.0))

    def reading(**errors):
        x = jnp.zeros(9).at[jnp.array([("rN", "rE", "rD").index(name) for name in errors])].set(jnp.array(list(errors.values())))
        return float(HeightAboveTerrain(terrain, 0.0)(x, track, 0)[0])

    assert reading(rN=0.0) == pytest.approx(850)
    assert reading(rN=100.0) == pytest.approx(840)
    assert reading(rE=100.0) == pytest.approx(830)
    assert reading(rD=100.0) == pytest.approx(750)


def test_all_but_the_horizontal_position_is_linear(terrain, flight):
    found = mo.structure(flight.model, step_of(flight.inputs))
    assert [flight.model.names[i] for i in range(9) if i not in found.linear] == ["rN", "rE"]
    assert found.covariance == "shared"
    uneven = error_model(terrain, step=None)
    inputs = Track(jnp.float32(0), jnp.float32(0), jnp.float32(0), jnp.float32(0.3))
    assert mo.structure(uneven, inputs).covariance == "time-varying"
    holed = error_model(with_void(terrain))
    assert mo.structure(holed, step_of(flight.inputs)).linear == found.linear
    assert mo.structure(holed, step_of(flight.inputs)).covariance == "per-particle"


def test_discretization(double):
    walks, step, count = (2.0, 0.02, 1e-4), 0.7, 2000
    total = np.zeros((9, 9))
    for middle in (np.arange(count) + 0.5) * step / count:
        A = np.asarray(transition(middle))
        total += A @ np.diag(np.repeat(np.square(walks), 3)) @ A.T * step / count
    np.testing.assert_allclose(process_cov(step, *walks), total, rtol=1e-5, atol=1e-16)
    np.testing.assert_allclose(transition(0.3) @ transition(0.4), transition(0.7), rtol=1e-12, atol=1e-12)


def test_second_fix_uses_the_seconds_since_the_first(terrain):
    even, uneven = error_model(terrain, step=0.3), error_model(terrain, step=None)
    u = Track(jnp.float32(0), jnp.float32(0), jnp.float32(0), jnp.float32(0.3))
    x = jnp.arange(9.0)
    np.testing.assert_allclose(even.dynamics.mean(x, u, 1), uneven.dynamics.mean(x, u, 1), rtol=1e-6)
    np.testing.assert_allclose(even.dynamics.cov(x, u, 1), uneven.dynamics.cov(x, u, 1), rtol=1e-6)


def with_void(terrain):
    heights = np.asarray(terrain.heights).copy()
    heights[60:90, 60:90] = np.nan
    return TerrainMap(jnp.asarray(heights), terrain.dn, terrain.de)


def test_voids_tell_nothing(terrain):
    holed = with_void(terrain)
    law = altimeter(holed, 15.0)
    above = Track(jnp.float32(75 * terrain.dn), jnp.float32(75 * terrain.de), jnp.float32(1500.0))
    known = Track(jnp.float32(20 * terrain.dn), jnp.float32(20 * terrain.de), jnp.float32(1500.0))
    heights = np.asarray(holed.heights)
    x = jnp.zeros(9)
    assert float(law.cov(x, known, 0)[0, 0]) == pytest.approx(225)
    assert float(law.cov(x, above, 0)[0, 0]) == pytest.approx(225 + np.nanvar(heights), rel=1e-4)
    assert float(law.mean(x, above, 0)[0]) == pytest.approx(1500 - np.nanmean(heights), rel=1e-4)
    assert not callable(altimeter(terrain, 15.0).Q)
    holed_flight = scenario.simulated(3, holed, replace(FIRST, fixes=40))
    history = mo.run(0, mo.MarginalizedParticleFilter(n=300), holed_flight.model, holed_flight.ys, holed_flight.inputs)
    assert np.isfinite(np.asarray(history.mean)).all() and not np.asarray(history.info.invalid).any()


@pytest.mark.night
def test_voids_out_of_reach_cost_nothing(terrain):
    heights = np.asarray(terrain.heights).copy()
    heights[300:310, 10:20] = np.nan
    far = TerrainMap(jnp.asarray(heights), terrain.dn, terrain.de)
    # a route in the south-east: the void lies in the north-west
    route = replace(FIRST, north=3000.0, east=22000.0, fixes=40)
    flown = scenario.simulated(0, far, route)
    assert mo.structure(flown.model, step_of(flown.inputs)).covariance == "shared"
    assert np.isnan(np.asarray(flown.terrain.heights)).any()
    near = scenario.simulated(0, far, replace(route, north=26000.0, east=3000.0, heading=0.0))
    assert mo.structure(near.model, step_of(near.inputs)).covariance == "per-particle"


def test_a_flight_finds_its_way(flight):
    history = mo.run(3, mo.MarginalizedParticleFilter(n=4000), flight.model, flight.ys, flight.inputs)
    found = scenario.score(history, flight)
    assert not found.lost and found.final < 100
    assert float(scenario.horizontal_errors((flight.inputs.north, flight.inputs.east), flight)[-1]) > 300


def test_routes_and_knobs_are_checked(terrain):
    for words, call in (
        (("map", "the flight", "outside"), lambda: scenario.simulated(0, terrain, replace(FIRST, fixes=600))),
        (("noises altimeter", "-1"), lambda: error_model(terrain, Noises(altimeter=-1.0))),
        (("prior vertical_velocity", "nan"), lambda: error_model(terrain, prior=Prior(vertical_velocity=float("nan")))),
        (("step", "0"), lambda: error_model(terrain, step=0.0)),
    ):
        with pytest.raises(mo.MotesError) as error:
            call()
        refused(error, *words)


COLUMNS = ("time", "ins_north", "ins_east", "ins_altitude", "height", "true_north", "true_east")


def write(folder, flight, times=None, rows=40, **changed):
    """Write a table of the flight's first fixes; `changed` replaces columns."""
    inputs = flight.inputs
    values = (flight.seconds, inputs.north, inputs.east, inputs.altitude, flight.ys[:, 0], flight.truth[:, 0], flight.truth[:, 1])
    columns = {name: np.asarray(value, np.float64)[:rows] for name, value in zip(COLUMNS, values, strict=True)} | changed
    if times is not None:
        columns["time"] = times
    path = folder / "flight.csv"
    with path.open("w", newline="") as file:
        rows_of = csv.writer(file)
        rows_of.writerow(columns)
        rows_of.writerows(zip(*columns.values(), strict=True))
    return Recording(file=str(path), truth=("true_north", "true_east"))


def files():
    return MapFiles(files=(str(scenario.jacksboro_file()),))


def test_loaded_flight_equals_the_simulated_one(tmp_path, flight):
    loaded = scenario.loaded(files(), write(tmp_path, flight))
    np.testing.assert_allclose(loaded.ys, flight.ys[:40], rtol=1e-6)
    np.testing.assert_allclose(loaded.model.dynamics.A, flight.model.dynamics.A, rtol=1e-5)
    one = mo.run(0, mo.MarginalizedParticleFilter(n=50), loaded.model, loaded.ys, loaded.inputs)
    two = mo.run(0, mo.MarginalizedParticleFilter(n=50), flight.model, flight.ys[:40], jax.tree.map(lambda a: a[:40], flight.inputs))
    np.testing.assert_allclose(one.mean[5], two.mean[5], rtol=1e-2, atol=1)


def test_geographic_columns_and_uneven_times(tmp_path, flight, terrain):
    north, east = terrain.to_geographic(flight.inputs.north[:40], flight.inputs.east[:40])
    times = np.arange(40) * 0.3 + np.where(np.arange(40) > 20, 3.0, 0.0)
    recording = write(tmp_path, flight, times, ins_north=north, ins_east=east)
    loaded = scenario.loaded(files(), replace(recording, coordinates="map", truth=()))
    np.testing.assert_allclose(loaded.inputs.north, flight.inputs.north[:40], atol=0.01)
    assert float(loaded.inputs.since[21]) == pytest.approx(3.3, rel=1e-5) and loaded.truth is None
    history = mo.run(0, mo.MarginalizedParticleFilter(n=50), loaded.model, loaded.ys, loaded.inputs)
    assert scenario.score(history, loaded) is None and np.isfinite(np.asarray(history.mean)).all()


def test_bad_recordings_are_refused(tmp_path, flight):
    good = write(tmp_path, flight)
    holes = np.asarray(flight.inputs.north)[:40].astype(object)
    holes[7] = ""
    latitude, longitude = terrain_map(jacksboro()).to_geographic(flight.inputs.north[:40], flight.inputs.east[:40])
    swapped = {"ins_north": longitude, "ins_east": latitude}
    degrees = {"ins_north": latitude, "ins_east": longitude}
    cases = [
        (("map", "latitude and longitude look swapped".capitalize(), "exchange 'ins_north' and 'ins_east'", "row 1"),
         lambda: scenario.loaded(files(), replace(write(tmp_path, flight, **swapped), coordinates="map"))),
        (("map", "map's own coordinates", 'set coordinates = "map"'), lambda: scenario.loaded(files(), write(tmp_path, flight, **degrees))),
        (("map", "meters from its south-west", 'set coordinates = "local"'),
         lambda: scenario.loaded(files(), replace(write(tmp_path, flight), coordinates="map"))),
        (("map", "coordinates are degrees", "join more"),
         lambda: scenario.loaded(files(), replace(write(tmp_path, flight, ins_north=np.full(40, 4e6), ins_east=np.full(40, 7e5)),
                                                coordinates="map"))),
        (("map outside", "'missing'", "'ignore'"), lambda: scenario.loaded(replace(files(), outside="ignore"), write(tmp_path, flight))),
        (("map", "covers", "row 1"), lambda: scenario.loaded(replace(files(), outside="missing"),
                                                           write(tmp_path, flight, ins_east=np.full(40, 9e4)))),
        (("map", "covers", "row 1"), lambda: scenario.loaded(files(), write(tmp_path, flight, ins_east=np.full(40, 9e4)))),
        (("'ins_north'", "row 8"), lambda: scenario.loaded(files(), write(tmp_path, flight, ins_north=holes))),
        (("times", "row 40"), lambda: scenario.loaded(files(), write(tmp_path, flight, [*range(39), 5]))),
        (("'radar'", "height"), lambda: scenario.loaded(files(), replace(good, height="radar"))),
        (("coordinates", "'utm'"), lambda: scenario.loaded(files(), replace(good, coordinates="utm"))),
        (("inertial", "three"), lambda: scenario.loaded(files(), replace(good, inertial=("a",)))),
        (("truth", "two"), lambda: scenario.loaded(files(), replace(good, truth=("a",)))),
        (("data file",), lambda: scenario.loaded(files(), Recording())),
        (("data step",), lambda: scenario.loaded(files(), replace(good, time="", step=-1.0))),
        (("map files",), lambda: scenario.loaded(MapFiles(), good)),
    ]
    for words, call in cases:
        with pytest.raises(mo.MotesError) as error:
            call()
        refused(error, *words)
