"""Pictures drawn from the model, for plans and studies: what is in the box of the first picture, cut out and put down elsewhere.

Where it was cut out the picture goes on from the left edge of the box to the right one. To each picture comes the noise of a camera. What
moves is told from the ground alone, without the picture before; what was learned is what the first picture teaches.
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from motes.applications.video.frames import colour_place, colour_table, still_channels
from motes.applications.video.target import Target
from motes.laws.custom import Custom
from motes.models.state_space import StateSpaceModel

NOISE = 2.0
"""Standard deviation of the noise of each channel, levels of brightness."""


def cut_out(target: Target, picture: np.ndarray) -> StateSpaceModel:
    """Return the model of a target with a sensor that draws pictures.

    Args:
        target: what is followed.
        picture: in which it is first seen, RGB, uint8 `(height, width, 3)`.
    """
    look, memory, table = target.look, target.memory, jnp.asarray(colour_table())
    whole = np.asarray(picture[:: look.stride, :: look.stride], np.float32)
    low, high = (np.clip(np.round(corner / look.stride).astype(int), 0, whole.shape[1::-1])
                 for corner in (target.box[:2], target.box[:2] + target.box[2:]))  # fmt: skip
    rows, columns = slice(low[1], high[1]), slice(low[0], high[0])
    patch, ground = jnp.asarray(whole[rows, columns]), whole.copy()
    share = np.linspace(0, 1, high[0] - low[0], dtype=np.float32)[None, :, None]
    left, right = (whole[rows, place, None] for place in (max(low[0] - 1, 0), min(high[0], whole.shape[1] - 1)))
    ground[rows, columns] = left * (1 - share) + right * share
    height, width = ground.shape[:2]
    ground = jnp.asarray(ground)

    def draw(key: jax.Array, X: jax.Array, u: Any, t: Any) -> dict[str, jax.Array]:
        places = jnp.arange(max(height, width)) + 0.5

        def one(key: jax.Array, box: jax.Array) -> dict[str, jax.Array]:
            (row, inside_rows), (column, inside_columns) = (
                _within(places[:most], box[axis], box[axis + 2], patch.shape[1 - axis]) for axis, most in ((1, height), (0, width))
            )
            shown = jnp.where((inside_rows[:, None] & inside_columns)[..., None], patch[row[:, None], column], ground)
            shown = jnp.clip(shown + NOISE * jax.random.normal(key, shown.shape), 0, 255).astype(jnp.int32)
            planes = jnp.moveaxis(shown, 2, 0)
            grey, *opponent = still_channels(planes)
            moved = jnp.abs(grey - jnp.sum(ground, axis=2).astype(jnp.int32) // 3)
            channels = jnp.stack([grey, *opponent, moved])
            sums = jnp.pad(jnp.cumsum(jnp.cumsum(channels, axis=1), axis=2), ((0, 0), (1, 0), (1, 0)))
            return {"bins": table[colour_place(planes)], "sums": sums.astype(jnp.int32)}

        return jax.vmap(one, (0, -1), -1)(jax.random.split(key, X.shape[1]), look.boxes(X, memory))

    def density(y: Any, X: jax.Array, u: Any, t: Any) -> jax.Array:
        return look.log_likelihood(y, X, memory) - memory["usual"]

    model = target.model
    return StateSpaceModel(model.initial, model.dynamics, Custom(draw, density, batched=True), model.names)


def _within(places: jax.Array, low: jax.Array, high: jax.Array, size: int) -> tuple[jax.Array, jax.Array]:
    """Return which row or column of so many falls on places, and whether one does."""
    share = (places - low) / (high - low)
    return jnp.clip(jnp.floor(share * size), 0, size - 1).astype(jnp.int32), (share >= 0) & (share < 1)
