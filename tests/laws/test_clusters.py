"""Clusters of laws: those that are there, and no others."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import motes as mo

CENTERS = np.array([[0.0, 0.0], [10.0, 0.0], [0.0, 3.0]])
SPREADS = np.array([0.5, 2.0, 0.1])
WEIGHTS = np.array([0.5, 0.3, 0.2])


def three(n=3_000, seed=0):
    generator = np.random.default_rng(seed)
    which = generator.choice(3, n, p=WEIGHTS)
    points = CENTERS[which] + SPREADS[which, None] * generator.normal(size=(n, 2))
    return mo.laws.Cloud.equal(jnp.asarray(points.T, jnp.float32))


def test_three_clusters_of_different_widths_are_found():
    found = three().modes(count=5)
    assert found.mean.shape == (5, 2) and found.cov.shape == (5, 2, 2)
    np.testing.assert_allclose(found.weight[:3], WEIGHTS, atol=0.04)
    np.testing.assert_allclose(found.mean[:3], CENTERS, atol=0.3)
    np.testing.assert_allclose(np.sqrt(np.asarray(found.cov)[:3, 0, 0]), SPREADS, rtol=0.25)
    assert found.weight[3:].sum() < 0.02


@pytest.mark.parametrize("size", [1, 2, 6])
@pytest.mark.parametrize("seed", range(5))
def test_one_gaussian_is_one_cluster(size, seed):
    points = np.random.default_rng(seed).normal(size=(size, 2_000)) * np.logspace(-2, 3, size)[:, None]
    cloud = mo.laws.Cloud.equal(jnp.asarray(points, jnp.float32))
    found = cloud.modes()
    assert found.weight[0] > 0.9 and found.weight.sum() == pytest.approx(1, abs=1e-4)


def test_copies_and_weights_of_zero_make_no_clusters():
    cloud = three(300)
    copied = cloud.resampled(jnp.repeat(jnp.arange(150), 5))
    assert np.count_nonzero(np.asarray(copied.modes().weight) > 0.05) == 3
    heavy = jnp.where(cloud.particles[0] > 5, -jnp.inf, cloud.log_weights)
    one_less = mo.laws.Cloud(cloud.particles, heavy - jax.nn.logsumexp(heavy), cloud.ancestors)
    found = one_less.modes()
    assert np.all(np.asarray(found.mean)[np.asarray(found.weight) > 0.05, 0] < 5)


def test_a_gaussian_has_one():
    found = mo.Gaussian(jnp.ones(2), 2 * jnp.eye(2)).modes(count=3)
    assert found.weight.tolist() == [1, 0, 0] and found.mean[0].tolist() == [1, 1]


@pytest.mark.night
def test_filters_keep_them():
    model = mo.textbook.growth()
    _, ys = mo.simulate(0, model, 20)
    for filter in (mo.ParticleFilter(n=500), mo.GaussianSumParticleFilter(n=50, mixands=10)):
        kept = mo.run(1, filter, model, ys, keep=partial(mo.keep.clusters, count=3)).kept
        assert kept["cluster_mean"].shape == (20, 3, 1) and kept["cluster_weight"].shape == (20, 3)
    # the sensor squares the state: both signs are likely at some steps
    history = mo.run(1, mo.ParticleFilter(n=2_000), model, ys, keep=mo.keep.clusters)
    weights, means = np.asarray(history.kept["cluster_weight"]), np.asarray(history.kept["cluster_mean"])[:, :2, 0]
    two = (weights[:, 1] > 0.1) & (weights[:, :2].sum(axis=1) > 0.9)
    assert two.any() and (means[two, 0] * means[two, 1] < 0).any()
    tracking = mo.textbook.radar_tracking()
    _, ys = mo.simulate(0, tracking, 5)
    kept = mo.run(1, mo.MarginalizedParticleFilter(n=200), tracking, ys, keep=mo.keep.clusters).kept
    assert kept["cluster_mean"].shape == (5, 4, 6)
