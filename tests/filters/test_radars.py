"""Several radars, each with a rate, clutter and a bias of its own, whose scans may come late."""

import jax.numpy as jnp
import numpy as np
import pytest

import motes as mo

pytestmark = pytest.mark.jax

NAMES = ("east", "north", "v_east", "v_north", "bias")
BIAS, STEPS, LAG = np.radians(0.5), 100, 5
SITES = {"west": (-8e3, 0.0), "south": (0.0, -9e3)}
REGION = mo.Uniform([0.0, -np.pi], [40e3, np.pi])


def radar(site, biased, false):
    def place(x, u, t):
        east, north = x[0] - site[0], x[1] - site[1]
        return jnp.stack([jnp.hypot(east, north), jnp.arctan2(north, east) + biased * x[4]])

    return mo.Cluttered(mo.AdditiveGaussian(place, np.diag([900.0, 2e-3**2]), angles=(1,)), 0.9, clutter=(false, REGION), plots=30)


def model(clutter=True):
    """A target that both radars see; the azimuths of the one in the south are off by an unknown constant."""
    def f(x, u, t):
        return jnp.concatenate([x[:2] + 2 * x[2:4], x[2:]])

    white = np.kron(0.5 * np.array([[8 / 3, 2.0], [2.0, 2.0]]), np.eye(2))
    start = mo.Gaussian(np.array([5e3, 4e3, -60.0, 40.0, 0.0]), np.diag([1e4, 1e4, 100.0, 100.0, 0.02**2]))
    radars = {"west": radar(SITES["west"], 0.0, 3.0), "south": radar(SITES["south"], 1.0, 6.0)}
    sensor = mo.Independent(**(radars if clutter else {name: one.sensor for name, one in radars.items()}))
    return mo.StateSpaceModel(start, mo.AdditiveGaussian(f, np.pad(white, (0, 1))), sensor, NAMES)


MODEL = model()
START = mo.Gaussian(MODEL.initial.mean().at[4].set(BIAS), jnp.diag(jnp.array([1e4, 1e4, 100.0, 100.0, 1e-12])))
WORLD = mo.StateSpaceModel(START, MODEL.dynamics, MODEL.sensor, NAMES)


def scanned(seed):
    """Scans of both, as `mo.plots` makes them; the radar in the south turns at half the rate."""
    xs, ys = mo.simulate(seed, WORLD, STEPS)
    found = {}
    for name, every in (("west", 1), ("south", 2)):
        rows = np.asarray(ys[name].value)
        found[name] = [row[~np.isnan(row).any(axis=1)] if t % every == 0 else None for t, row in enumerate(rows)]
    return xs, found


@pytest.mark.night
def test_a_bias_is_found_as_a_state_of_the_kalman_filter():
    """To 0.1 degrees within 100 scans, in 19 of 20 runs at least."""
    off = []
    for seed in range(20):
        xs, scans = scanned(seed)
        history = mo.run(0, mo.ExtendedKalmanFilter(), MODEL, {name: mo.plots(own) for name, own in scans.items()})
        off.append(abs(float(history.mean[-1, 4]) - BIAS))
        assert np.hypot(*np.asarray(history.mean - xs)[-1, :2]) < 300
    assert np.sum(np.array(off) < np.radians(0.1)) >= 19


def test_without_clutter_the_bias_is_in_the_kalman_part_of_a_particle_filter():
    assert 4 in mo.structure(model(clutter=False)).linear


def test_scans_that_come_late_give_the_bits_of_those_in_order():
    _, scans = scanned(3)
    ys = {name: mo.plots(own) for name, own in scans.items()}
    wanted = mo.run(0, mo.ExtendedKalmanFilter(), MODEL, ys)
    stream, steps = mo.stream(0, mo.ExtendedKalmanFilter(), MODEL, lag=LAG), 30
    rng, waiting = np.random.default_rng(0), []
    for t in range(steps):
        if t:
            stream.predict()
        stream.update({"west": scans["west"][t], "south": None})
        if scans["south"][t] is not None:
            waiting.append((min(t + rng.integers(0, LAG + 1), steps - 1), t))
        for due, step in [late for late in waiting if late[0] <= t]:
            stream.insert({"west": None, "south": scans["south"][step]}, step)
            waiting.remove((due, step))
    assert not waiting
    np.testing.assert_array_equal(stream.mean, wanted.mean[steps - 1])
    np.testing.assert_array_equal(stream.cov, wanted.cov[steps - 1])
    with pytest.raises(mo.MotesError, match="insert y"):
        stream.insert({"west": scans["west"][steps - 1] + 1.0, "south": None}, steps - 1)


def test_time_stamps_bring_scans_to_one_line_and_say_who_was_silent():
    west = [0.0, 2.0, 4.0], mo.plots([np.zeros((1, 2)), [], np.ones((2, 2))])
    line = mo.times(west=west, south=([2.0, 5.0], mo.plots([[[1.0, 2.0]], None])))
    assert line.ys["west"].there.tolist() == [True, True, True, False]
    assert line.ys["south"].there.tolist() == [False, True, False, False]
    assert line.ys["west"].value.shape == (4, 2, 2)


@pytest.mark.night
def test_particles_take_both_radars_too():
    xs, scans = scanned(5)
    ys = {name: mo.plots(own[:20]) for name, own in scans.items()}
    assert mo.structure(MODEL).linear == (2, 3)
    history = mo.run(0, mo.MarginalizedParticleFilter(n=2_000), MODEL, ys)
    kalman = mo.run(0, mo.ExtendedKalmanFilter(), MODEL, ys)
    assert np.hypot(*np.asarray(history.mean - xs[:20])[-1, :2]) < 200
    np.testing.assert_allclose(history.log_likelihood, kalman.log_likelihood, rtol=0.02)


def test_a_silent_radar_of_unknown_form_is_refused():
    scans = {"a": mo.Cluttered(mo.AdditiveGaussian(lambda x, u, t: x[:2], lambda x, u, t: np.eye(2)), 0.9, clutter=0.1, plots=3)}
    base = mo.textbook.constant_velocity()
    stream = mo.stream(0, mo.ParticleFilter(n=50), mo.StateSpaceModel(base.initial, base.dynamics, mo.Independent(**scans), base.names))
    with pytest.raises(mo.MotesError, match="ys: expected what Cluttered measures, NaN where it measured nothing, got None"):
        stream.update({"a": None})
