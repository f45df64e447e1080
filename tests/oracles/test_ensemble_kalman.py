"""Ensemble Kalman filters: on linear models they converge to the Kalman filter, with errors of order n^-1/2."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.stats import norm

import motes as mo
from oracles.test_linear_gaussian import four_states
from tiers import each

pytestmark = pytest.mark.jax

RUNS = 60


@pytest.mark.parametrize("form", each(["deterministic", "stochastic"], {"stochastic"}))
def test_converges_to_the_kalman_filter(form, double):
    """Means over 60 seeds within Monte Carlo error (level 1e-6 over all) and a bias of order 1/n; 16 times the members, a quarter of it."""
    _, model = four_states()
    ys = np.array(mo.simulate(3, model, 8)[1])
    ys[3], ys[5, 1] = np.nan, np.nan
    exact = mo.run(0, mo.KalmanFilter(), model, ys)
    errors = {}
    for n in (250, 4000):
        filter = mo.EnsembleKalmanFilter(n=n, form=form)

        def result(key, filter=filter):
            history = mo.run(key, filter, model, jnp.asarray(ys))
            return history.mean, history.cov, history.log_likelihood

        means, covs, totals = (np.asarray(part) for part in jax.jit(jax.vmap(result))(jax.random.split(jax.random.key(7), RUNS)))
        deviation = means.std(axis=0, ddof=1)
        critical = norm.isf(1e-6 / 4 / means[0].size)
        assert np.all(np.abs(means.mean(axis=0) - exact.mean) < critical * deviation / np.sqrt(RUNS) + 2 * deviation / np.sqrt(n))
        errors[n] = np.sqrt(np.mean((means - exact.mean) ** 2, axis=0))
        ratio = np.diagonal(covs.mean(axis=0) / exact.cov, axis1=1, axis2=2)
        assert np.abs(ratio - 1).max() < 10 / n + 0.02
        assert abs(totals.mean() - float(exact.log_likelihood)) < 5 * totals.std() / np.sqrt(RUNS) + 50 / n
    assert 3 < (errors[250] / errors[4000]).mean() < 5.3


def test_the_deterministic_form_has_the_kalman_covariance_of_its_own_members(double):
    """One correction: mean and covariance are those of the Kalman formulas with the members' moments, to rounding; R is correlated."""
    _, model = four_states()
    y = np.array([1.4, -0.8])
    filter = mo.EnsembleKalmanFilter(n=50)
    before = filter.init(jax.random.key(1), model)
    after, info = filter.correct(jax.random.key(2), model, before, jnp.asarray(y), None, 0)
    X, H, R = np.asarray(before.particles), np.asarray(model.sensor.A), np.asarray(model.sensor.Q)
    P = np.cov(X)
    S = H @ P @ H.T + R
    gain = P @ H.T @ np.linalg.inv(S)
    assert np.allclose(np.mean(after.particles, axis=1), X.mean(axis=1) + gain @ (y - H @ X.mean(axis=1)), atol=1e-10)
    assert np.allclose(np.cov(after.particles), P - gain @ S @ gain.T, atol=1e-10)
    residual = y - H @ X.mean(axis=1)
    density = -0.5 * (residual @ np.linalg.solve(S, residual) + np.linalg.slogdet(2 * np.pi * S)[1])
    assert abs(float(info.log_evidence) - density) < 1e-10


def test_inflation_multiplies_the_spread(double):
    _, model = four_states()
    state = mo.EnsembleKalmanFilter(n=40).init(jax.random.key(1), model)
    plain, wide = (mo.EnsembleKalmanFilter(n=40, inflation=i).predict(jax.random.key(3), model, state, None, 1) for i in (1.0, 1.5))
    assert np.allclose(wide.mean(), plain.mean()) and np.allclose(wide.cov(), 2.25 * plain.cov())
