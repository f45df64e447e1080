"""Models built anew from equal functions compile nothing anew; those that differ in anything do not share."""


import jax
import jax.numpy as jnp
import numpy as np
import pytest

import motes as mo
from motes.filters import run as running
from motes.filters import stream_steps as streaming
from motes.models import simulate as simulating
from tiers import each


def model(f, sensor=lambda x, u, t: jnp.sin(x), **changes):
    law = mo.Gaussian(jnp.array([1.0, -0.5]), jnp.eye(2))
    return mo.StateSpaceModel(law, mo.AdditiveGaussian(f, 0.1 * jnp.eye(2)), mo.AdditiveGaussian(sensor, 0.2 * jnp.eye(2)), **changes)


def cubic(scale=0.1, offsets=(0.0, 1.0)):
    """A model from fresh functions; offsets are closed over as an array, the helper is a nested function."""
    array = np.array(offsets, np.float32)

    @jax.jit
    def helper(x):
        return jnp.tanh(scale * x**3)

    return model(lambda x, u, t: x + helper(x) + array, lambda x, u, t: jnp.logaddexp(x, 0.5 * scale))


def mixed(scale=0.9):
    return mo.MixedLinearModel(
        mo.Gaussian([0.0], [[1.0]]),
        mo.Gaussian([0.0], [[1.0]]),
        particle=lambda x_p, u, t: (jnp.sin(x_p), scale * jnp.eye(1), jnp.eye(1)),
        kalman=lambda x_p, u, t: (0 * x_p, scale * jnp.eye(1), jnp.eye(1)),
        sensor=lambda x_p, u, t: (x_p, jnp.eye(1), scale * jnp.eye(1)),
        cross_cov=lambda x_p, u, t: 0.1 * jnp.eye(1),
    )


def custom(scale=1.0):
    """Custom parts, correlated noises apart: samplers draw with the key that they are given."""
    law = mo.Gaussian(jnp.zeros(1), jnp.eye(1))
    return mo.StateSpaceModel(
        law,
        mo.Custom(sample=lambda key, x, u, t: 0.5 * x + jax.random.normal(key, (1,))),
        mo.Custom(sample=lambda key, x, u, t: x + scale * jax.random.laplace(key, (1,)), log_prob=lambda y, x, u, t: -jnp.sum(abs(y - x))),
    )


def correlated(size=0.05):
    return model(lambda x, u, t: 0.9 * x, noise_cross_cov=lambda x, u, t: size * jnp.eye(2))


def proposed():
    return mo.ParticleFilter(n=20, proposal=mo.AdditiveGaussian(lambda x, uy, t: 0.8 * x + 0.1 * uy[1], jnp.eye(2)))


CASES = {
    "nested functions and arrays": (cubic, lambda: mo.ParticleFilter(n=20)),
    "mixed linear": (mixed, lambda: mo.MarginalizedParticleFilter(n=20)),
    "mixed linear, joined": (mixed, lambda: mo.ParticleFilter(n=20)),
    "custom": (custom, lambda: mo.ParticleFilter(n=20)),
    "correlated noises": (correlated, mo.ExtendedKalmanFilter),
    "proposal": (cubic, proposed),
}


@pytest.mark.parametrize("case", each(CASES, set(CASES) - {"mixed linear", "custom"}))
def test_rebuilt_models_compile_nothing_anew(case):
    build, make = case
    programs = (running._run, simulating._simulate, streaming.start, streaming.move, streaming.take_in, streaming.advance)

    def everything():
        ys = np.array(mo.simulate(1, build(), 6)[1])
        history = mo.run(2, make(), build(), ys)
        *_, last = mo.filters.run_in_chunks(2, make(), build(), ys, chunk=6)
        stream = mo.stream(2, make(), build())
        stream.update(ys[0])
        stream.predict()
        stream.update(ys[1])
        return ys, history.mean, last.mean, stream.mean

    first = everything()
    compiled = [program._cache_size() for program in programs]
    second = everything()
    assert [program._cache_size() for program in programs] == compiled
    for a, b in zip(first, second, strict=True):
        np.testing.assert_array_equal(a, b)


def test_models_that_differ_do_not_share():
    ys = np.zeros((4, 2))
    filter = mo.ExtendedKalmanFilter()
    results = [np.array(mo.run(0, filter, m, ys).mean) for m in (cubic(), cubic(scale=0.2), cubic(offsets=(0.0, 1.5)))]
    assert not np.array_equal(results[0], results[1]) and not np.array_equal(results[0], results[2])
    drawn = [np.array(mo.simulate(0, m, 4)[1]) for m in (mixed(), mixed(0.8), mixed())]
    assert not np.array_equal(drawn[0], drawn[1]) and np.array_equal(drawn[0], drawn[2])


def test_inputs_of_another_shape_than_at_step_0_are_seen():
    """A stream that is given inputs only later must not run what another function does without inputs."""

    def moved(sign):
        return model(lambda x, u, t: x if u is None else x + sign * u)

    means = []
    for sign in (1.0, -1.0):
        stream = mo.stream(0, mo.ExtendedKalmanFilter(), moved(sign))
        stream.update([0.0, 0.0])
        stream.predict(np.float32(2.0))
        means.append(np.array(stream.mean))
    assert np.allclose(means[0] - means[1], 4.0, atol=1e-5)


def test_chunks_of_rebuilt_models_compile_nothing_anew():
    ys = np.zeros((6, 2))
    *_, first = mo.filters.run_in_chunks(2, mo.ExtendedKalmanFilter(), cubic(), ys, chunk=2)
    compiled = running._run._cache_size()
    *_, second = mo.filters.run_in_chunks(2, mo.ExtendedKalmanFilter(), cubic(), ys, chunk=2)
    assert running._run._cache_size() == compiled
    np.testing.assert_array_equal(first.mean, second.mean)


@pytest.mark.night
def test_transformations_see_what_functions_close_over(double):
    ys = jnp.asarray(mo.simulate(0, cubic(), 5)[1])

    def evidence(scale):
        return mo.run(0, mo.ExtendedKalmanFilter(), model(lambda x, u, t: scale * x), ys).log_likelihood

    scales = jnp.array([0.5, 0.7, 0.9])
    alone = np.array([evidence(scale) for scale in scales.tolist()])
    assert len(set(alone.tolist())) == 3
    np.testing.assert_allclose(jax.vmap(evidence)(scales), alone, rtol=1e-5)
    np.testing.assert_allclose(list(map(jax.jit(evidence), scales)), alone, rtol=1e-5)
    step = 1e-5
    slope = [(evidence(s + step) - evidence(s - step)) / (2 * step) for s in scales.tolist()]
    np.testing.assert_allclose(list(map(jax.jit(jax.grad(evidence)), scales)), slope, rtol=1e-5)
