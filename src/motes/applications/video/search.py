"""Where a lost target may be: places all over the picture, drawn by how well they look. It is what `Recovering` draws from."""

from functools import cache
from typing import Any

import jax
import jax.numpy as jnp

from motes.applications.video.model import PACE, Look, sides
from motes.filters.adapting import MEMORY

STRIDE, PLACES = 1 / 6, 1_500
"""Distance of neighbouring places in boxes, unless there are more of them than this."""
SOFT = 0.5
"""What their log likelihoods are multiplied by, so that a few places that look well are tried and not one."""


@cache
def anywhere(look: Look, width: int, height: int) -> Any:
    """Return what draws a state, as `Recovering` asks for it, in pictures of so many pixels; as large as the target was when last seen.

    The same for equal arguments, so that nothing is compiled twice.
    """

    def draw(key: jax.Array, y: Any, u: Any, t: Any) -> jax.Array:
        whole, size = jnp.array([width, height]), u[MEMORY]["seen"][2]
        apart = STRIDE * sides(size, u[MEMORY])
        apart *= jnp.maximum(1.0, jnp.sqrt(width * height / jnp.prod(apart) / PLACES))
        count = jnp.maximum(1, whole // apart).astype(jnp.int32)
        apart, number = whole / count, jnp.arange(PLACES)
        corner = jnp.stack([number % count[0], number // count[0]])
        states = jnp.concatenate([(corner + 0.5) * apart[:, None], jnp.full((1, PLACES), size)]).astype(size.dtype)
        # the same for all particles, and so worked out once
        found = SOFT * look.log_likelihood(y, states, u[MEMORY])
        looks = jnp.cumsum(jax.nn.softmax(jnp.where(number < jnp.prod(count), found, -jnp.inf)))
        which, near = jax.random.split(key)
        place = jnp.searchsorted(looks, looks[-1] * jax.random.uniform(which, dtype=size.dtype))
        spread = jnp.array([*(apart / 2), PACE], size.dtype)
        return states[:, jnp.minimum(place, PLACES - 1)] + spread * jax.random.normal(near, (3,), size.dtype)

    return draw
