"""Averages along many chains at once, whose errors are what they claim."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.stats import chi2, t

import motes as mo

expectation = mo.montecarlo.chain_expectation
KERNEL = mo.mcmc.DiscreteGibbs((-1, 1))


def test_errors_of_many_chains_are_what_they_claim():
    """500 chains, each of two spins with a coupling and a pull of its own, against the four sums; tests at level 1e-6."""
    couplings, pulls = (jnp.asarray(np.random.default_rng(0).uniform(-1, 1, (2, 500)), jnp.float32))

    def one(key, coupling, pull):
        return expectation(key, lambda x: jnp.append(x, x[0] * x[1]), KERNEL, lambda x: coupling * x[0] * x[1] + pull * x[0], jnp.ones(2),
                           draws=2_000, burn_in=50)  # fmt: skip

    found = jax.jit(jax.vmap(one))(jax.random.split(jax.random.key(1), 500), couplings, pulls)
    points = np.array([[-1, -1], [-1, 1], [1, -1], [1, 1]])
    weights = np.exp(np.outer(couplings, points.prod(axis=1)) + np.outer(pulls, points[:, 0]))
    weights /= weights.sum(axis=1, keepdims=True)
    exact = weights @ np.column_stack([points, points.prod(axis=1)])
    z = (np.asarray(found.value) - exact) / np.asarray(found.error)
    assert np.abs(z).max() < t.isf(0.5e-6 / z.size, 19)
    assert np.abs(z.mean(axis=0)).max() < 4.9 * (19 / 17 / 500) ** 0.5
    # batches of 100 draws are independent: variances of Student's law with 19 degrees of freedom
    low, high = chi2.ppf([0.5e-6, 1 - 0.5e-6], 500) / 500
    assert (low * 19 / 17 * 0.9 < z.var(axis=0)).all() and (z.var(axis=0) < high * 19 / 17 * 1.1).all()
    assert np.all((np.asarray(found.ess) >= 1) & (np.asarray(found.ess) <= 2_000)) and np.median(found.ess) > 500


def test_one_chain_is_printed_and_what_never_moves_has_no_error():
    found = expectation(0, lambda x: x[0], KERNEL, lambda x: 50.0 * x[0], jnp.ones(1), draws=40, burn_in=0)
    assert float(found.value) == 1 and float(found.error) == 0 and float(found.ess) == 40
    with pytest.warns(mo.MotesWarning, match="chain_expectation: not finite"):
        expectation(0, lambda x: jnp.log(-x[0]), KERNEL, lambda x: 50.0 * x[0], jnp.ones(1), draws=40, burn_in=0)
    with pytest.raises(mo.MotesError, match="chain_expectation draws: expected a multiple of 20, got 30"):
        expectation(0, lambda x: x[0], KERNEL, lambda x: 0.0, jnp.ones(1), draws=30)
    with pytest.raises(mo.MotesError, match="chain_expectation function: expected one that gives a number or a vector"):
        expectation(0, lambda x: jnp.eye(2), KERNEL, lambda x: 0.0 * x[0], jnp.ones(1), draws=20)
    with pytest.raises(mo.MotesError, match="DiscreteGibbs position"):
        expectation(0, lambda x: x[0], KERNEL, lambda x: 0.0 * x[0], jnp.zeros(1), draws=20)
