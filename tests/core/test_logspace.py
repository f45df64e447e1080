"""Sums over time and weights in log space."""

import jax
import jax.numpy as jnp
import numpy as np

import motes as mo
from motes.core import logspace


def test_running_sum_does_not_drift():
    """N2: a million float32 terms of mean -1.92 stay within 0.1 nat of their float64 sum; the naive sum does not."""
    terms = jnp.asarray(np.random.default_rng(0).normal(-1.92, 1.0, 1_000_000), jnp.float32)
    exact = np.asarray(terms, np.float64).sum()

    def add(carry, term):
        return (carry[0].add(term), carry[1] + term), None

    start = (logspace.RunningSum.zero(jnp.float32), jnp.float32(0))
    (ours, naive), _ = jax.jit(lambda terms: jax.lax.scan(add, start, terms))(terms)
    careful = float(np.float64(ours.total) - np.float64(ours.missed))
    assert abs(careful - exact) < 0.1
    assert abs(float(ours.value()) - exact) < 0.2
    assert abs(float(naive) - exact) > 10


def test_log_likelihood_of_a_long_run_does_not_drift():
    model = mo.StateSpaceModel(mo.Gaussian([0.0], [[1.0]]), mo.LinearGaussian([[0.95]], [[0.3]]), mo.LinearGaussian([[1.0]], [[0.4]]))
    ys = mo.simulate(0, model, 200_000)[1]
    history = mo.run(0, mo.KalmanFilter(), model, ys, keep=mo.keep.nothing)
    exact = np.asarray(history.log_evidence, np.float64).sum()
    assert abs(float(history.log_likelihood) - exact) < 0.1
    assert np.all(np.asarray(history.state.cov()) > 0)


def test_normalize_and_sizes():
    weights, total = logspace.normalize(jnp.array([-1000.0, -1001.0, -jnp.inf]))
    assert np.allclose(np.exp(weights).sum(), 1) and np.isclose(total, -1000 + np.log1p(np.exp(-1)))
    assert np.isclose(logspace.effective_size(weights), 1 / (np.exp(np.asarray(weights)) ** 2).sum())
    assert np.isclose(logspace.entropy_deficit(logspace.uniform_weights(10, jnp.float32)), 0, atol=1e-6)
    assert np.isclose(logspace.entropy_deficit(jnp.array([0.0, -jnp.inf])), np.log(2))
    assert not np.isfinite(logspace.normalize(jnp.full(3, -jnp.inf))[1])


def test_infinite_terms_never_become_nan():
    total = logspace.RunningSum.zero(jnp.float32).add(jnp.float32(-jnp.inf)).add(jnp.float32(1.0))
    assert float(total.value()) == -np.inf
