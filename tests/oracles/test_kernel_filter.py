"""The Kalman-particle kernel filter against the Kalman filter, a grid, and the moments that its resampling must keep."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import motes as mo
from motes.core import random
from motes.gaussian.sigma_points import regressed_on, unscaled
from oracles.test_linear_gaussian import four_states
from tiers import each

REPEATS = 2000


@pytest.mark.parametrize("slope", each(["sigma", "jacobian"], {"sigma"}))
def test_equals_the_kalman_filter_on_linear_models(slope, double):
    _, model = four_states()
    ys = np.array(mo.simulate(3, model, 25)[1])
    ys[4], ys[7, 1] = np.nan, np.nan
    exact = mo.run(0, mo.KalmanFilter(), model, ys)
    history = mo.run(0, mo.KalmanParticleKernelFilter(n=1, spread=1.0, slope=slope), model, ys)
    assert np.abs(history.mean - exact.mean).max() < 1e-9
    assert np.abs(history.cov - exact.cov).max() < 1e-9
    assert abs(float(history.log_likelihood - exact.log_likelihood)) < 1e-9


def uneven_mixture(dtype=float):
    """Forty kernels of three states with unequal, correlated covariances and very unequal weights, one of them zero."""
    rng = np.random.default_rng(4)
    roots = rng.normal(size=(3, 3, 40)) * np.array([2.0, 0.3, 1.0])[:, None, None]
    covs = np.einsum("ijn,kjn->ikn", roots, roots) + 0.05 * np.eye(3)[..., None]
    weights = rng.exponential(size=40) ** 2
    weights[7] = 0
    means = rng.gamma(1.0, size=(3, 40)) * np.array([3.0, 1.0, 2.0])[:, None]
    return mo.Mixture.of(jnp.asarray(weights, dtype), jnp.asarray(means, dtype), jnp.asarray(covs, dtype))


KERNELS = {
    "split": mo.resampling.SplitKernels(cap=0.3),
    "longest": mo.resampling.SplitKernels(longest=0.4),
    "common": mo.resampling.CommonKernel(guard=1e-3),
}


@pytest.mark.parametrize("kernels", KERNELS.values(), ids=KERNELS)
@pytest.mark.parametrize("policy", [mo.resampling.Entropy(1e-3), mo.resampling.Never()], ids=["full", "partial"])
def test_resampling_keeps_mean_and_covariance(kernels, policy, double):
    """Over 2 000 repetitions within 4.9 standard errors: level 1e-6 for each number."""
    law = uneven_mixture()
    split = kernels.fitted(law, (0, 2))

    def once(key):
        ancestors = mo.resampling.Systematic().ancestors(random.child(key, 0), law.log_weights, 40)
        after = split(random.child(key, 1), law.resampled(ancestors) if policy.needed(law.log_weights) is not False else law)
        return after.mean(), after.cov() + jnp.outer(after.mean(), after.mean()), after.parts.covariance

    means, squares, covs = jax.jit(jax.vmap(once))(jax.random.split(jax.random.key(3), REPEATS))
    for found, wanted in ((means, law.mean()), (squares, law.cov() + jnp.outer(law.mean(), law.mean()))):
        error = np.abs(np.asarray(found.mean(axis=0) - wanted))
        assert np.all(error < 4.9 * np.asarray(found.std(axis=0, ddof=1)) / np.sqrt(REPEATS) + 1e-12)
    assert np.linalg.eigvalsh(np.moveaxis(np.asarray(covs[:20]), -1, 1)).min() > -1e-12
    # kernels are smaller than before, and in the states that are split as small as was asked
    assert np.asarray(covs[0]).trace().mean() < 0.99 * np.asarray(law.parts.covariance).trace().mean()


def test_split_kernels_are_as_small_as_asked(double):
    law = uneven_mixture()
    whole = np.asarray(law.cov())[np.ix_([0, 2], [0, 2])]
    factor = np.linalg.inv(np.linalg.cholesky(whole))

    def widest(law, scale):
        blocks = np.moveaxis(np.asarray(law.parts.covariance), -1, 0)[:, [0, 2]][:, :, [0, 2]]
        return np.linalg.eigvalsh(scale @ blocks @ scale.T).max(axis=1)

    after = mo.resampling.SplitKernels(cap=0.3).fitted(law, (0, 2))(jax.random.key(0), law)
    assert np.allclose(widest(after, factor), np.minimum(widest(law, factor), 0.09), rtol=1e-9)
    after = mo.resampling.SplitKernels(cap=1.0, longest=0.4).fitted(law, (0, 2))(jax.random.key(0), law)
    assert np.all(widest(after, np.eye(2)) <= 0.16 + 1e-9) and widest(law, np.eye(2)).min() > 0.16


def test_the_guard_leaves_kernels_alone(double):
    law = uneven_mixture()
    after = mo.resampling.CommonKernel(guard=0.9).fitted(law, ())(jax.random.key(0), law)
    assert np.array_equal(after.parts.covariance, law.parts.covariance) and np.array_equal(after.parts.center, law.parts.center)


def two_ranges():
    """Two states of which only a distance from the first axis and a skew sum are seen: two modes, mirror images that the prior weighs."""
    def see(x, u, t):
        return jnp.array([jnp.sqrt(1 + x[0] ** 2) + 0.1 * x[1], x[1] + 0.02 * x[0] ** 3])

    return mo.StateSpaceModel(
        mo.Gaussian([0.25, 1.0], [[4.0, 0.3], [0.3, 1.0]]),
        mo.LinearGaussian([[0.98, 0.0], [0.05, 0.9]], [[0.06, 0.0], [0.0, 0.06]]),
        mo.AdditiveGaussian(see, np.diag([0.05, 0.3])),
        ("a", "b"),
    )


@pytest.fixture(scope="module")
def bimodal():
    model = two_ranges()
    ys = np.array(mo.simulate(6, model, 10)[1])
    ys[3, 0], ys[7] = np.nan, np.nan
    # an even number of nodes: none lies between the modes
    return model, ys, mo.run(0, mo.PointMassFilter((-7, -4), (7, 4), (70, 41)), model, ys, keep=mo.keep.laws)


@pytest.mark.parametrize("filter", [
    pytest.param(mo.KalmanParticleKernelFilter(n=3000, spread=1.0, every=4), marks=pytest.mark.night),
    # a slope at the center alone leaves the curvature over a kernel out of account: it needs smaller kernels
    pytest.param(mo.KalmanParticleKernelFilter(n=3000, spread=1.0, every=1, slope="jacobian", kernels=mo.resampling.SplitKernels(cap=0.15)),
                 marks=pytest.mark.night),
    mo.KalmanParticleKernelFilter(n=3000, spread=1.0, every=4, kernels=mo.resampling.CommonKernel(guard=0.05)),
], ids=["sigma", "jacobian", "common"])  # fmt: skip
def test_keeps_both_modes(bimodal, filter):
    model, ys, exact = bimodal
    right = np.sum(np.asarray(exact.law.weights) * (np.asarray(exact.law.particles)[:, 0] > 0), axis=-1)
    assert 0.1 < right[-1] < 0.9
    history = mo.run(1, filter, model, ys, keep=mo.keep.laws)
    parts = history.law.parts
    share = jax.scipy.stats.norm.cdf(parts.center[:, 0] / jnp.sqrt(parts.covariance[:, 0, 0]))
    found = np.sum(np.asarray(history.law.weights) * np.asarray(share), axis=-1)
    assert np.abs(found - right).max() < 0.05
    spread = np.sqrt(np.diagonal(np.asarray(exact.cov), axis1=1, axis2=2))
    assert np.all(np.abs(history.mean - exact.mean) < 0.15 * spread)
    assert np.all(np.abs(np.sqrt(np.diagonal(np.asarray(history.cov), axis1=1, axis2=2)) / spread - 1) < 0.08)
    assert abs(float(history.log_likelihood - exact.log_likelihood)) < 0.2


def test_regression_is_exact_for_second_degree(double):
    """Mean, slope and unexplained variance of x0^2 + 3 x0 x2 - x1 about a Gaussian, by hand."""
    rng = np.random.default_rng(1)
    root = rng.normal(size=(3, 3))
    P, m = root @ root.T, np.array([0.7, -0.4, 1.3])
    sensor = mo.AdditiveGaussian(lambda x, u, t: (x[0] ** 2 + 3 * x[0] * x[2] - x[1])[None], [[0.1]])
    B, K = np.array([[1.0, 1.5], [1.5, 0.0]]), P[np.ix_([0, 2], [0, 2])]
    L = np.linalg.cholesky(K)
    found = regressed_on(sensor, (0, 2), jnp.asarray(m[:, None]), jnp.asarray(L), None, 0)
    c = m[[0, 2]]
    assert np.isclose(found.prediction[0, 0], c @ B @ c + np.trace(B @ K) - m[1])
    assert np.allclose(unscaled(found.scaled_slope, jnp.asarray(L))[0, :, 0], 2 * B @ c)
    # sigma points see the second degree along the columns of L alone: of 2 tr(B K B K) they give the squares of the diagonal of L' B L
    bends = np.diag(L.T @ B @ L)
    assert np.isclose(found.unexplained[0, 0, 0], 3 * np.sum(bends**2) - np.sum(bends) ** 2)


@pytest.mark.night
def test_nonlinear_dynamics_are_linearized_at_each_kernel():
    """Turning states, seen by a range: close to a particle filter with many particles."""
    def turn(x, u, t):
        return jnp.array([0.9 * x[0] + 0.3 * jnp.sin(x[1]), x[1] + 0.1 * jnp.cos(x[0])])

    model = mo.StateSpaceModel(
        mo.Gaussian([1.0, 0.0], [[1.0, 0.2], [0.2, 0.5]]),
        mo.AdditiveGaussian(turn, lambda x, u, t: jnp.diag(jnp.array([0.005, 0.003]) * (1 + 0.5 * jnp.tanh(x[0])))),
        mo.AdditiveGaussian(lambda x, u, t: jnp.stack([x[0] + 0.3 * x[1] ** 2]), [[0.1]]),
    )
    ys = mo.simulate(2, model, 15)[1]
    many = mo.run(0, mo.ParticleFilter(n=100_000), model, ys)
    filter = mo.KalmanParticleKernelFilter(n=1000, spread=1.0, every=2, kernels=mo.resampling.SplitKernels(cap=0.2))
    keys = jax.random.split(jax.random.key(1), 24)
    means = np.asarray(jax.jit(jax.vmap(lambda key: mo.run(key, filter, model, ys).mean))(keys))
    spread = np.sqrt(np.diagonal(np.asarray(many.cov), axis1=1, axis2=2))
    # level 1e-6 over thirty numbers, with the error of the reference and a bias of order 1/n on top
    assert np.all(np.abs(means.mean(axis=0) - many.mean) < 5.5 * means.std(axis=0, ddof=1) / np.sqrt(24) + 0.04 * spread)
    assert np.all(means.std(axis=0) < 0.3 * spread)
