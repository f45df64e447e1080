"""Centre-surround features on integral images (Klein, Schulz, Frintrop, Cremers 2010), and the contrast of what moves.

A box is `(4, m)`: left, top, right and bottom in pixels that are looked at, those of many boxes on the last axis.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from motes.applications.video.frames import BRIGHTNESS, MOTION

COUNT, SEED = 150, 20100
"""Features in the pool, and the seed by which they were drawn."""
CENTRE, SURROUND, WIDE = (0.2, 0.9), 1.6, 2.0
"""Sides of the centre as shares of the box, the surround as a multiple of it, and the part that tells the brightness as one of the box."""
LEAST = 4.0
"""Levels of brightness that are added where one is divided by, against the dark."""


class Pool(NamedTuple):
    """Features: of a channel, a centre and its surround, `(k,)` and `(k, 4)` in shares of the box."""

    channel: jax.Array
    centre: jax.Array
    surround: jax.Array

    def some(self, chosen: jax.Array) -> "Pool":
        """Return those of the given numbers."""
        return Pool(*(part[chosen] for part in self))


def pool() -> Pool:
    """Return the features among which boosting chooses; always the same."""
    generator = np.random.default_rng(SEED)
    sides = generator.uniform(*CENTRE, (COUNT, 2))
    middle = sides / 2 + generator.uniform(size=(COUNT, 2)) * (1 - sides)

    def around(sides: np.ndarray) -> jax.Array:
        return jnp.asarray(np.concatenate([middle - sides / 2, middle + sides / 2], axis=1), jnp.float32)

    return Pool(jnp.asarray(generator.integers(MOTION, size=COUNT)), around(sides), around(SURROUND * sides))


def values(sums: jax.Array, boxes: jax.Array, features: Pool) -> jax.Array:
    """Return features `(k, m)` of boxes: mean of the centre less that of the rest of the surround, over the brightness around the box."""
    channel = features.channel[:, None]
    inner, inner_area = within(sums, placed(boxes, features.centre), channel)
    outer, outer_area = within(sums, placed(boxes, features.surround), channel)
    contrast = inner / jnp.maximum(inner_area, 1) - (outer - inner) / jnp.maximum(outer_area - inner_area, 1)
    bright, area = within(sums, grown(boxes, WIDE), BRIGHTNESS)
    return contrast / (bright / jnp.maximum(area, 1) + LEAST)


def moving(sums: jax.Array, boxes: jax.Array) -> jax.Array:
    """Return from -1 to 1 how much more changes within boxes than around them, `(m,)`."""
    inner, inner_area = within(sums, boxes, MOTION)
    outer, outer_area = within(sums, grown(boxes, SURROUND), MOTION)
    inside, beside = inner / jnp.maximum(inner_area, 1), (outer - inner) / jnp.maximum(outer_area - inner_area, 1)
    return (inside - beside) / (inside + beside + LEAST)


def placed(boxes: jax.Array, shares: jax.Array) -> jax.Array:
    """Return parts of boxes `(4, k, m)`, given in shares of the box, `(k, 4)`."""
    corner, side = boxes[:2], boxes[2:] - boxes[:2]
    near, far = (corner[:, None] + shares.T[part][:, :, None] * side[:, None] for part in (slice(2), slice(2, 4)))
    return jnp.concatenate([near, far])


def grown(boxes: jax.Array, factor: float) -> jax.Array:
    """Return boxes with the same middle and sides so many times as long."""
    middle, half = (boxes[:2] + boxes[2:]) / 2, factor * (boxes[2:] - boxes[:2]) / 2
    return jnp.concatenate([middle - half, middle + half])


def within(sums: jax.Array, boxes: jax.Array, channel: jax.Array | int) -> tuple[jax.Array, jax.Array]:
    """Return the sum over the part of boxes that lies in the picture, and how many pixels that are."""
    _, height, width = sums.shape
    flat = sums.reshape(-1)
    left, top, right, bottom = (jnp.clip(jnp.round(edge), 0, most - 1).astype(jnp.int32)
                                for edge, most in zip(boxes, (width, height, width, height), strict=True))  # fmt: skip

    def upto(row: jax.Array, column: jax.Array) -> jax.Array:
        return jnp.take(flat, (channel * height + row) * width + column, mode="clip")

    total = upto(bottom, right) - upto(top, right) - upto(bottom, left) + upto(top, left)
    return total.astype(boxes.dtype), ((right - left) * (bottom - top)).astype(boxes.dtype)
