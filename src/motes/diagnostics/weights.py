"""What weights and ancestors tell of a run."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from motes.core import checks
from motes.filters.history import History

TRUSTED = 0.7
"""Averages under weights with a Pareto-k above this have errors that more particles hardly lower (Vehtari et al. 2024)."""


def pareto_k(log_weights: jax.Array) -> jax.Array:
    """Shape k of the generalized Pareto law that fits the largest weights, `()`, from log weights `(n,)` that need not be normalized.

    Moments of the weights of order 1 / k and more do not exist: below 0.5 their variance does; above `TRUSTED` averages are not reliable.
    The fit is that of Zhang and Stephens (2009) to the largest min(n / 5, 3 sqrt(n)) weights, drawn a little towards 0.5 as in Pareto
    smoothed importance sampling. Weights of zero do not count as large ones. NaN for fewer than 25 weights, or fewer than 5 large ones;
    minus infinity where the largest weights are all equal.
    """
    n = log_weights.shape[0]
    count = int(min(n / 5, 3 * n**0.5))
    if count < 5:
        return jnp.full((), jnp.nan, log_weights.dtype)
    top = jnp.sort(log_weights)[n - count - 1 :]
    # where zeros reach into the tail it begins at the least weight that is none
    enough = top[0] > -jnp.inf
    edge = jnp.where(enough, top[0], jnp.min(jnp.where(top > -jnp.inf, top, jnp.inf)))
    counts = jnp.where(enough, True, top[1:] > edge)
    # relative to the largest, so that nothing overflows
    excess = jnp.exp(top[1:] - top[-1]) - jnp.exp(edge - top[-1])
    k = jnp.where(jnp.sum(counts) < 5, jnp.nan, _zhang_stephens(excess, counts))
    return jnp.where(top[-1] > edge, k, jnp.where(top[-1] > -jnp.inf, -jnp.inf, jnp.nan))


def _zhang_stephens(x: jax.Array, counts: jax.Array) -> jax.Array:
    """Shape of the generalized Pareto law of x `(m,)`, sorted and positive, averaged over the likelihood of b in k = mean log(1 - b x).

    Only those that count do, which are the last.
    """
    m = jnp.sum(counts).astype(x.dtype)
    x = jnp.where(counts, jnp.maximum(x, jnp.finfo(x.dtype).tiny), 0)
    grid = 30 + int(x.shape[0] ** 0.5)
    quartile = x[x.shape[0] - jnp.sum(counts) + jnp.floor(m / 4 + 0.5).astype(jnp.int32) - 1]
    b = 1 / x[-1] + (1 - jnp.sqrt(grid / (jnp.arange(grid) + 0.5))) / (3 * quartile)
    k = jnp.sum(jnp.log1p(-b[:, None] * x), axis=1) / m
    log_likelihood = m * (jnp.log(-b / k) - k - 1)
    weights = jax.nn.softmax(jnp.where(jnp.isnan(log_likelihood), -jnp.inf, log_likelihood))
    fitted = jnp.sum(jnp.log1p(-jnp.sum(weights * b) * x)) / m
    return (fitted * m + 5) / (m + 10)


def first_ancestors(history: History) -> jax.Array:
    """Index of the particle at the first step from which each particle of the last descends, `(n,)`.

    Raises:
        MotesError: laws were not kept, or have no ancestors.
    """
    ancestors = _ancestors("first_ancestors", history)
    everyone = jnp.arange(ancestors.shape[1], dtype=jnp.int32)
    return jax.lax.scan(lambda own, before: (before[own], None), everyone, ancestors[1:], reverse=True)[0]


def surviving_ancestors(history: History, lag: int) -> np.ndarray:
    """Number of different particles `lag` steps before from which those of each step descend, `(t - lag,)`.

    Raises:
        MotesError: laws were not kept, have no ancestors, or the run is not longer than the lag.
    """
    parents = np.asarray(_ancestors("surviving_ancestors", history))
    checks.positive_integer("surviving_ancestors lag", lag)
    if len(parents) <= lag:
        checks.refuse("surviving_ancestors lag", f"less than the {len(parents)} steps of the run", lag)
    found = []
    for t in range(lag, len(parents)):
        own = np.unique(parents[t])
        for back in range(1, lag):
            own = np.unique(parents[t - back][own])
        found.append(own.size)
    return np.array(found)


def _ancestors(asked_by: str, history: History) -> jax.Array:
    ancestors = getattr(history.law, "ancestors", None)
    if ancestors is None:
        checks.refuse(f"{asked_by} history", "laws with ancestors", type(history.state).__name__)
    return ancestors


class LikelihoodVariance(NamedTuple):
    """How sure a run is of its log likelihood.

    Attributes:
        variance: of the log likelihood over runs with other keys.
        first_ancestors: number of particles of the first step that have descendants in the last; below some 20 the estimate is too low.
    """

    variance: float
    first_ancestors: int


def log_likelihood_variance(history: History) -> LikelihoodVariance:
    """Estimate from one run how much the log likelihood would vary over runs (Lee, Whiteley 2018, equation 5).

    With F_i the weight of all particles of the last step that descend from particle i of the first, and r steps that resampled, it is
    1 - (n / (n - 1))^(r + 1) (1 - sum F_i^2), which may come out a little below zero. Laws must be kept.

    Raises:
        MotesError: laws were not kept, have no ancestors, or were not resampled by `Multinomial`, or the run does not start at step 0.
    """
    if int(history.start) != 0:
        checks.refuse("log_likelihood_variance history", "a run from step 0", f"one from step {int(history.start)}", "Join its pieces.")
    first = np.asarray(first_ancestors(history))
    if "scheme=Multinomial()" not in history.label:
        checks.refuse("log_likelihood_variance history", "a filter with scheme=Multinomial()", history.label,
                      "Other schemes give families that tell less of the variance.")
    n = first.size
    resampled = int(np.any(np.asarray(history.law.ancestors[1:]) != np.arange(n), axis=1).sum())
    families = np.bincount(first, np.exp(np.asarray(history.state.log_weights, np.float64)), minlength=n)
    variance = 1 - (n / max(n - 1, 1)) ** (resampled + 1) * (1 - float(np.sum(families**2)))
    return LikelihoodVariance(variance, int(np.unique(first).size))
