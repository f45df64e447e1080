"""Many weighted hypotheses brought down to few without copies (Fearnhead, Clifford 2003).

A copy of a hypothesis that goes on with no noise of its own is wasted. With c such that min(c w_i, 1) sums to n, hypotheses of weight above
1 / c stay with their weights, and the rest is resampled systematically, each at most once, with weight 1 / c. A weight is unchanged on
average and their sum is unchanged; of all such rules this one has the smallest expected squared error of the weights.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from motes.core import logspace, random
from motes.resampling.schemes import ancestors_from_ends, boundaries


class Reduction(NamedTuple):
    """What is left.

    Attributes:
        ancestors: index of each hypothesis kept, `(n,)` int32, non-decreasing.
        log_weights: their log weights, `(n,)`; places beyond the number of hypotheses with weight have minus infinity.
    """

    ancestors: jax.Array
    log_weights: jax.Array


def reduced(key: jax.Array, log_weights: jax.Array, n: int) -> Reduction:
    """Keep at most n of at least n hypotheses, unbiased and none twice; where at most n have weight all of them stay as they are.

    Args:
        key: JAX key.
        log_weights: normalized log weights, n or more of them.
        n: number of places.
    """
    log_threshold = _log_threshold(log_weights, n)
    certain = log_weights > log_threshold
    places = n - jnp.sum(certain, dtype=jnp.int32)
    light = logspace.normalize(jnp.where(certain, -jnp.inf, log_weights))[0]
    edge = boundaries(light, places)  # type: ignore[arg-type]
    u = random.uniform(key, (), log_weights.dtype)
    ends = jax.lax.cummax(edge.whole + jnp.ceil(edge.part - u).astype(jnp.int32))
    drawn = jnp.diff(ends, prepend=0) > 0
    kept = certain | (drawn & jnp.isfinite(light))
    filled = jnp.cumsum(kept.astype(jnp.int32))
    ancestors = ancestors_from_ends(filled, n, jnp.int32(log_weights.shape[0] - 1))
    after = jnp.maximum(log_weights, log_threshold)[ancestors]
    return Reduction(ancestors, jnp.where(jnp.arange(n) < filled[-1], after, -jnp.inf))


def _log_threshold(log_weights: jax.Array, n: int) -> jax.Array:
    """Return -log c; minus infinity where fewer than n have weight.

    In logs throughout: weights that underflow beside the largest would leave no order among those that fill the last places.
    """
    nothing = float(jnp.finfo(log_weights.dtype).min) / 4
    ordered = jnp.flip(jnp.sort(jnp.where(log_weights > nothing, log_weights, nothing)))
    tails = jnp.flip(jax.lax.cumlogsumexp(jnp.flip(ordered)))[:n]
    left = n - jnp.arange(n)
    first = jnp.argmax(jnp.log(left.astype(ordered.dtype)) + ordered[:n] <= tails)
    log_mass = tails[first]
    return jnp.where(log_mass > nothing / 2, log_mass - jnp.log(left[first].astype(ordered.dtype)), -jnp.inf)
