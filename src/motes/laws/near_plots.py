"""Of the many plots of a scan, those few that are near enough to count: found, and worked with alone."""

from collections.abc import Callable
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np

from motes.laws.circular import wrap

T = TypeVar("T")
CHUNK = 8
"""Plots that are held against the particles at a time; a chunk of which none is near is left out."""


def in_chunks(work: Callable[..., jax.Array], total: jax.Array, wanted: jax.Array, *plots: tuple[jax.Array, float]) -> jax.Array:
    """Take the plots of a scan into a total, some at a time, those that are wanted first; what holds none of them is left out.

    Args:
        work: gives the total after some plots, from the total before and an array for each of `plots`.
        total: before.
        wanted: of each plot, whether it counts, `(K,)`.
        plots: arrays `(K, ...)` of what is known of each plot, each with what stands there for no plot.
    """
    order = jnp.argsort(~wanted)
    count = -(-wanted.shape[0] // CHUNK)
    room = count * CHUNK - wanted.shape[0]

    def divided(array: jax.Array, nothing: Any) -> jax.Array:
        full = jnp.pad(array[order], ((0, room), *[(0, 0)] * (array.ndim - 1)), constant_values=nothing)
        return full.reshape(count, CHUNK, *array.shape[1:])

    def chunk(total: jax.Array, now: Any) -> tuple[jax.Array, None]:
        own, needed = now
        return jax.lax.cond(needed, lambda total: work(total, *own), lambda total: total, total), None

    chunks, needed = [divided(*each) for each in plots], divided(wanted, False).any(axis=1)
    # the first always, so that a prediction that is no number is noticed
    total = work(total, *(each[0] for each in chunks))
    return jax.lax.scan(chunk, total, ([each[1:] for each in chunks], needed[1:]))[0]


def over_few(work: Callable[..., T], wanted: jax.Array, room: int, *plots: jax.Array) -> T:
    """Do some work with the plots of a scan; of more than there is room for only with those that are wanted, where they are few.

    Args:
        work: of arrays `(k, ...)` of what is known of each plot.
        wanted: of each plot, whether it counts, `(K,)`.
        room: most plots that count as few.
        plots: arrays `(K, ...)`.
    """
    if wanted.shape[0] <= room:
        return work(*plots)
    few = jnp.argsort(~wanted)[:room]
    return jax.lax.cond(jnp.sum(wanted) <= room, lambda: work(*(each[few] for each in plots)), lambda: work(*plots))


def distance(angles: tuple[int, ...], rows: jax.Array, means: jax.Array, cov: jax.Array) -> jax.Array:
    """Lower bound `(K,)` of the squared Mahalanobis distances between plots `(K, z)` and what is predicted `(z, n)`.

    The box that holds all predictions lies between: from its face the way is no longer than from any of them.
    """
    finite = jnp.isfinite(means)
    about = jnp.max(jnp.where(finite, means, -jnp.inf), axis=1)[:, None]
    offsets = wrap(means - about, angles)
    low, high = (bound[:, None] for bound in (jnp.min(jnp.where(finite, offsets, jnp.inf), axis=1),
                                             jnp.max(jnp.where(finite, offsets, -jnp.inf), axis=1)))  # fmt: skip
    plots = wrap(rows.T - about, angles)

    def gap(shift: float) -> jax.Array:
        return jnp.maximum(jnp.maximum(low - plots - shift, plots + shift - high), 0)

    circular = np.isin(np.arange(rows.shape[1]), [angle % rows.shape[1] for angle in angles])[:, None]
    round_the_other_way = jnp.minimum(gap(2 * np.pi), gap(-2 * np.pi))
    variance = jnp.stack([cov[i, i] for i in range(cov.shape[0])])
    widest = jnp.max(variance, axis=1) if variance.ndim == 2 else variance
    squares = jnp.where(circular, jnp.minimum(gap(0.0), round_the_other_way), gap(0.0)) ** 2 / widest[:, None]
    return jnp.max(jnp.where(jnp.isnan(squares), 0, squares), axis=0)
