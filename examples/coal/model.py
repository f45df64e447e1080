"""Coal-mining disasters: yearly counts whose rate changes at an unknown number of new years."""

from math import lgamma, log

import jax
import jax.numpy as jnp
import numpy as np

import motes as mo

MEAN, MOST = 3.0, 12
"""Of the Poisson prior of the number of changes, cut at the second."""


def log_prior(most=MOST, mean=MEAN):
    """Log probability of each number of changes."""
    shares = np.array([k * log(mean) - mean - lgamma(k + 1) for k in range(most + 1)])
    return shares - np.log(np.exp(shares).sum())


def spans(model):
    """Number of the level of each year, `(n,)`."""
    return jnp.append(0, jnp.cumsum(model))


def problem(counts, most=MOST):
    """Return log density and kernel for yearly counts: jumps between numbers of changes, and rates drawn from their gamma laws."""
    y = jnp.asarray(counts, jnp.float32)
    places = len(counts) - 1
    ways = np.array([lgamma(places + 1) - lgamma(k + 1) - lgamma(places - k + 1) for k in range(most + 1)])
    of_number = jnp.asarray(log_prior(most) - ways)

    def log_density(c):
        rates = c.x[spans(c.model)]
        changes = jnp.sum(c.model)
        prior = of_number[changes] - jnp.sum(jnp.where(jnp.arange(most + 1) <= changes, c.x, 0))
        fits = jnp.sum(jnp.where(y > 0, y * jnp.log(jnp.maximum(rates, 1e-30)), 0) - rates)
        return jnp.where(jnp.min(rates) > 0, prior + fits, -jnp.inf)

    def rates(key, c):
        level = spans(c.model)
        total = jax.ops.segment_sum(y, level, most + 1)
        years = jax.ops.segment_sum(jnp.ones_like(y), level, most + 1)
        drawn = jax.random.gamma(key, 1 + total) / (1 + years)
        return jnp.where(jnp.arange(most + 1) <= jnp.sum(c.model), drawn, 0)

    jumps = mo.mcmc.change_points(most, places, reach=12)
    kernel = mo.mcmc.Cycle([mo.mcmc.ReversibleJump(jumps, lambda model: jnp.sum(model) + 1), mo.mcmc.Gibbs({"x": rates})])
    start = mo.mcmc.Configuration(jnp.zeros(places, jnp.int32), jnp.zeros(most + 1).at[0].set(float(np.mean(counts))))
    return log_density, kernel, start
