"""Where a lost target may be: places all over the picture, drawn by how well they look. It is what `Recovering` draws from."""

from functools import cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from motes.applications.video.model import PACE, Look
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
    apart = STRIDE * np.array([look.width, look.height])
    apart *= max(1.0, (width * height / np.prod(apart) / PLACES) ** 0.5)
    places = np.meshgrid(np.arange(apart[0] / 2, width, apart[0]), np.arange(apart[1] / 2, height, apart[1]))
    grid = np.stack(places).reshape(2, -1)

    def draw(key: jax.Array, y: Any, u: Any, t: Any) -> jax.Array:
        size = u[MEMORY]["seen"][2]
        states = jnp.concatenate([jnp.asarray(grid, size.dtype), jnp.full((1, grid.shape[1]), size)])
        # the same for all particles, and so worked out once
        looks = jnp.cumsum(jax.nn.softmax(SOFT * look.log_likelihood(y, states, u[MEMORY])))
        which, near = jax.random.split(key)
        place = jnp.searchsorted(looks, looks[-1] * jax.random.uniform(which, dtype=size.dtype))
        spread = jnp.array([*(apart / 2), PACE], size.dtype)
        return states[:, jnp.minimum(place, grid.shape[1] - 1)] + spread * jax.random.normal(near, (3,), size.dtype)

    return draw
