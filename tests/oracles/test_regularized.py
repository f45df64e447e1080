"""Regularized filters: bandwidths from the literature, moments of draws, and exact answers on linear models."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import motes as mo
from motes.core import random


@pytest.mark.parametrize(("d", "n", "gaussian", "ball"), [
    (1, 1000, 0.266, 0.589), (2, 1000, 0.316, 0.760), (6, 2000, 0.436, 1.314), (15, 2500, 0.614, 2.466)])  # fmt: skip
def test_bandwidths(d, n, gaussian, ball):
    assert abs(mo.resampling.Regularization().bandwidth(d, n) - gaussian) < 6e-4
    assert abs(mo.resampling.Regularization("epanechnikov").bandwidth(d, n) - ball) < 6e-4
    assert np.isclose(mo.resampling.Regularization(scale=0.3).bandwidth(d, n), 0.3 * mo.resampling.Regularization().bandwidth(d, n))


@pytest.mark.parametrize("d", [1, 2, 5])
def test_moments_of_draws(d, double):
    """Level 1e-6: 5.7 standard errors of 200 000 draws for at most 45 numbers."""
    n = 200_000
    for name, variance in (("gaussian", 1.0), ("epanechnikov", 1 / (d + 4))):
        e = np.asarray(mo.resampling.Regularization(name).draw(random.as_key(d), (d, n), jnp.float64))
        assert np.all(np.abs(e.mean(axis=1)) < 5.7 * np.sqrt(variance / n))
        off = np.einsum("in,jn->ijn", e, e)
        assert np.all(np.abs(off.mean(axis=-1) - variance * np.eye(d)) < 5.7 * off.std(axis=-1) / np.sqrt(n))
    # in the ball E r^4 = d (d + 2) / ((d + 4) (d + 6)) tells the law of the radius
    r4 = np.sum(e**2, axis=0) ** 2
    assert np.sum(e**2, axis=0).max() < 1
    assert abs(r4.mean() - d * (d + 2) / ((d + 4) * (d + 6))) < 5.7 * r4.std() / np.sqrt(n)


@pytest.mark.parametrize("kernel", ["gaussian", "epanechnikov"])
def test_shrinking_keeps_the_covariance(kernel, double):
    rng = np.random.default_rng(0)
    X = jnp.asarray(np.stack([rng.gamma(1.0, size=50_000), rng.normal(size=50_000)]))
    X = X.at[1].add(0.7 * X[0])
    cloud = mo.laws.Cloud.equal(X)
    cov = np.asarray(cloud.cov())

    def grown(shrink):
        smooth = mo.resampling.Regularization(kernel, scale=4.0, shrink=shrink).fitted(cloud.log_weights, X)
        return np.asarray(mo.laws.Cloud.equal(smooth(random.as_key(1), X)).cov()) / cov

    h = mo.resampling.Regularization(kernel, scale=4.0).bandwidth(2, 50_000)
    within = h**2 if kernel == "gaussian" else h**2 / 6
    assert within > 0.1
    assert np.allclose(grown(True), 1, atol=0.03)
    assert np.allclose(grown(False), 1 + within, atol=0.03 * (1 + within))
    nothing = mo.resampling.Regularization(kernel).fitted(cloud.log_weights, X, jnp.asarray(False))
    assert np.array_equal(nothing(random.as_key(1), X), X)


def slow():
    """Two states with little process noise, one of them seen: clouds are poor without regularization."""
    return mo.StateSpaceModel(
        mo.Gaussian([1.0, -0.5], [[2.0, 0.4], [0.4, 1.0]]), mo.LinearGaussian([[0.9, 0.3], [-0.1, 0.9]], [[0.02, 0.01], [0.01, 0.03]]),
        mo.LinearGaussian([[1.0, 0.2]], [[0.3]]),
    )  # fmt: skip


def averages(filter, ys, runs=60):
    """Mean over runs of filtered means `(t, x)`, of variances `(t, x)`, and standard errors of both."""
    model = slow()
    keys = jax.random.split(jax.random.key(5), runs)
    found = jax.jit(jax.vmap(lambda key: (lambda h: (h.mean, jnp.diagonal(h.cov, axis1=1, axis2=2)))(mo.run(key, filter, model, ys))))(keys)
    return [(np.asarray(part).mean(axis=0), np.asarray(part).std(axis=0, ddof=1) / np.sqrt(runs)) for part in found]


@pytest.fixture
def case(double):
    ys = np.array(mo.simulate(1, slow(), 10)[1])
    ys[6] = np.nan
    exact = mo.run(0, mo.KalmanFilter(), slow(), ys)
    return ys, np.asarray(exact.mean), np.diagonal(np.asarray(exact.cov), axis1=1, axis2=2)


FORMS = {
    "post": mo.resampling.Regularization(shrink=True),
    "pre": mo.resampling.Regularization("epanechnikov", shrink=True),
    "metropolis": mo.resampling.Regularization(scale=3.0),
}


@pytest.mark.parametrize(("form", "regularization"), [
    pytest.param(*form, id=form[0], marks=[pytest.mark.night] * (form[0] != "post")) for form in FORMS.items()])
def test_agrees_with_the_kalman_filter(case, form, regularization):
    ys, mean, variance = case
    filter = mo.RegularizedParticleFilter(n=1500, regularization=regularization, form=form, policy=mo.resampling.Always())
    (means, error), (variances, error_of_variances) = averages(filter, ys)
    # beside the standard errors (level 1e-6 over forty numbers), a bias of order 1/n
    assert np.all(np.abs(means - mean) < 5.6 * error + 4e-3 * np.sqrt(variance))
    assert np.all(np.abs(variances - variance) < 5.6 * error_of_variances + 2e-2 * variance)


def test_metropolis_alone_takes_no_bias_from_a_wide_kernel(case):
    ys, _, variance = case
    wide = mo.resampling.Regularization(scale=3.0)
    (_, _), (kept, _) = averages(
        mo.RegularizedParticleFilter(n=1000, regularization=wide, form="metropolis", policy=mo.resampling.Always()), ys, 30
    )
    (_, _), (grown, _) = averages(mo.RegularizedParticleFilter(n=1000, regularization=wide, policy=mo.resampling.Always()), ys, 30)
    assert np.all(np.abs(kept[3:] / variance[3:] - 1) < 0.1)
    assert np.all(grown[3:] / variance[3:] > 1.3)


def test_metropolis_moves_particles_and_only_where_there_is_noise():
    def different(Q):
        model = mo.StateSpaceModel(slow().initial, mo.LinearGaussian(np.eye(2), Q), slow().sensor)
        ys = np.array([[0.3], [0.5]])
        parameters = {"n": 400, "policy": mo.resampling.Always()}
        filters = mo.ParticleFilter(**parameters), mo.RegularizedParticleFilter(**parameters, form="metropolis")
        plain, moved = (mo.run(0, filter, model, ys).state.particles for filter in filters)
        return float(np.mean(np.any(np.asarray(plain) != np.asarray(moved), axis=0)))

    assert different(np.diag([0.5, 0.4])) > 0.3
    assert different(np.diag([0.5, 0.0])) == 0


@pytest.mark.night
def test_a_marginalized_filter_takes_it_too(double):
    """Without process noise in the particle part, resampling leaves few values; a kernel makes all different, the Kalman answer stays."""
    model = mo.StateSpaceModel(
        mo.Gaussian([0.5, 0.0], np.diag([1.0, 1.0])), mo.LinearGaussian([[1.0, 0.0], [0.2, 0.9]], np.diag([0.0, 0.2])),
        mo.LinearGaussian([[0.7, 1.0]], [[0.3]]),
    )  # fmt: skip
    ys = mo.simulate(2, model, 12)[1]
    exact = mo.run(0, mo.KalmanFilter(), model, ys)
    parameters = {"n": 4000, "linear": ("x1",), "policy": mo.resampling.ESS(0.9)}
    plain = mo.run(1, mo.MarginalizedParticleFilter(**parameters), model, ys)
    smooth = mo.run(1, mo.MarginalizedParticleFilter(**parameters, regularization=mo.resampling.Regularization(shrink=True)), model, ys)
    assert len(np.unique(np.asarray(plain.state.particles))) < 0.7 * 4000
    assert len(np.unique(np.asarray(smooth.state.particles))) == 4000
    assert np.all(np.abs(smooth.mean - exact.mean)[-1] < 0.1 * np.sqrt(np.diag(np.asarray(exact.cov)[-1])))
