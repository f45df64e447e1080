"""Fifteen inertial error states over a map: growth against the mechanization, prior and units, the altimeter, a flight kept on track."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import motes as mo
from data import refused
from motes.applications.terrain import scenario
from motes.applications.terrain.cruise import Cruise, cruise_of, dynamics
from motes.applications.terrain.model import Track, corrected, error_model, unaided
from motes.applications.terrain.settings import Inertial, Noises, Prior, Route
from motes.models import inertial, mechanization
from motes.models.terrain import TerrainMap

FIFTEEN = Inertial(states=15)
LINEAR = tuple(name for name in inertial.NAMES if name not in ("rN", "rE"))
RELIEF = np.random.default_rng(0).normal(300, 40, (60, 70))
TERRAIN = TerrainMap(RELIEF, 90.0, 75.0, latitude=36.5)
CRUISE = Cruise(np.radians(36.5), 1500.0, 170.0, 180.0)


@pytest.fixture(scope="module")
def flight():
    return scenario.simulated(4, route=Route(fixes=120), noises=Noises(position=2.0), kind=FIFTEEN)


def test_prior_as_printed():
    model = error_model(TERRAIN, kind=FIFTEEN, cruise=CRUISE)
    assert model.names == inertial.NAMES
    spread = dict(zip(model.names, np.sqrt(np.diag(model.initial.cov())), strict=True))
    expected = {"psi_N": np.radians(0.5), "vN": 5, "vE": 5, "vD": 1, "rN": 1000, "rE": 1000, "rD": 100, "accel_x": 0.01,
                "gyro_z": 0.06 * np.pi / 180 / 3600}
    for name, value in expected.items():
        assert spread[name] == pytest.approx(value, rel=1e-6), name
    per_second = error_model(TERRAIN, prior=Prior(gyro_bias=216.0), kind=FIFTEEN, cruise=CRUISE)
    assert np.sqrt(per_second.initial.cov()[-1, -1]) == pytest.approx(np.radians(0.06), rel=1e-6)


@pytest.mark.parametrize("at", [0, 1, 2, 4, 8, 9, 11, 13])
def test_errors_grow_as_in_the_mechanization(at):
    """A small error of one state in the mechanization of two minutes of level flight to the north-east, against the model's transition."""
    step, count = 0.3, 400
    velocity = np.tile([CRUISE.north, CRUISE.east, 0.0], (count, 1))
    attitude = np.tile(mechanization.attitude_of(np.array(0.0), np.array(0.0), np.arctan2(CRUISE.east, CRUISE.north)), (count, 1, 1))
    true = mechanization.moved((CRUISE.latitude, -1.5, CRUISE.height), velocity, attitude, step)
    read = mechanization.readings(true, step)
    error = np.zeros(15)
    error[at] = size = np.repeat([2e-5, 0.01, 2.0, 2e-4, 2e-7], 3)[at]
    start = mechanization.Motion(*(part[:1] for part in true))
    turned = Rotation.from_rotvec(error[:3]).as_matrix() @ start.attitude[0]
    start = start._replace(attitude=turned[None], velocity=start.velocity - error[3:6], height=start.height + error[8])
    wrong = mechanization.Readings(read.rate - error[12:], read.force - error[9:12])
    found = mechanization.errors(true, mechanization.mechanized(start, wrong, step))
    assert np.abs(found[0] - error[:9]).max() < 1e-3 * size
    with jax.enable_x64(True):
        A = np.asarray(dynamics(CRUISE, inertial.TACTICAL, 0.0, step).A)
    x = np.linalg.matrix_power(A, count - 1) @ error
    scale = np.abs(x[:9]).reshape(3, 3).max(axis=1).repeat(3)
    assert (np.abs(found[-1] - x[:9]) < 0.02 * scale + np.repeat([1e-9, 1e-6, 1e-5], 3)).all(), (found[-1], x[:9])


def test_growth_of_the_covariance_against_fine_steps():
    """Without altimeter, in float32, against small steps of P' = F P + P F' + noise; small states keep their digits, too."""
    noises, grade, steps = Noises(position=0.5), inertial.CONSUMER, 200
    model = error_model(TERRAIN, noises, kind=Inertial(15, "consumer"), cruise=CRUISE)
    ground = Track(jnp.full(steps, 1e3), jnp.full(steps, 1e3), jnp.full(steps, 1500.0))
    found = np.asarray(unaided(model, ground), np.float64)
    velocity = np.array([CRUISE.north, CRUISE.east, 0.0])
    level = mechanization.attitude_of(np.array(0.0), np.array(0.0), np.arctan2(CRUISE.east, CRUISE.north))
    down = np.array([0.0, 0.0, inertial.gravity(CRUISE.latitude, CRUISE.height)])
    F = inertial.error_growth(CRUISE.latitude, CRUISE.height, velocity, -down, level)
    P, h = np.asarray(model.initial.cov(), np.float64), 0.01
    move, noise = np.eye(15) + F * h + F @ F * h**2 / 2, inertial.error_noise(grade, 0.5) * h
    P_end = P
    for _ in range(round((steps - 1) * 0.3 / h)):
        P_end = move @ P_end @ move.T + noise
    assert found[0] == pytest.approx([1000, 1000])
    assert found[-1] == pytest.approx(np.sqrt(np.diag(P_end)[[6, 7]]), rel=1e-4)
    Q = np.asarray(model.dynamics.Q)
    assert Q.dtype == np.float32 and (np.diag(Q)[:9] > 0).all() and np.linalg.eigvalsh(Q[:9, :9].astype(float)).min() > -1e-12
    # states that the noise does not drive directly keep a factor
    assert float(Q[0, 0]) == pytest.approx((0.5 * np.pi / 180 / 60) ** 2 * 0.3, rel=1e-3)


