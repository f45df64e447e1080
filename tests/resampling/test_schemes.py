"""Resampling: exact properties for adversarial weights, and unbiased counts."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import norm

import motes as mo

SCHEMES = [
    mo.resampling.Systematic(),
    mo.resampling.Stratified(),
    mo.resampling.Residual(),
    mo.resampling.Multinomial(),
    mo.resampling.SSP(),
]
SYSTEMATIC = jax.jit(mo.resampling.Systematic().at, static_argnums=2)
LAST_UNIFORM = np.float32(1 - 2**-24)
SIZE = 400


def by_name(scheme):
    return type(scheme).__name__


def log(weights):
    return jnp.log(jnp.asarray(weights / weights.sum(), jnp.float32))


def adversarial(n, kind, seed=0):
    rng = np.random.default_rng(seed)
    weights = {
        "equal": np.ones(n),
        "one heavy in front": np.r_[0.7 * n, np.ones(n - 1)],
        "one heavy at the end": np.r_[np.ones(n - 1), 0.7 * n],
        "one heavy inside": np.where(np.arange(n) == n // 3, 3.0 * n, 1.0),
        "denormal": np.full(n, 1e-42),
        "zeros at both ends": np.where((np.arange(n) < n // 4) | (np.arange(n) > n // 2), 0.0, rng.exponential(size=n)),
        "all on one": (np.arange(n) == n - 2).astype(float),
        "wide range": np.exp(rng.normal(size=n) * 8),
        "exponential": rng.exponential(size=n),
    }[kind]
    return weights


KINDS = ["equal", "one heavy in front", "one heavy at the end", "one heavy inside", "denormal", "zeros at both ends", "all on one",
         "wide range", "exponential"]  # fmt: skip


@pytest.mark.parametrize("n", [1, 2, 3])
@pytest.mark.parametrize("u", [0.0, LAST_UNIFORM, 0.37])
def test_systematic_counts_of_very_few(n, u):
    log_weights = log(adversarial(n, "exponential"))
    check_counts(np.asarray(mo.resampling.Systematic().at(jnp.float32(u), log_weights, n)), np.exp(np.asarray(log_weights, np.float64)))


def check_counts(ancestors, weights, tolerance=1e-3):
    n = len(ancestors)
    assert ancestors.dtype == np.int32
    assert np.all(np.diff(ancestors) >= 0) and ancestors[0] >= 0 and ancestors[-1] < len(weights)
    expected = n * weights.astype(np.float64) / weights.astype(np.float64).sum()
    # float32 cannot hold n w better than its own last place
    slack = tolerance + 4e-7 * expected
    error = np.abs(np.bincount(ancestors, minlength=len(weights)) - expected)
    assert np.all(error < 1 + slack), (error.max(), expected[error.argmax()])
    assert np.all(weights[ancestors] > 0)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("u", [0.0, LAST_UNIFORM, 0.37])
@pytest.mark.parametrize("n", [4, 1023, 1025, 100_000])
def test_systematic_counts_are_within_one(kind, u, n):
    log_weights = log(adversarial(n, kind))
    weights = np.exp(np.asarray(log_weights, np.float64))
    check_counts(np.asarray(SYSTEMATIC(jnp.float32(u), log_weights, n)), weights)


@pytest.mark.parametrize(("kind", "u"), [
    pytest.param("one heavy inside", LAST_UNIFORM, marks=pytest.mark.night), ("exponential", 0.0)])  # fmt: skip
def test_systematic_holds_for_ten_million_particles(kind, u):
    """N9: float32 cumulative sums are neither monotone nor right at this size."""
    n = 10_000_000
    log_weights = log(adversarial(n, kind))
    weights = np.exp(np.asarray(log_weights, np.float64))
    check_counts(np.asarray(SYSTEMATIC(jnp.float32(u), log_weights, n)), weights, tolerance=0.02)


@given(
    weights=st.lists(st.floats(0, 1e6, allow_subnormal=False, width=32), min_size=1, max_size=60).filter(lambda w: sum(w) > 1e-3),
    u=st.floats(0, float(LAST_UNIFORM), width=32),
    n=st.sampled_from([1, 7, 200]),
)
@settings(max_examples=120, deadline=None)
def test_systematic_counts_are_within_one_for_any_weights(weights, u, n):
    log_weights = log(np.pad(np.asarray(weights, np.float64), (0, 60 - len(weights))))
    ancestors = np.asarray(SYSTEMATIC(jnp.float32(u), log_weights, n))
    check_counts(ancestors, np.exp(np.asarray(log_weights, np.float64)))


@pytest.mark.parametrize("scheme", SCHEMES, ids=by_name)
@pytest.mark.parametrize("kind", KINDS)
def test_indices_are_in_order_and_in_range(scheme, kind):
    log_weights = log(adversarial(SIZE, kind))
    ancestors = np.asarray(jax.jit(scheme.ancestors, static_argnums=2)(jax.random.key(0), log_weights, 150))
    assert ancestors.shape == (150,) and ancestors.dtype == np.int32
    assert np.all(np.diff(ancestors) >= 0) and np.all(np.exp(np.asarray(log_weights))[ancestors] > 0)


@pytest.mark.parametrize("scheme", SCHEMES, ids=by_name)
def test_mean_counts_are_unbiased(scheme):
    """Mean counts over 20 000 draws within the critical value of level 1e-6 for all 12 particles together."""
    weights = np.array([0.02, 0.3, 0.05, 0.001, 0.1, 0.2, 0.004, 0.075, 0.05, 0.11, 0.03, 0.06])
    weights /= weights.sum()
    n, draws = 15, 20_000
    keys = jax.random.split(jax.random.key(1), draws)
    ancestors = jax.jit(jax.vmap(lambda key: scheme.ancestors(key, jnp.log(jnp.asarray(weights, jnp.float32)), n)))(keys)
    counts = np.stack([np.bincount(row, minlength=12) for row in np.asarray(ancestors)])
    error = counts.mean(axis=0) - n * weights
    standard_error = counts.std(axis=0, ddof=1) / np.sqrt(draws) + 1e-6
    assert np.all(np.abs(error) < norm.isf(1e-6 / 24) * standard_error)
    assert np.all(counts.sum(axis=1) == n)


@pytest.mark.parametrize("kind", KINDS)
def test_counts_of_the_sampling_process_are_within_one(kind):
    draw = jax.jit(mo.resampling.SSP().ancestors, static_argnums=2)
    for n in (1, 2, 3, 5, 4096):
        log_weights = log(adversarial(max(n, 3), kind))
        check_counts(np.asarray(draw(jax.random.key(n), log_weights, n)), np.exp(np.asarray(log_weights, np.float64)))


def test_variance_of_counts_falls_from_multinomial_to_systematic():
    weights = np.random.default_rng(3).exponential(size=50)
    log_weights = log(weights)
    keys = jax.random.split(jax.random.key(1), 4000)
    spread = {}
    for scheme in SCHEMES:
        ancestors = jax.jit(jax.vmap(lambda key, scheme=scheme: scheme.ancestors(key, log_weights, 50)))(keys)
        spread[by_name(scheme)] = np.stack([np.bincount(row, minlength=50) for row in np.asarray(ancestors)]).var(axis=0).sum()
    assert spread["Multinomial"] > spread["Residual"] > spread["Systematic"]
    assert spread["Multinomial"] > spread["Stratified"] and spread["Residual"] > spread["SSP"]


def test_policies():
    equal = jnp.log(jnp.full(8, 1 / 8))
    one = jnp.where(jnp.arange(8) == 2, 0.0, -jnp.inf)
    assert mo.resampling.Always().needed(equal) is True and mo.resampling.Never().needed(one) is False
    for policy in (mo.resampling.ESS(0.5), mo.resampling.Entropy(0.7)):
        assert not bool(policy.needed(equal)) and bool(policy.needed(one))
    half = jnp.log(jnp.where(jnp.arange(8) < 4, 1 / 4, 0.0))
    assert bool(mo.resampling.Entropy(np.log(2) - 0.01).needed(half)) and not bool(mo.resampling.Entropy(np.log(2) + 0.01).needed(half))
    for bad in (lambda: mo.resampling.ESS(0.0), lambda: mo.resampling.ESS(1.5), lambda: mo.resampling.Entropy(-1.0)):
        with pytest.raises(mo.MotesError, match="expected a number above 0"):
            bad()


def test_sorted_picks_by_weight_in_the_order_of_a_state():
    particles = jnp.stack([jnp.array([3.0, -1.0, 2.0, 0.5]), jnp.arange(4.0)])
    weights = np.array([0.1, 0.4, 0.15, 0.35])
    cloud = mo.laws.Cloud(particles, jnp.log(jnp.asarray(weights)), jnp.arange(4, dtype=jnp.int32))
    keys = jax.random.split(jax.random.key(0), 4_000)
    drawn = jax.vmap(lambda key: mo.resampling.Sorted().resampled(key, cloud, None))(keys)
    counts = np.apply_along_axis(np.bincount, 1, np.asarray(drawn.ancestors), minlength=4)
    assert (np.abs(counts - 4 * weights) < 1 + 1e-5).all()
    assert (np.abs(counts.mean(axis=0) - 4 * weights) < 4.9 * counts.std(axis=0) / len(keys) ** 0.5 + 1e-6).all()
    assert (np.diff(np.asarray(drawn.particles)[:, 0], axis=1) >= 0).all()
    scored = mo.resampling.Sorted().resampled(keys[0], cloud, jnp.log(jnp.full(4, 0.25)))
    np.testing.assert_allclose(scored.log_weights, np.log(weights)[np.asarray(scored.ancestors)], rtol=1e-5)
    with pytest.raises(mo.MotesError, match="Sorted scheme: expected a scheme"):
        mo.resampling.Sorted(3)
    with pytest.raises(mo.MotesError, match="Sorted by: expected a law of particles with a state 2, got 2 states in particles"):
        mo.resampling.Sorted(by=2).resampled(keys[0], cloud, None)
