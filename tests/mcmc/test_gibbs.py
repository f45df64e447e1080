"""The Gibbs sampler on a law whose conditionals are known."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import motes as mo
from motes.core import random

mcmc = mo.mcmc

# precision tau ~ Gamma(3), mean mu ~ N(1, 2^2), four data y ~ N(mu, 1 / tau)
DATA = jnp.array([0.3, 1.9, 2.4, 3.0])


def log_density(p):
    mu, log_tau = p["mu"], jnp.log(p["tau"])
    return -((mu - 1) ** 2) / 8 + 2 * log_tau - p["tau"] + 2 * log_tau - 0.5 * p["tau"] * jnp.sum((DATA - mu) ** 2)


def draw_mu(key, p):
    precision = 0.25 + 4 * p["tau"]
    return (0.25 + p["tau"] * DATA.sum()) / precision + jax.random.normal(key) / jnp.sqrt(precision)


def draw_tau(key, p):
    return jax.random.gamma(key, 5.0) / (1 + 0.5 * jnp.sum((DATA - p["mu"]) ** 2))


def exact():
    """Mean of mu and of tau on a grid."""
    mu, tau = np.meshgrid(np.linspace(-8, 12, 2001), np.linspace(1e-3, 12, 2001), indexing="ij")
    log_p = -((mu - 1) ** 2) / 8 + 4 * np.log(tau) - tau - 0.5 * tau * ((np.asarray(DATA)[:, None, None] - mu) ** 2).sum(0)
    weights = np.exp(log_p - log_p.max())
    weights /= weights.sum()
    return (weights * mu).sum(), (weights * tau).sum(), (weights * (mu > 2)).sum()


@pytest.mark.parametrize("scan", ["systematic", "random"])
def test_reaches_the_law(scan):
    kernel = mcmc.Gibbs({"mu": draw_mu, "tau": draw_tau}, scan=scan)
    chains = mo.sample(0, kernel, log_density, {"mu": 0.0, "tau": 1.0}, draws=2_000, chains=8)
    mu, tau = (np.asarray(chains.positions[name]) for name in ("mu", "tau"))
    for draws, truth in zip((mu, tau, 1.0 * (mu > 2)), exact(), strict=True):
        assert abs(draws.mean() - truth) < 4.9 * mcmc.standard_error(draws) + 1e-4
    tried = np.asarray(chains.info.tried).sum(axis=0)
    assert tried.tolist() == [16_000, 16_000] if scan == "systematic" else (0 < tried).all() and tried.sum() == 16_000
    np.testing.assert_allclose(chains.log_density[0, -1], log_density(jax.tree.map(lambda leaf: leaf[0, -1], chains.positions)), rtol=1e-5)


@pytest.mark.night
def test_blocks():
    def both(key, p):
        # from the law itself, by importance resampling among many draws of the prior: joint, hence independent draws
        mu, tau = 1 + 2 * jax.random.normal(key, (4_000,)), jax.random.gamma(random.step_key(key, 1), 3.0, (4_000,))
        weights = 2 * jnp.log(tau) - 0.5 * tau * jnp.sum((DATA[:, None] - mu) ** 2, axis=0)
        one = jax.random.categorical(random.step_key(key, 2), weights)
        return {"mu": mu[one], "tau": tau[one]}

    chains = mo.sample(0, mcmc.Gibbs({("mu", "tau"): both}), log_density, {"mu": 0.0, "tau": 1.0}, draws=200, chains=4, burn_in=0)
    assert mcmc.bulk_ess(chains.positions["mu"]) > 600
    mu = np.asarray(chains.positions["mu"])
    assert abs(mu.mean() - exact()[0]) < 4.9 * mcmc.standard_error(mu) + 0.02


def test_a_draw_of_another_shape_is_refused():
    kernel = mcmc.Gibbs({"mu": lambda key, p: jnp.zeros(2)})
    with pytest.raises(mo.MotesError, match=r"Gibbs draws\['mu'\]: expected a value like \(\), got \(2,\)"):
        mo.sample(0, kernel, log_density, {"mu": 0.0, "tau": 1.0})