def test_both_models_have_one_altimeter():
    nine, fifteen = error_model(TERRAIN), error_model(TERRAIN, kind=FIFTEEN, cruise=CRUISE)
    u = Track(jnp.float32(2000.0), jnp.float32(2500.0), jnp.float32(900.0))
    for errors in np.random.default_rng(1).normal(0, [300, 300, 50, 3, 3, 1], (5, 6)):
        short = jnp.zeros(9).at[:6].set(errors)
        long = jnp.zeros(15).at[jnp.array([fifteen.names.index(name) for name in nine.names[:6]])].set(errors)
        assert float(nine.sensor.mean(short, u, 0)[0]) == float(fifteen.sensor.mean(long, u, 0)[0])
        assert corrected(u, short) == corrected(u, long, fifteen.names)
        assert float(nine.sensor.cov(short, u, 0)[0, 0]) == float(fifteen.sensor.cov(long, u, 0)[0, 0])
    holed = np.array(RELIEF)
    holed[20:30] = np.nan
    void = error_model(TerrainMap(holed, 90.0, 75.0, latitude=36.5), kind=FIFTEEN, cruise=CRUISE)
    over = jnp.zeros(15).at[6].set(100.0)
    assert float(void.sensor.cov(over, u, 0)[0, 0]) == pytest.approx(225 + np.nanvar(holed), rel=1e-4)
    assert float(void.sensor.cov(over.at[6].set(-1000.0), u, 0)[0, 0]) == 225


def test_a_flight_is_kept(flight):
    history = mo.run(3, mo.MarginalizedParticleFilter(n=2000, linear=LINEAR), flight.model, flight.ys, flight.inputs)
    found = scenario.score(history, flight)
    assert not found.lost and found.final < 100
    assert float(scenario.horizontal_errors((flight.inputs.north, flight.inputs.east), flight)[-1]) > 300
    assert mo.structure(flight.model, jax.tree.map(lambda leaf: leaf[0], flight.inputs)).covariance == "shared"
    # the truth of a draw is the inertial track once its errors are added
    north, east, _ = corrected(flight.inputs, flight.errors, flight.model.names)
    np.testing.assert_allclose(jnp.stack([north, east], axis=1), flight.truth, atol=0.01)


@pytest.mark.night
def test_without_position_noise(flight):
    """The position wanders by what the velocity noise makes of it alone; factors of that tiny noise are there in float32."""
    model = error_model(flight.terrain, Noises(position=0.0), kind=FIFTEEN, cruise=CRUISE)
    Q = np.asarray(model.dynamics.Q, np.float64)
    assert Q[6, 6] == pytest.approx((0.05 / 60) ** 2 * 0.3**3 / 3, rel=0.01)
    history = mo.run(0, mo.MarginalizedParticleFilter(n=2000, linear=LINEAR), model, flight.ys, flight.inputs)
    assert np.isfinite(np.asarray(history.cov)).all() and not np.asarray(history.info.invalid).any()


def test_cruise():
    seconds = np.arange(50) * 0.3
    straight = np.stack([100.0 * seconds, -40.0 * seconds, 1500 + 0 * seconds], axis=1)
    found = cruise_of(TERRAIN, straight, seconds)
    assert (found.height, found.north, found.east) == pytest.approx((1500, 100, -40)) and found.latitude == pytest.approx(np.radians(36.5))
    assert cruise_of(TERRAIN, straight[:1], seconds[:1])[2:] == (0, 0)


@pytest.mark.parametrize(("call", "words"), [
    (lambda: error_model(TERRAIN, kind=Inertial(states=12)), ("inertial states", "9 or 15", "12")),
    (lambda: error_model(TERRAIN, kind=Inertial(states=15)), ("inertial states", "cruise", "15")),
    (lambda: error_model(TERRAIN, kind=FIFTEEN, step=None, cruise=CRUISE), ("inertial states", "evenly spaced", "15")),
    (lambda: error_model(TERRAIN, kind=Inertial(15, "cheap")), ("inertial grade", "'tactical'", "'cheap'")),
    (lambda: error_model(TERRAIN, prior=Prior(gyro_bias=-1.0), kind=FIFTEEN, cruise=CRUISE), ("prior gyro_bias", "-1")),
    (lambda: scenario.simulated(0, TerrainMap(RELIEF, 90.0, 75.0), Route(fixes=3), kind=FIFTEEN), ("terrain latitude", "None")),
    (lambda: cruise_of(TERRAIN, np.stack([np.sin(np.arange(9)), np.arange(9), np.zeros(9)], axis=1) * 100, np.arange(9.0)),
     ("inertial states", "straight", "pieces")),
])
def test_refusals(call, words):
    with pytest.raises(mo.MotesError) as error:
        call()
    refused(error, *words)
