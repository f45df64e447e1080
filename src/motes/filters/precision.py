"""Whether numbers have the digits that a filter needs: rounding of data and states beside the noise, and of wide priors beside it."""

from typing import Any

import jax
import jax.numpy as jnp

from motes.core import linalg
from motes.gaussian.taylor import affine
from motes.laws.law import Foreign
from motes.laws.observed import Observed
from motes.models.interface import Model
from motes.models.state_space import StateSpaceModel

COARSE = 0.1
"""Spacing of numbers, in standard deviations of the noise, from which on estimates are off by a tenth of their own standard deviation."""
LOST = 0.05
"""Rounding of the prior variance of a measurement, in variances of its noise, from which on a corrected covariance is no longer right."""


def rounding(model: Model, ys: Any, u: Any) -> jax.Array:
    """Return how coarse numbers are for each measured component, `(2, y)`, as seen from the first state; zeros where it is not known.

    The first row is the spacing of numbers of the size of the data and of what the states contribute, in standard deviations of the noise;
    the second the rounding of the measurement's variance under the initial law, in variances of the noise.

    Args:
        model: the user's model.
        ys: measurements `(t, y)`.
        u: inputs of the first step.
    """
    if not all(part.sensor.has_moments and not isinstance(part.initial, Foreign) for part in model.each_mode()):
        return jnp.zeros((2, 1 if isinstance(ys, Observed) else ys.shape[1]), model.dtype)
    return jnp.max(model.in_each_mode(u, lambda part, u, _: _of_one(part, ys, u)), axis=-2)


def _of_one(model: StateSpaceModel, ys: jax.Array, u: Any) -> jax.Array:
    center, cov = model.initial.mean(), model.initial.cov()
    _, slope, noise = affine(model.sensor, center, u, jnp.int32(0))
    variance = jnp.diagonal(noise)
    # a power mean that one wild measurement hardly moves
    seen = ~jnp.isnan(ys)
    size = jnp.square(jnp.sum(jnp.sqrt(jnp.where(seen, jnp.abs(ys), 0)), axis=0) / jnp.maximum(jnp.sum(seen, axis=0), 1))
    size = jnp.maximum(size, jnp.where(jnp.isfinite(slope), jnp.abs(slope), 0) @ jnp.abs(center))
    prior = jnp.diagonal(linalg.sandwich(slope, cov))
    found = float(jnp.finfo(ys.dtype).eps) * jnp.stack([size * jax.lax.rsqrt(variance), prior / variance])
    return jnp.where(jnp.isfinite(found) & (variance > 0), found, 0).astype(ys.dtype)
