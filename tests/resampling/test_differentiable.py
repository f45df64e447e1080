"""Resampling that derivatives pass through: the exact score, and what transport keeps."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import motes as mo
from tiers import each

YS = np.array([[0.4], [-0.3], [1.9], [0.8]])


def model(a):
    dynamics, sensor = mo.LinearGaussian(jnp.array([[1.0]]) * a, [[0.5]]), mo.LinearGaussian([[1.0]], [[0.3]])
    return mo.StateSpaceModel(mo.Gaussian([0.3], [[1.0]]), dynamics, sensor)


def derivatives(filter, runs):
    """Likelihood estimates over the exact likelihood, and derivatives of their logarithms, `(runs,)` each."""
    exact = float(mo.run(0, mo.KalmanFilter(), model(0.8), YS).log_likelihood)
    score = jax.value_and_grad(lambda a, key: mo.run(key, filter, model(a), YS, keep=mo.keep.nothing).log_likelihood)
    totals, slopes = jax.jit(jax.vmap(lambda key: score(0.8, key)))(jax.random.split(jax.random.key(3), runs))
    return np.exp(np.asarray(totals) - exact), np.asarray(slopes)


@pytest.mark.parametrize("look_ahead", each({"alone": False, "look ahead": True}, {"look ahead"}))
def test_derivative_of_the_likelihood_is_unbiased(look_ahead, double):
    """E[dZ] = dZ within 4 standard errors over 4000 runs of few particles; without the wrapper it is not."""
    kind = mo.AuxiliaryParticleFilter if look_ahead else mo.ParticleFilter
    parameters = {"n": 40, "policy": mo.resampling.Always()} | ({"proposal": mo.OptimalProposal()} if look_ahead else {})
    exact = float(jax.grad(lambda a: mo.run(0, mo.KalmanFilter(), model(a), YS).log_likelihood)(0.8))
    schemes = {True: mo.resampling.StopGradient(mo.resampling.Multinomial())} | ({} if look_ahead else {False: mo.resampling.Multinomial()})
    for kept, scheme in schemes.items():
        ratio, slopes = derivatives(kind(scheme=scheme, **parameters), 4000)
        off = ratio * (slopes - exact)
        assert (abs(off.mean()) < 4 * off.std(ddof=1) / np.sqrt(len(off))) == kept


@pytest.mark.night
def test_values_are_those_of_the_scheme(double):
    plain, wrapped = (
        mo.run(1, mo.ParticleFilter(n=60, scheme=s), model(0.8), YS) for s in (mo.resampling.Systematic(), mo.resampling.StopGradient())
    )
    assert np.allclose(plain.mean, wrapped.mean, atol=1e-12) and np.allclose(plain.log_evidence, wrapped.log_evidence, atol=1e-12)


def cloud(equal=False):
    rng = np.random.default_rng(0)
    X = np.stack([rng.normal(size=60), 50 * rng.gamma(2.0, size=60), np.full(60, 3.0)])
    log_weights = np.zeros(60) if equal else np.where(np.arange(60) % 7 == 3, -np.inf, rng.normal(size=60))
    return mo.laws.Cloud(jnp.asarray(X), jnp.asarray(log_weights - np.log(np.exp(log_weights).sum())), jnp.arange(60, dtype=jnp.int32))


def test_transport_keeps_the_mean_and_the_rows_balance(double):
    before = cloud()
    scheme = mo.resampling.EntropicTransport(entropy=0.1, steps=200)
    shares = np.asarray(scheme.plan(before.log_weights, before.particles))
    assert np.allclose(shares.sum(axis=0), 60 * np.exp(before.log_weights), atol=1e-12)
    assert np.allclose(shares.sum(axis=1), 1, atol=1e-3) and shares.min() >= 0
    after = scheme.resampled(jax.random.key(0), before, None)
    assert np.allclose(after.mean(), before.mean(), rtol=1e-12) and np.allclose(after.log_weights, -np.log(60))
    ratio = np.diag(np.asarray(after.cov()))[:2] / np.diag(np.asarray(before.cov()))[:2]
    assert np.all((ratio > 0.7) & (ratio < 1))


def test_transport_of_equal_weights_goes_to_none(double):
    before = cloud(equal=True)
    far = []
    for entropy in (0.1, 0.01, 0.001):
        after = mo.resampling.EntropicTransport(entropy, 400).resampled(jax.random.key(0), before, None)
        far.append(np.sqrt(np.mean(((after.particles - before.particles) / np.array([[1.0], [70.0], [1.0]])) ** 2)))
    assert far[0] > 2 * far[1] > 8 * far[2] and far[2] < 0.01


@pytest.mark.night
def test_filter_with_transport_has_a_smooth_likelihood(double):
    """The derivative is that of differences: nothing jumps. And it is about that of the Kalman filter."""
    filter = mo.ParticleFilter(n=100, scheme=mo.resampling.EntropicTransport(0.05), policy=mo.resampling.Always())
    value = jax.jit(lambda a: mo.run(2, filter, model(a), YS, keep=mo.keep.nothing).log_likelihood)
    slope = float(jax.jit(jax.grad(value))(0.8))
    assert abs(slope - float(value(0.8 + 1e-5) - value(0.8 - 1e-5)) / 2e-5) < 1e-4 * (1 + abs(slope))
    exact = float(mo.run(0, mo.KalmanFilter(), model(0.8), YS, keep=mo.keep.nothing).log_likelihood)
    assert abs(float(value(0.8)) - exact) < 0.4
