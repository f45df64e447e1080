"""Several sensors by name are one sensor; each that measured nothing is left out."""

import jax.numpy as jnp
import numpy as np
import pytest

import motes as mo
from tiers import each

STEPS = 12
RADAR = mo.AdditiveGaussian(lambda x, u, t: jnp.stack([jnp.hypot(x[0], x[1]), jnp.arctan2(x[1], x[0])]), np.diag([4.0, 1e-3]), angles=(1,))
SPEED = mo.LinearGaussian([[0.0, 0.0, 1.0, 0.0]], [[0.1]])
ONE = mo.AdditiveGaussian(
    lambda x, u, t: jnp.stack([x[2], jnp.hypot(x[0], x[1]), jnp.arctan2(x[1], x[0])]), np.diag([0.1, 4.0, 1e-3]), angles=(2,)
)


def model(sensor):
    base = mo.textbook.constant_velocity()
    start = mo.Gaussian(jnp.array([-40.0, 0.5, 1.0, 0.0]), jnp.diag(jnp.array([4.0, 4.0, 0.5, 0.5])))
    return mo.StateSpaceModel(start, base.dynamics, sensor, base.names)


GAUSSIAN = model(mo.Independent(speed=SPEED, radar=RADAR))
XS, YS = (np.array(drawn) for drawn in mo.simulate(3, model(ONE), STEPS))
"""The bearing is near pi: it crosses the cut."""
NAMED = {"speed": YS[:, 0], "radar": YS[:, 1:]}
FILTERS = {
    "extended Kalman": mo.ExtendedKalmanFilter(), "cubature": mo.CubatureKalmanFilter(), "particle": mo.ParticleFilter(n=400),
    "marginalized": mo.MarginalizedParticleFilter(n=400), "ensemble": mo.EnsembleKalmanFilter(n=200),
}  # fmt: skip


@pytest.mark.parametrize("name", each(list(FILTERS), {"cubature", "ensemble"}))
def test_it_is_the_sensor_that_has_all_components(name):
    found, wanted = mo.run(1, FILTERS[name], GAUSSIAN, NAMED), mo.run(1, FILTERS[name], model(ONE), YS)
    np.testing.assert_allclose(found.mean, wanted.mean, rtol=2e-3, atol=2e-3)
    np.testing.assert_allclose(found.log_likelihood, wanted.log_likelihood, rtol=2e-3, atol=2e-2)


def test_silent_sensors_are_left_out():
    ys = YS.copy()
    ys[:, 0] = np.nan
    ys[4] = np.nan
    radar = NAMED["radar"].copy()
    radar[4] = np.nan
    found, wanted = mo.run(1, mo.ExtendedKalmanFilter(), GAUSSIAN, {"radar": radar}), mo.run(1, mo.ExtendedKalmanFilter(), model(ONE), ys)
    np.testing.assert_allclose(found.mean, wanted.mean, rtol=1e-4, atol=1e-4)
    stream = mo.stream(1, mo.ExtendedKalmanFilter(), GAUSSIAN)
    for t in range(STEPS):
        if t:
            stream.predict()
        stream.update({"radar": radar[t]} if t != 4 else None)
    np.testing.assert_allclose(stream.mean, found.mean[-1], rtol=1e-4, atol=1e-4)


def test_lists_and_iterators_have_a_dictionary_for_each_step():
    radar = np.array([[1.0, 2.0], [np.nan, np.nan], [3.0, 4.0]])
    wanted = mo.run(0, mo.ExtendedKalmanFilter(), GAUSSIAN, {"speed": np.array([[0.5], [0.6], [np.nan]]), "radar": radar}).mean
    steps = [{"speed": 0.5, "radar": [1, 2]}, {"speed": [0.6]}, {"speed": None, "radar": radar[2]}]
    for ys in (steps, iter(steps), {"speed": [0.5, 0.6, None], "radar": [[1, 2], None, [3, 4]]}):
        np.testing.assert_array_equal(mo.run(0, mo.ExtendedKalmanFilter(), GAUSSIAN, ys).mean, wanted)


@pytest.mark.parametrize("count", [
    mo.AdditiveGaussian(lambda x, u, t: x[:1], [[1.0]]), mo.Custom(log_prob=lambda y, x, u, t: -((y[0] - x[0]) ** 2)),
])  # fmt: skip
def test_streams_take_lists_by_name_and_none(count):
    mixed = model(mo.Independent(radar=RADAR, count=count))
    for given, wanted in (({"radar": [1.0, 2], "count": (3,)}, {"radar": np.array([1.0, 2.0]), "count": np.array([3.0])}),
                          ({"radar": [1.0, None], "count": [3]}, {"radar": np.array([1.0, np.nan]), "count": np.array([3.0])}),
                          ({"radar": None, "count": [3.0]}, {"count": np.array([3.0])})):  # fmt: skip
        found, same = (mo.stream(0, mo.ParticleFilter(n=50), mixed).update(y).log_evidence for y in (given, wanted))
        np.testing.assert_array_equal(found, same)
    found = mo.run(0, mo.ParticleFilter(n=50), mixed, [{"radar": [1.0, 2.0], "count": [3.0]}] * 2)
    same = mo.run(0, mo.ParticleFilter(n=50), mixed, {"radar": np.array([[1.0, 2.0]] * 2), "count": np.full((2, 1), 3.0)})
    np.testing.assert_array_equal(found.mean, same.mean)


