"""Histograms of colour over a box (Perez, Hue, Vermaak, Gangnet 2002)."""

import jax
import jax.numpy as jnp

from motes.applications.video.frames import BINS

POINTS = 20
"""Points of a box across and down at which the colour is looked up."""


def histograms(bins: jax.Array, boxes: jax.Array) -> jax.Array:
    """Return the share of each colour in the visible part of boxes `(4, m)`, as `(m, 110)`; zeros for one that is out of sight."""
    height, width = bins.shape
    share = (jnp.arange(POINTS) + 0.5) / POINTS
    across, down = (jnp.floor(boxes[axis] + share[:, None] * (boxes[axis + 2] - boxes[axis])) for axis in (0, 1))
    column, row = (jnp.clip(place, 0, most - 1).astype(jnp.int32) for place, most in ((across, width), (down, height)))
    seen = ((down >= 0) & (down < height))[:, None] & ((across >= 0) & (across < width))[None]
    colour = jnp.where(seen, jnp.take(bins.reshape(-1), row[:, None] * width + column[None], mode="clip"), BINS)
    many = colour.shape[-1]
    count = jnp.zeros((many, BINS), boxes.dtype).at[jnp.arange(many)[None], colour.reshape(-1, many)].add(1, mode="drop")
    return count / jnp.maximum(jnp.sum(count, axis=1, keepdims=True), 1)


def distance(one: jax.Array, other: jax.Array) -> jax.Array:
    """Return the square of the Bhattacharyya distance of histograms, `(m,)`: 0 for the same, 1 where they share no colour."""
    return 1 - jnp.sum(jnp.sqrt(one * other), axis=-1)
