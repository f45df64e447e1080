"""Schemes that keep particles in their places, and conditional forms: exact laws of small cases, and adversarial weights."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.stats import chi2_contingency, norm

import motes as mo
from tiers import each

LEVEL = 1e-6
WEIGHTS = np.array([0.02, 0.3, 0.05, 0.001, 0.1, 0.2, 0.004, 0.075, 0.05, 0.2])
EXACT = [mo.resampling.Killing(), mo.resampling.RejectionResampling(trials=2), mo.resampling.RejectionResampling()]
DRAWS = 10_000


def log(weights):
    return jnp.log(jnp.asarray(weights, jnp.float32) / np.sum(weights))


def counted(scheme, weights, n):
    keys = jax.random.split(jax.random.key(1), DRAWS)
    drawn = np.asarray(jax.jit(jax.vmap(lambda key: scheme.ancestors(key, log(weights), n)))(keys))
    assert drawn.dtype == np.int32 and drawn.shape == (DRAWS, n)
    return drawn, np.stack([np.bincount(row, minlength=len(weights)) for row in drawn])


def check_mean(counts, expected):
    error = np.abs(counts.mean(axis=0) - expected)
    standard_error = counts.std(axis=0, ddof=1) / np.sqrt(len(counts)) + 1e-5
    assert np.all(error < norm.isf(LEVEL / 2 / len(expected)) * standard_error)


@pytest.mark.parametrize("scheme", EXACT, ids=repr)
@pytest.mark.parametrize("n", each([10, 7], {"10"}))
def test_counts_are_unbiased_and_the_heaviest_stays(scheme, n):
    drawn, counts = counted(scheme, WEIGHTS, n)
    check_mean(counts, n * WEIGHTS / WEIGHTS.sum())
    assert n != len(WEIGHTS) or np.all(drawn[:, 1] == 1)


@pytest.mark.parametrize("steps", [1, 6])
def test_metropolis_has_the_law_of_its_chain(steps):
    """Mean counts are those of the matrix of the chain to this power, and the bias is within the documented bound."""
    w, n = WEIGHTS / WEIGHTS.sum(), len(WEIGHTS)
    moves = np.minimum(1, w[None, :] / w[:, None]) / n
    chain = moves - np.diag(moves.sum(axis=1)) + np.eye(n)
    law = np.linalg.matrix_power(chain, steps)
    check_mean(counted(mo.resampling.MetropolisResampling(steps), w, n)[1], law.sum(axis=0))
    assert np.all(0.5 * np.abs(law - w).sum(axis=1) <= (1 - w.mean() / w.max()) ** steps)


@pytest.mark.parametrize("n", each([1, 2, 3, 5], {"1", "2", "3"}))
@pytest.mark.parametrize("scheme", [*EXACT, mo.resampling.MetropolisResampling(400)], ids=repr)
def test_very_few_and_very_uneven(scheme, n):
    draw = jax.jit(scheme.ancestors, static_argnums=2)
    last = np.asarray(draw(jax.random.key(0), log((np.arange(n) == n - 1).astype(float)), n))
    assert np.all(last == n - 1)
    tiny = np.asarray(draw(jax.random.key(0), jnp.full((n,), -80.0).at[0].set(0.0), n))
    assert np.all(tiny == 0)
    wide = np.asarray(draw(jax.random.key(3), log(np.r_[0.0, np.ones(n)]), n))
    assert np.all((wide > 0) & (wide <= n))


@pytest.mark.parametrize("scheme", [mo.resampling.Multinomial(), mo.resampling.Systematic(), mo.resampling.Killing()], ids=repr)
def test_conditional_law_is_that_of_the_turned_scheme(scheme):
    """All ancestors of three children, that of one drawn by weight, against the scheme turned at random: chi-square, level 1e-6."""
    weights, draws, slot = np.array([0.15, 0.6, 0.25]), 40_000, 1

    def both(key):
        keys = jax.random.split(key, 4)
        drawn = scheme.ancestors(keys[0], log(weights), 3)
        shuffled = isinstance(scheme, mo.resampling.Multinomial)
        turned = jax.random.permutation(keys[1], drawn) if shuffled else jnp.roll(drawn, jax.random.randint(keys[1], (), 0, 3))
        fixed = jax.random.categorical(keys[2], log(weights))
        given = scheme.conditional_ancestors(keys[3], log(weights), fixed, slot)
        return turned, given, fixed

    turned, given, fixed = (np.asarray(part) for part in jax.jit(jax.vmap(both))(jax.random.split(jax.random.key(5), draws)))
    assert np.array_equal(given[:, slot], fixed) and given.dtype == np.int32
    table = np.stack([np.bincount(part @ [9, 3, 1], minlength=27) for part in (turned, given)])
    assert chi2_contingency(table[:, table.sum(axis=0) > 0]).pvalue > LEVEL


def test_conditional_systematic_of_many():
    weights = np.random.default_rng(0).exponential(size=4000)
    draw = jax.jit(lambda key, fixed: mo.resampling.Systematic().conditional_ancestors(key, log(weights), fixed, 0))
    for fixed in (0, 17, 3999):
        found = np.asarray(draw(jax.random.key(fixed), fixed))
        counts = np.bincount(found, minlength=4000)
        assert found[0] == fixed and np.abs(counts - 4000 * weights / weights.sum()).max() < 1.01
    with pytest.raises(mo.MotesError, match="conditional_ancestors: expected Multinomial, Systematic or Killing, got Stratified"):
        mo.resampling.Stratified().conditional_ancestors(jax.random.key(0), log(weights), 0)


@pytest.mark.parametrize(
    "scheme",
    [mo.resampling.SSP(), mo.resampling.Killing(), mo.resampling.MetropolisResampling(64), mo.resampling.RejectionResampling()],
    ids=repr,
)
def test_filters_run_with_them(scheme):
    """Means of a filter within six standard errors of the exact ones (one run of 4000 particles)."""
    model = mo.StateSpaceModel(mo.Gaussian([0.3], [[1.0]]), mo.LinearGaussian([[0.8]], [[0.5]]), mo.LinearGaussian([[1.0]], [[0.3]]))
    ys = mo.simulate(1, model, 6)[1]
    exact = mo.run(0, mo.KalmanFilter(), model, ys)
    found = mo.run(0, mo.ParticleFilter(n=4000, scheme=scheme), model, ys)
    assert np.abs((found.mean - exact.mean)[:, 0]).max() < 6 * np.sqrt(float(np.max(exact.cov)) / 1000)