def test_densities_of_any_kind_are_multiplied():
    """A picture whose one pixel is the speed, beside the radar."""

    def log_prob(frame, x, u, t):
        return -0.5 * ((frame[1, 1].astype(jnp.float32) - 128) / 40 - x[2]) ** 2 / 0.1

    frames = np.random.default_rng(0).integers(0, 255, (STEPS, 3, 3)).astype(np.uint8)
    frames[:, 1, 1] = np.round(np.clip(YS[:, 0], -3, 3) * 40 + 128)
    ys = YS.copy()
    ys[:, 0] = (frames[:, 1, 1].astype(float) - 128) / 40
    mixed = model(mo.Independent(camera=mo.Custom(log_prob=log_prob), radar=RADAR))
    found = mo.run(1, mo.ParticleFilter(n=400), mixed, {"camera": frames, "radar": NAMED["radar"]})
    wanted = mo.run(1, mo.ParticleFilter(n=400), model(ONE), ys)
    np.testing.assert_allclose(found.mean, wanted.mean, rtol=5e-3, atol=5e-3)
    alone = mo.run(1, mo.ParticleFilter(n=400), mixed, {"radar": NAMED["radar"]})
    ys[:, 0] = np.nan
    np.testing.assert_allclose(alone.mean, mo.run(1, mo.ParticleFilter(n=400), model(ONE), ys).mean, rtol=5e-3, atol=5e-3)


@pytest.mark.parametrize(("ys", "words"), [
    ({"sonar": YS[:, 0]}, "ys: expected measurements of speed, radar, got 'sonar'"),
    ({"radar": YS}, r"ys\['radar'\]: expected shape \(12, 2\)"),
    ({"radar": YS[:, 1:], "speed": YS[:5, 0]}, "of one length"),
])  # fmt: skip
def test_what_does_not_fit_is_refused(ys, words):
    with pytest.raises(mo.MotesError, match=words):
        mo.run(1, mo.ExtendedKalmanFilter(), GAUSSIAN, ys)


def test_no_sensor_is_refused():
    with pytest.raises(mo.MotesError, match="Independent: expected at least one sensor"):
        mo.Independent()
    with pytest.raises(mo.MotesError, match="Independent a: expected a sensor"):
        mo.Independent(a=3)


GATED = {
    "extended Kalman": mo.ExtendedKalmanFilter, "cubature": mo.CubatureKalmanFilter, "marginalized": lambda **gate:
    mo.MarginalizedParticleFilter(n=400, **gate), "wrapped": lambda **gate: mo.Adapting(mo.ExtendedKalmanFilter(**gate), {}, unchanged),
}  # fmt: skip


def unchanged(key, memory, law, y, u, t):
    return memory


def disturbed():
    """Speeds that are far off at two steps, and a radar that is off at one."""
    named = {name: values.copy() for name, values in NAMED.items()}
    named["speed"][[3, 7]] += 40.0
    named["radar"][9, 0] += 500.0
    return named


def without(named, speeds, radars):
    kept = {name: values.copy() for name, values in named.items()}
    kept["speed"][speeds] = np.nan
    kept["radar"][radars] = np.nan
    return kept


@pytest.mark.parametrize("name", each(list(GATED), {"wrapped", "cubature", "marginalized"}))
def test_each_sensor_is_held_against_its_gate_alone(name):
    filter, ys = GATED[name], disturbed()
    found, wanted = mo.run(1, filter(gate=0.9999), GAUSSIAN, ys), mo.run(1, filter(), GAUSSIAN, without(ys, [3, 7], 9))
    np.testing.assert_allclose(found.mean, wanted.mean, rtol=1e-4, atol=1e-4)
    assert np.flatnonzero(np.asarray(found.info.gated)).tolist() == [3, 7, 9]
    assert np.asarray(found.info.nis)[[3, 7, 9]].min() > 50
    np.testing.assert_allclose(found.info.freedom, 3, atol=0.2)
    radar = mo.run(1, filter(gate={"radar": 0.9999}), GAUSSIAN, NAMED | {"radar": ys["radar"]})
    assert np.flatnonzero(np.asarray(radar.info.gated)).tolist() == [9]
    open_to_speeds = mo.run(1, filter(gate={"radar": 0.9999}), GAUSSIAN, ys)
    assert not open_to_speeds.info.gated[3]
    stream = mo.stream(1, filter(gate=0.9999), GAUSSIAN)
    for t in range(STEPS):
        if t:
            stream.predict()
        stream.update({name: values[t] for name, values in ys.items()})
    np.testing.assert_allclose(stream.mean, found.mean[-1], rtol=1e-5, atol=1e-5)


def test_both_sensors_off_is_nothing_measured():
    ys = disturbed()
    ys["radar"][7] += 500.0
    found = mo.run(1, mo.ExtendedKalmanFilter(gate=0.9999), GAUSSIAN, ys)
    wanted = mo.run(1, mo.ExtendedKalmanFilter(), GAUSSIAN, without(ys, [3, 7], [7, 9]))
    np.testing.assert_allclose(found.mean, wanted.mean, rtol=1e-4, atol=1e-4)
    assert found.info.gated[7] == 2 and found.info.log_evidence[7] == 0


@pytest.mark.parametrize(("gate", "sensor", "words"), [
    ({"sonar": 0.99}, None, "ExtendedKalmanFilter gate: expected gates of speed, radar, got 'sonar'"),
    ({"radar": 0.99}, ONE, "one number: the model has no sensors by name"),
    ({"radar": 2.0}, None, "ExtendedKalmanFilter gate: expected a probability"),
])  # fmt: skip
def test_gates_that_do_not_fit_are_refused(gate, sensor, words):
    with pytest.raises(mo.MotesError, match=words):
        mo.run(1, mo.ExtendedKalmanFilter(gate=gate), GAUSSIAN if sensor is None else model(sensor), YS)
