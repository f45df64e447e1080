"""Many weighted hypotheses brought down to few without copies (Fearnhead, Clifford 2003).

A copy of a hypothesis that goes on with no noise of its own is wasted. With c such that min(c w_i, 1) sums to n, hypotheses of weight above
1 / c stay with their weights, and the rest is resampled systematically, each at most once, with weight 1 / c. A weight is unchanged on
average and their sum is unchanged; of all such rules this one has the smallest expected squared error of the weights.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp

from motes.core import logspace, random
from motes.resampling.schemes import ancestors_from_ends, boundaries

PAIRED = 128
"""So many hypotheses and fewer are set beside each other pair by pair: sorting and running sums of them take longer."""


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
    if log_weights.shape[0] <= PAIRED:
        return _of_few(random.uniform(key, (), log_weights.dtype), log_weights, n)
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


def _of_few(u: jax.Array, log_weights: jax.Array, n: int) -> Reduction:
    """Do the same by sums over pairs; u is the uniform number of the systematic draw."""
    count, minus_infinity = log_weights.shape[0], jnp.asarray(-jnp.inf, log_weights.dtype)
    possible = log_weights > minus_infinity
    sizes = jnp.where(possible, log_weights, 0)
    heavier = possible[None] & (sizes[None] > sizes[:, None])
    exact, ones = partial(jnp.matmul, precision=jax.lax.Precision.HIGHEST), jnp.ones(count, sizes.dtype)
    # of each hypothesis: how many are heavier, and the mass of the others in units of its weight; by products, since XLA vectorizes what
    # leads to these, but not what it sums
    left = n - exact(heavier.astype(sizes.dtype), ones)
    mass = exact(jnp.where(possible[None] & ~heavier, jnp.exp(jnp.minimum(sizes[None] - sizes[:, None], 0)), 0), ones)
    first = jnp.argmax(jnp.where(possible & (left <= mass), log_weights, minus_infinity))
    enough = possible[first] & (left[first] <= mass[first])
    log_threshold = jnp.where(enough, sizes[first] + jnp.log(mass[first] / jnp.maximum(left[first], 1)), minus_infinity)
    certain = log_weights > log_threshold
    light = possible & ~certain
    # every light one takes its share of the places that are left, in order
    share = jnp.where(light, jnp.exp(sizes - log_threshold), 0)
    until = jnp.tri(count, dtype=sizes.dtype)
    ends = exact(until, share)
    places = (n - jnp.sum(certain, dtype=jnp.int32)).astype(ends.dtype)
    # rounding must not leave a place empty, nor one too many
    ends = jnp.where(ends >= ends[-1], places, jnp.minimum(ends, places))
    points = jnp.ceil(ends - jnp.minimum(u, 1 - 2 * places * jnp.finfo(ends.dtype).eps))
    drawn = points > jnp.concatenate([jnp.zeros(1, points.dtype), points[:-1]])
    kept = certain | (drawn & light)
    filled = exact(until, kept.astype(sizes.dtype))
    place = jnp.arange(n)
    ancestors = jnp.minimum(jnp.sum(filled[None] <= place[:, None], axis=1, dtype=jnp.int32), count - 1)
    after = jnp.maximum(log_weights, log_threshold)[ancestors]
    return Reduction(ancestors, jnp.where(place < filled[-1], after, minus_infinity))
