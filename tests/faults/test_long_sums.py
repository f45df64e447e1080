"""Sums over very many particles in float32: what a law reports of itself is off by far less than its Monte Carlo standard error."""


import jax
import jax.numpy as jnp
import numpy as np
import pytest

import motes as mo
from motes.laws.gaussian import Gaussian
from motes.laws.marginal_cloud import MarginalCloud
from tiers import each

N = 4_012_345
MOST = 100_000_000


def points(x: int, n: int) -> jax.Array:
    return 300 + 5 * jax.random.normal(jax.random.key(0), (x, n))


def uneven(n: int) -> jax.Array:
    weights = jax.random.uniform(jax.random.key(1), (n,)) + 0.5
    return jnp.log(weights) - jnp.log(float(np.asarray(weights).sum(dtype=np.float64)))


def in_double(x: np.ndarray, weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    weights = weights.astype(np.float64) / weights.sum(dtype=np.float64)
    mean = np.stack([row.astype(np.float64) @ weights for row in x])
    off = [row - m for row, m in zip(x, mean, strict=True)]
    return mean, np.array([[(a * weights) @ b for b in off] for a in off])


def shortfall(found: tuple[jax.Array, jax.Array], law: mo.laws.Cloud) -> float:
    """The larger error of a mean and covariance, in Monte Carlo standard errors (of weights that differ little)."""
    n = law.particles.shape[-1]
    mean, cov = in_double(np.asarray(law.particles), np.exp(np.asarray(law.log_weights, np.float64)))
    off = np.abs(np.asarray(found[0]) - mean).max() / (5 / np.sqrt(n))
    return max(off, np.abs(np.asarray(found[1]) - cov).max() / (25 * np.sqrt(2 / n)))


def one_product(law: mo.laws.Cloud) -> tuple[jax.Array, jax.Array]:
    """The textbook's sums, each in one go: what the library did."""
    mean = jnp.matmul(law.particles, law.weights, precision="highest")
    off = law.particles - mean[:, None]
    return mean, jnp.matmul(off * law.weights, off.T, precision="highest")


@pytest.mark.parametrize("engine", each(["jax", "native"], {"native"}))
def test_cloud(engine: str) -> None:
    law = mo.laws.Cloud(points(6, N), uneven(N), jnp.zeros((N,), jnp.int32))
    with mo.engine(engine):
        assert shortfall((law.mean(), law.cov()), law) < 0.1
    assert shortfall(one_product(law), law) > 0.1


def test_what_gaussians_leave() -> None:
    """Sums of covariances over particles: marginalized clouds and mixtures."""
    cov = 1 + jax.random.uniform(jax.random.key(2), (2, 2, N))
    right = np.asarray(cov).mean(axis=-1, dtype=np.float64)
    kalman = Gaussian(jnp.full((2, N), 300.0), cov + jnp.eye(2)[..., None])
    equal = mo.laws.Cloud.equal(jnp.zeros((1, N)))
    marginal = MarginalCloud(equal.particles, kalman, equal.log_weights, equal.ancestors, (0, 1, 2))
    for law in (marginal, mo.Mixture(kalman, equal.log_weights)):
        assert np.abs(np.asarray(law.cov())[-2:, -2:] - right - np.eye(2)).max() < 0.1 * 0.3 / np.sqrt(N)
        np.testing.assert_allclose(np.asarray(law.mean())[-2:], 300, rtol=1e-6)


def test_a_large_ensemble() -> None:
    """Covariances between members: one update of a linear model against its closed form, and against half as many members."""
    n = 2_000_000
    model = mo.StateSpaceModel(
        mo.Gaussian([300.0, 0.0], [[25.0, 10.0], [10.0, 25.0]]),
        mo.LinearGaussian(np.eye(2), np.eye(2)),
        mo.LinearGaussian([[1.0, 0.0]], [[1.0]]),
    )
    law = mo.run(0, mo.EnsembleKalmanFilter(n), model, [[310.0]]).state
    gain = np.array([25, 10]) / 26
    np.testing.assert_allclose(np.asarray(law.mean()), np.array([300, 0]) + 10 * gain, atol=5 * 5 / np.sqrt(n))
    np.testing.assert_allclose(np.asarray(law.cov())[1, 1], 25 - 100 / 26, atol=5 * 25 * np.sqrt(2 / n))


@pytest.mark.night  # 2.4 GB of particles
def test_a_hundred_million() -> None:
    law = mo.laws.Cloud.equal(points(2, MOST))
    assert shortfall((law.mean(), law.cov()), law) < 0.1
