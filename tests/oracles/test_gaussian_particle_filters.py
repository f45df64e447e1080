"""Gaussian and Gaussian-sum particle filters against the Kalman filter and, on problems with two modes, the point-mass filter."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.stats import norm

import motes as mo
from tiers import each

pytestmark = pytest.mark.jax

RUNS, N = 100, 2000


def scalar_pair():
    """Two coupled states, both measured with unequal accuracy."""
    return mo.StateSpaceModel(
        mo.Gaussian([1.0, -0.5], [[1.0, 0.3], [0.3, 0.6]]),
        mo.LinearGaussian([[0.9, 0.3], [-0.1, 0.7]], [[0.4, 0.1], [0.1, 0.2]]),
        mo.LinearGaussian([[1.0, 0.2], [0.3, -1.0]], [[0.3, 0.05], [0.05, 0.5]]),
    )


LINEAR = {
    "redraw": mo.GaussianParticleFilter(n=N),
    "moved draws": mo.GaussianParticleFilter(n=N, redraw=False),
    "sum I": mo.GaussianSumParticleFilter(n=N, mixands=4),
    "sum II": mo.GaussianSumParticleFilter(n=N, mixands=4, form="II"),
}


@pytest.mark.parametrize("filter", each(LINEAR, {"sum I", "sum II"}))
def test_equal_the_kalman_filter_on_a_linear_model(filter, double):
    """Means over 100 seeds within Monte Carlo error (level 1e-6 over all) and a bias of order 1/n; variances within 5 percent."""
    model = scalar_pair()
    ys = np.array(mo.simulate(1, model, 5)[1])
    ys[2, 1], ys[3] = np.nan, np.nan
    exact = mo.run(0, mo.KalmanFilter(), model, ys)
    keys = jax.random.split(jax.random.key(5), RUNS)
    runs = jax.jit(jax.vmap(lambda key: (lambda h: (h.mean, h.cov, h.log_likelihood))(mo.run(key, filter, model, jnp.asarray(ys)))))(keys)
    means, covs, totals = (np.asarray(part) for part in runs)
    critical = norm.isf(1e-6 / 2 / means[0].size / len(LINEAR))
    deviation = means.std(axis=0, ddof=1)
    assert np.all(np.abs(means.mean(axis=0) - exact.mean) < critical * deviation / np.sqrt(RUNS) + 2 * deviation / np.sqrt(N))
    assert np.allclose(covs.mean(axis=0), exact.cov, rtol=0.05, atol=0.01)
    # log of an estimate of variance v lies v / 2 low on average
    assert abs(totals.mean() + totals.var() / 2 - float(exact.log_likelihood)) < 5 * totals.std() / np.sqrt(RUNS) + 0.01


def two_modes(noise=None, sensor=None):
    """A state that is seen squared, from a start a little to the right: two modes of unequal weight that hardly mix."""
    dynamics = mo.AdditiveNoise(lambda x, u, t: 1.02 * x, noise) if noise else mo.AdditiveGaussian(lambda x, u, t: 1.02 * x, [[0.02]])
    seen = mo.AdditiveNoise(lambda x, u, t: x**2, sensor) if sensor else mo.AdditiveGaussian(lambda x, u, t: x**2, [[0.3]])
    return mo.StateSpaceModel(mo.Gaussian([0.4], [[1.0]]), dynamics, seen)


def mixture(weights, means, variances):
    return mo.Mixture.of(jnp.array(weights), jnp.array(means)[None], jnp.array(variances)[None, None])


BIMODAL = {
    "I": two_modes(),
    "II": two_modes(noise=mixture([0.8, 0.2], [-0.02, 0.08], [0.01, 0.06])),
    "III": two_modes(sensor=mixture([0.7, 0.3], [0.2, -0.5], [0.1, 0.8])),
}


@pytest.mark.parametrize(("form", "reduction"), [
    ("I", "resample"), pytest.param("II", "prune", marks=pytest.mark.night), pytest.param("II", "resample", marks=pytest.mark.night),
    pytest.param("III", "resample", marks=pytest.mark.night)])
def test_both_modes_have_the_weights_of_the_exact_filter(form, reduction, double):
    """Weight right of zero and the mean within each mode beside a grid, on average over six runs."""
    model = BIMODAL[form]
    ys = jnp.array([[1.2], [1.5], [1.1], [1.6], [1.4]])
    exact = mo.run(0, mo.PointMassFilter(-5.0, 5.0, 401), model, ys)
    nodes, mass = np.asarray(exact.state.particles[0]), np.asarray(exact.state.weights)
    filter = mo.GaussianSumParticleFilter(n=60, mixands=400, form=form, reduction=reduction)
    keys = jax.random.split(jax.random.key(1), 6)
    found, totals = jax.jit(jax.vmap(lambda key: (lambda h: (h.state, h.log_likelihood))(mo.run(key, filter, model, ys))))(keys)
    weights, center = np.exp(np.asarray(found.log_weights)) / len(keys), np.asarray(found.parts.center[:, 0])
    right = float(np.sum(weights * norm.cdf(center / np.sqrt(np.asarray(found.parts.covariance[:, 0, 0])))))
    wanted = float(mass[nodes > 0].sum())
    assert 0.55 < wanted < 0.9
    assert abs(right - wanted) < 0.05
    for side in (1, -1):
        within, own = mass * (side * nodes > 0), weights * (side * center > 0)
        assert abs((nodes @ within) / within.sum() - np.sum(center * own) / own.sum()) < 0.04
    # pruning drops what explains the measurement worst
    assert reduction == "prune" or abs(float(totals.mean() - exact.log_likelihood)) < 0.1


def test_one_gaussian_cannot_hold_two_modes(double):
    """The same problem, to show that it asks something: a Gaussian particle filter ends with a far wider law than either mode."""
    history = mo.run(1, mo.GaussianParticleFilter(n=4000), BIMODAL["I"], jnp.array([[1.2], [1.5], [1.1]]))
    assert float(history.cov[0, 0, 0]) > 0.5
