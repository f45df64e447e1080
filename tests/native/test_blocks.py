"""Kernels without a model against exact arithmetic: ancestors, weights, moments, on ordinary and on hostile weights."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from native_tools import needs_compiler

import motes as mo
from motes.core import engine, logspace, random
from motes.filters import alarm
from motes.laws.cloud import weighted_moments
from motes.native import blocks
from tiers import each

pytestmark = needs_compiler


def log_weights(kind, n):
    generator = np.random.default_rng(n)
    with np.errstate(divide="ignore"):
        raw = {
            "mild": generator.normal(size=n), "wild": 30 * generator.normal(size=n), "equal": np.zeros(n),
            "one": np.where(np.arange(n) == n // 3, 0.0, -np.inf), "last": np.where(np.arange(n) == n - 1, 0.0, -np.inf),
            "halves": np.where(np.arange(n) < n // 2, 0.0, -np.inf),
            "gaps": np.where(np.arange(n) % 7 == 3, generator.normal(size=n), -np.inf),
            "steep": -np.arange(n) / 50.0, "tiny tail": np.where(np.arange(n) < 5, 0.0, -30.0),
        }[kind]  # fmt: skip
    return logspace.normalize(jnp.asarray(raw, jnp.float32))[0]


KINDS = ("mild", "wild", "equal", "one", "last", "halves", "gaps", "steep", "tiny tail")


def ancestors(key, weights, policy=mo.resampling.Always()):  # noqa: B008
    with engine.using("native"):
        return jax.jit(lambda key, weights: blocks.ancestors(key, mo.resampling.Systematic(), policy, weights))(key, weights)


@pytest.mark.parametrize("n", each([256, 1000, 1024, 100_000], {"1024"}))
@pytest.mark.parametrize("kind", KINDS)
def test_systematic_ancestors(kind, n):
    """Counts are within one of n w, in order, never of a particle without weight, and those of exact sums."""
    weights = log_weights(kind, n)
    key = random.as_key(n)
    chosen, after = (np.asarray(a) for a in ancestors(key, weights))
    exact = np.exp(np.asarray(weights, np.float64))
    exact /= exact.sum()
    counts = np.bincount(chosen, minlength=n)
    assert chosen.dtype == np.int32 and chosen.shape == (n,) and (np.diff(chosen) >= 0).all() and chosen.min() >= 0
    assert np.abs(counts - n * exact).max() < 1 + 1e-5 * n * exact.max()
    assert (counts[exact == 0] == 0).all() and np.allclose(after, -np.log(n))
    u = float(random.uniform(key, (), jnp.float32))
    wanted = np.searchsorted(np.cumsum(exact) * n, np.arange(n) + u, side="left")
    assert (chosen != wanted).mean() < 2e-3
    assert (chosen != np.asarray(mo.resampling.Systematic().ancestors(key, weights, n))).mean() < 2e-3


@pytest.mark.parametrize("u_seed", range(5))
def test_ancestors_are_unbiased(u_seed):
    """Each particle's count, averaged over 400 draws, is n w within six standard errors of a uniform fraction."""
    n = 300
    weights = log_weights("mild", n)
    keys = jax.random.split(jax.random.key(u_seed), 400)
    with engine.using("native"):
        drawn = jax.vmap(lambda key: blocks.ancestors(key, mo.resampling.Systematic(), mo.resampling.Always(), weights)[0])(keys)
    counts = np.stack([np.bincount(row, minlength=n) for row in np.asarray(drawn)])
    assert np.abs(counts.mean(axis=0) - n * np.exp(np.asarray(weights, np.float64))).max() < 6 * 0.5 / np.sqrt(400)


@pytest.mark.parametrize(
    "policy",
    [mo.resampling.Never(), mo.resampling.ESS(0.5), mo.resampling.ESS(0.05), mo.resampling.Entropy(0.1), mo.resampling.Entropy(3.0)],
)
@pytest.mark.parametrize("kind", ["mild", "steep", "equal"])
def test_policies(kind, policy):
    weights = log_weights(kind, 5000)
    chosen, after = ancestors(random.as_key(0), weights, policy)
    if bool(policy.needed(weights)):
        assert np.allclose(after, -np.log(5000)) and kind != "equal"
    else:
        assert np.array_equal(chosen, np.arange(5000)) and np.array_equal(after, weights)


@pytest.mark.parametrize("n", [300, 5000, 300_000])
def test_weighing(n):
    generator = np.random.default_rng(n)
    before = log_weights("mild", n)
    cases = [
        generator.normal(size=n) * 3, np.where(np.arange(n) % 3 == 0, np.nan, generator.normal(size=n) - 1e4), np.full(n, -np.inf),
        np.where(np.arange(n) == 17, np.inf, 0.0), np.full(n, -3e9), np.full(n, np.nan), np.where(np.arange(n) < n - 1, -np.inf, -5.0),
    ]  # fmt: skip
    for max_log_likelihood in (jnp.inf, 3.0, np.abs(generator.normal(size=n)) * 10):
        for values in cases:
            given = (before, jnp.asarray(values, jnp.float32), jnp.asarray(max_log_likelihood, jnp.float32))
            wanted, found = logspace.joint_weights(*given)
            with engine.using("native"):
                ours, numbers = logspace.joint_weights(*given)
            assert np.allclose(numbers, found, rtol=1e-4, equal_nan=True), (numbers, found)
            if np.isfinite(found[0]):
                assert np.allclose(ours, wanted, atol=1e-4 + 1e-6 * abs(float(found[0])))


