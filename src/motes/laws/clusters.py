"""Clusters of a law of many points: where the system may be, when one mean says little (Vedaldi, Soatto 2008: quick shift).

1. Take some points that stand for all, evenly along the weights; the density at each is told by the distance to its k-th neighbor.
2. Link each to the nearest point of higher density. Those whose link would be long beside the spacing of points are the modes.
3. Join modes between which the density hardly falls.
4. Every point belongs to the mode at the end of the links of its nearest representative; moments are those of all points of a cluster.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

MOST = 256
"""Points that stand for all."""
LONG = 3.0
"""A link longer than so many distances to the k-th neighbor is none."""
SHALLOW, ROUNDS = 1.0, 4
"""Modes are one where the density between them falls by less than a factor exp(1); neighbors are joined so many times."""


class Clusters(NamedTuple):
    """The heaviest clusters of a law, by weight; those that there are not have weight zero.

    Attributes:
        mean: `(k, x)`.
        cov: `(k, x, x)`.
        weight: `(k,)`; less than one in all, where there are more than k clusters.
    """

    mean: jax.Array
    cov: jax.Array
    weight: jax.Array


def one_cluster(mean: jax.Array, cov: jax.Array, count: int) -> Clusters:
    """Return a law of one mode, `(x,)` and `(x, x)`, as so many clusters."""
    first = (jnp.arange(count) == 0).astype(mean.dtype)
    return Clusters(jnp.broadcast_to(mean, (count, *mean.shape)), jnp.broadcast_to(cov, (count, *cov.shape)), first)


def clusters(points: jax.Array, log_weights: jax.Array, count: int) -> Clusters:
    """Find the clusters of weighted points.

    Args:
        points: `(x, n)`; angles on one branch.
        log_weights: normalized, `(n,)`.
        count: most clusters.
    """
    weights = jnp.exp(log_weights)
    known = jnp.all(jnp.isfinite(points), axis=0) & (weights > 0)
    weights, points = jnp.where(known, weights, 0), jnp.where(known, points, 0)
    center = points @ weights
    scale = jnp.sqrt(jnp.square(points - center[:, None]) @ weights)
    scaled = points / jnp.where(scale > 0, scale, 1)[:, None]
    few = _evenly(weights, min(MOST, points.shape[1]))
    root = _roots(scaled[:, few])
    nearest = jnp.argmin(_squares(scaled, scaled[:, few]), axis=1)
    own = root[nearest]
    totals = jnp.zeros(few.shape[0], weights.dtype).at[own].add(weights)
    heaviest, which = jax.lax.top_k(totals, min(count, few.shape[0]))
    inside = jnp.where(own[None] == which[:, None], weights, 0) / jnp.where(heaviest > 0, heaviest, 1)[:, None]
    mean = inside @ points.T
    off = points[None] - mean[:, :, None]
    cov = jnp.einsum("kn,kin,kjn->kij", inside, off, off, precision=jax.lax.Precision.HIGHEST)
    short = count - which.shape[0]
    return Clusters(*(jnp.pad(leaf, [(0, short), *[(0, 0)] * (leaf.ndim - 1)]) for leaf in (mean, cov, heaviest)))


def _evenly(weights: jax.Array, m: int) -> jax.Array:
    """Indices `(m,)` of points evenly along the sum of their weights."""
    sums = jnp.cumsum(weights)
    at = (jnp.arange(m, dtype=weights.dtype) + 0.5) / m * sums[-1]
    return jnp.clip(jnp.searchsorted(sums, at), 0, weights.shape[0] - 1)


def _squares(points: jax.Array, others: jax.Array) -> jax.Array:
    """Squared distances `(n, m)`."""
    return jnp.sum(jnp.square(points[:, :, None] - others[:, None]), axis=0)


def _roots(points: jax.Array) -> jax.Array:
    """Index of the mode of each of m points `(x, m)`."""
    size, m = points.shape
    apart = jnp.sqrt(_squares(points, points))
    radius = jnp.sort(apart, axis=1)[:, min(m - 1, max(2, round(m**0.5)))]
    # copies of one point have no spacing of their own
    radius = jnp.maximum(radius, 0.5 * jnp.median(radius))
    height = -size * jnp.log(jnp.where(radius > 0, radius, 1))
    distance = jnp.where(_higher(height), apart, jnp.inf)
    near = jnp.min(distance, axis=1) <= LONG * radius
    root = _ends(jnp.where(near, jnp.argmin(distance, axis=1), jnp.arange(m)))
    touching = apart <= jnp.maximum(radius[:, None], radius)
    for _ in range(ROUNDS):
        root = _merged(root, height, touching)
    return root


def _higher(height: jax.Array) -> jax.Array:
    """Whether the point of a column is higher than that of a row, `(m, m)`; of equal ones the first is."""
    place = jnp.arange(height.shape[0])
    return (height[None] > height[:, None]) | ((height[None] == height[:, None]) & (place[None] < place[:, None]))


def _ends(link: jax.Array) -> jax.Array:
    """Where the links of each point end."""
    for _ in range(max(1, (link.shape[0] - 1).bit_length())):
        link = link[link]
    return link


def _merged(root: jax.Array, height: jax.Array, touching: jax.Array) -> jax.Array:
    """Join modes to higher ones between which the density hardly falls: what noise of the estimate makes is no mode."""
    m = height.shape[0]
    pass_height = jnp.where(touching & (root[:, None] != root), jnp.minimum(height[:, None], height), -jnp.inf)
    saddle = jnp.full((m, m), -jnp.inf, height.dtype).at[:, root].max(pass_height)
    saddle = jnp.full((m, m), -jnp.inf, height.dtype).at[root].max(saddle)
    saddle = jnp.where(_higher(height), saddle, -jnp.inf)
    to, over = jnp.argmax(saddle, axis=1), jnp.max(saddle, axis=1)
    return _ends(jnp.where(height - over < SHALLOW, to, jnp.arange(m)))[root]
