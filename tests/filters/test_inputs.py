"""Inputs of steps, correlated noises and custom parts: the stream must see what the run sees."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import motes as mo
from tiers import each

FILTERS = [mo.ExtendedKalmanFilter(), mo.ParticleFilter(n=100), mo.MarginalizedParticleFilter(n=100)]


def driven_model(**changes):
    """A cart with commanded acceleration over uneven time steps; the noise grows with the step."""

    def f(x, u, t):
        return jnp.array([x[0] + u["dt"] * x[1], x[1] + u["dt"] * u["command"] - 0.01 * t])

    def Q(x, u, t):
        return u["dt"] * jnp.array([[0.1, 0.02], [0.02, 0.2]])

    return mo.StateSpaceModel(
        mo.Gaussian([0.0, 1.0], 0.5 * np.eye(2)),
        mo.AdditiveGaussian(f, Q),
        mo.AdditiveGaussian(lambda x, u, t: jnp.array([x[0] + 0.1 * jnp.sin(x[0]), x[0] + u["dt"]]), [[0.3, 0.1], [0.1, 0.4]]),
        ("p", "v"),
        **changes,
    )


def inputs(steps):
    rng = np.random.default_rng(0)
    return {"dt": jnp.asarray(rng.uniform(0.5, 1.5, steps), jnp.float32), "command": jnp.asarray(rng.normal(size=steps), jnp.float32)}


@pytest.mark.optimized
@pytest.mark.parametrize("cross", each({"independent": None, "correlated noises": [[0.05, 0.02], [0.0, -0.03]]}, {"correlated noises"}))
@pytest.mark.parametrize("filter", each({type(one).__name__: one for one in FILTERS}, {"ExtendedKalmanFilter", "ParticleFilter"}))
def test_stream_equals_run_with_inputs(filter, cross):
    model, u = driven_model(noise_cross_cov=cross), inputs(8)
    ys = np.array(mo.simulate(3, model, 8, u)[1])
    ys[3] = np.nan
    history = mo.run(5, filter, model, ys, u)
    stream = mo.stream(5, filter, model, jax.tree.map(lambda leaf: leaf[0], u))
    stream.update(ys[0])
    for t in range(1, 8):
        stream.predict(jax.tree.map(lambda leaf, t=t: leaf[t], u))
        if t != 3:
            stream.update(ys[t])
    assert np.array_equal(history.mean[-1], stream.mean)
    assert float(history.log_likelihood) == float(stream.log_likelihood)
    pieces = list(mo.filters.run_in_chunks(5, filter, model, ys, u, chunk=3))
    assert np.array_equal(mo.filters.joined(pieces).mean, history.mean)


def test_checkpoint_with_inputs(tmp_path):
    model, u = driven_model(), inputs(4)
    ys = mo.simulate(3, model, 4, u)[1]
    stream = mo.stream(5, FILTERS[1], model, jax.tree.map(lambda leaf: leaf[0], u))
    stream.update(ys[0])
    again = mo.Stream.load(stream.save(tmp_path / "c.npz"), FILTERS[1], model)
    for one in (stream, again):
        one.predict(jax.tree.map(lambda leaf: leaf[1], u))
        one.update(ys[1])
    assert np.array_equal(stream.mean, again.mean)


def test_custom_model_equals_its_additive_twin():
    """The same law written as Custom functions: densities agree, and a filter runs on it."""
    twin = driven_model()
    root = jnp.linalg.cholesky(jnp.array([[0.1, 0.02], [0.02, 0.2]]))

    def sample(key, x, u, t):
        return twin.dynamics.mean(x, u, t) + jnp.sqrt(u["dt"]) * root @ jax.random.normal(key, (2,))

    def log_prob(y, x, u, t):
        return jax.scipy.stats.multivariate_normal.logpdf(y, twin.sensor.mean(x, u, t), jnp.asarray(twin.sensor.Q))

    model = mo.StateSpaceModel(twin.initial, mo.Custom(sample=sample), mo.Custom(log_prob=log_prob), ("p", "v"))
    u = inputs(10)
    ys = mo.simulate(0, twin, 10, u)[1]
    X = twin.initial.sample(jax.random.key(0), 7)
    first = jax.tree.map(lambda leaf: leaf[0], u)
    assert np.allclose(model.sensor.log_prob(ys[0], X, first, 0), twin.sensor.log_prob(ys[0], X, first, 0), atol=1e-4)
    ours, theirs = (mo.run(1, mo.ParticleFilter(n=20_000), m, ys, u) for m in (model, twin))
    # over 24 seeds the difference has a standard deviation of at most 0.02 in either component of any step
    assert np.abs(ours.mean - theirs.mean).max() < 0.12
    assert mo.structure(model, first).linear == ()


@pytest.mark.night
def test_noise_of_another_law_is_split_where_it_can_be():
    """A sensor with Student-t noise that sees only the position leaves the velocity to the Kalman part."""
    model = mo.StateSpaceModel(
        mo.Gaussian([0.0, 1.0], np.eye(2)), mo.LinearGaussian([[1.0, 0.5], [0.0, 0.9]], 0.1 * np.eye(2)),
        mo.AdditiveNoise(lambda x, u, t: x[:1], mo.StudentT([0.3], 4.0)), ("p", "v"))
    found = mo.structure(model)
    assert found.linear == (1,) and dict(found.reasons)["p"] == "sensor has noise that is not additive Gaussian"
    ys = mo.simulate(0, model, 8)[1]
    exact = mo.run(0, mo.PointMassFilter((-6, -5), (10, 6), (67, 47)), model, ys)
    ours = mo.run(0, mo.MarginalizedParticleFilter(n=20_000), model, ys)
    assert np.abs(ours.mean - exact.mean).max() < 0.05
    assert abs(float(ours.log_likelihood - exact.log_likelihood)) < 0.15


def test_a_density_of_ones_own_that_can_be_drawn_from_says_at_which_states_it_looks():
    dynamics = mo.LinearGaussian([[1.0, 1.0], [0.0, 1.0]], np.eye(2))
    sensor = mo.Custom(lambda key, x, u, t: {"range": x[:1]}, lambda y, x, u, t: -jnp.abs(y["range"][0] - x[0]))
    model = mo.StateSpaceModel(mo.Gaussian([0.0, 0.0], np.eye(2)), dynamics, sensor, ("position", "velocity"))
    assert mo.structure(model).linear == (1,)
    assert mo.structure(mo.StateSpaceModel(model.initial, dynamics, mo.Custom(log_prob=sensor.density))).linear == ()