@pytest.mark.parametrize("n", [300, 5000, 300_000])
@pytest.mark.parametrize("sizes", [(1,), (6,), (2, 4), (0, 3), (15, 5)])
def test_moments(n, sizes):
    """Against sums in double precision, with a large common offset and weights that vanish."""
    generator = np.random.default_rng(0)
    parts = [(generator.normal(size=(size, n)) * 3 + 1000).astype(np.float32) for size in sizes]
    weights = log_weights("gaps", n)
    with engine.using("native"):
        mean, cov = weighted_moments(weights, *map(jnp.asarray, parts))
    points, exact = np.concatenate(parts).astype(np.float64), np.exp(np.asarray(weights, np.float64))
    exact /= exact.sum()
    center = points @ exact
    off = points - center[:, None]
    assert np.allclose(mean, center, atol=3e-4) and np.allclose(cov, (off * exact) @ off.T, atol=2e-3)
    assert np.array_equal(cov, np.asarray(cov).T)


SENSORS = {
    "one": (1, (), ()), "radar": (2, (1,), ()), "four": (4, (0, 2), ()), "missing": (3, (0,), (1,)), "nothing": (2, (1,), (0, 1)),
}  # fmt: skip


def predictions(kind, m=134):
    """Return the angles of a sensor, m predictions of it, some of them no numbers, their covariance, log weights and a measurement."""
    size, angles, missing = SENSORS[kind]
    draw = np.random.default_rng(size).normal
    root, centers, y = draw(size=(size, size)), draw(size=(size, m)), 2 * draw(size=size)
    centers[list(angles)] += 3  # on both sides of the cut
    centers[0, 3], centers[-1, 5], y[list(missing)] = np.nan, np.inf, np.nan
    given = (centers, root @ root.T + 0.1 * np.eye(size), draw(size=m) - np.log(m), y)
    return angles, [jnp.asarray(array, jnp.float32) for array in given]


@pytest.mark.parametrize("kind", each(list(SENSORS), {"one", "four", "nothing"}))
def test_innovations(kind):
    """The kernel judges a measurement as JAX does, with the derivatives of JAX, and in a batch as alone."""
    angles, given = predictions(kind)
    in_jax = partial(alarm.of_mixture, angles)

    def native(*given):
        return jnp.stack(blocks.innovation(2000, in_jax, angles, *given))

    with engine.using("native"):
        found = jax.jit(native)(*given)
        assert np.allclose(found, jax.jit(in_jax)(*given), rtol=2e-5, atol=1e-6)
        several = jnp.stack([given[3], given[3] + 1])
        assert np.array_equal(jax.vmap(native, (None, None, None, 0))(*given[:3], several)[0], found)
        slope = jax.jacobian(native, 1)(*given)
        assert np.allclose(slope, jnp.stack(jax.jacobian(in_jax, 1)(*given)), rtol=1e-4, atol=1e-4, equal_nan=True)
    assert blocks.innovation(2000, in_jax, angles, given[0], given[1][..., None], *given[2:]) is None


def test_batches_of_runs():
    """Kernels under vmap, also nested and with operands that the batch shares, give what single calls give."""
    weights = jnp.stack([log_weights(kind, 2048) for kind in ("mild", "steep", "gaps")])
    points = jnp.asarray(np.random.default_rng(0).normal(size=(2, 4, 2048)), jnp.float32)
    with engine.using("native"):
        nested = jax.vmap(lambda X: jax.vmap(lambda w: weighted_moments(w, X))(weights))(points)
        for i in range(2):
            for j in range(3):
                single = weighted_moments(weights[j], points[i])
                assert np.array_equal(nested[0][i, j], single[0]) and np.array_equal(nested[1][i, j], single[1])


def test_derivatives_of_a_batch_of_runs():
    """The batch axes of a kernel's results and of the JAX operation that gives its derivatives differ by themselves."""

    def score(scale, key):
        sensor = mo.AdditiveGaussian(lambda x, u, t: scale * x**2, [[0.3]])
        model = mo.StateSpaceModel(mo.Gaussian([0.0], [[1.0]]), mo.LinearGaussian([[0.9]], [[0.1]]), sensor)
        return mo.run(key, mo.ParticleFilter(n=300, policy=mo.resampling.Never()), model, np.ones((1, 1))).log_likelihood

    def together(scale):
        return jax.vmap(score, (None, 0))(scale, jax.random.split(jax.random.key(3), 3)).mean()

    with engine.using("jax"):
        wanted = jax.grad(together)(0.7)
    with engine.using("native"):
        assert np.isclose(jax.grad(together)(0.7), wanted, rtol=1e-3) and abs(wanted) > 0.01
