"""A robot with odometry that slips and a laser, on a map: the likelihood field (Thrun, Burgard, Fox 2005, section 6.4).

A beam speaks for a pose by the distance from where it ends to the nearest wall, which a distance transform has worked out once.
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from scipy.ndimage import distance_transform_edt

from motes.applications.laser.grid import Grid
from motes.laws.cloud import Cloud
from motes.laws.conditional import AdditiveGaussian
from motes.laws.custom import Custom
from motes.models.state_space import StateSpaceModel

STATES = ("px", "py", "heading")
HIT_SD, SURE, FAR = 0.2, 0.8, 10.0
"""Standard deviation of where a beam ends, m; share of beams that end at walls of the map; others end anywhere within so many meters."""
SHARED = 0.3
"""Neighboring beams tell much the same: their evidence counts by this power."""
STARTS = 50_000
"""Poses that stand for a start anywhere."""


def free_places(grid: Grid) -> np.ndarray:
    """Return the middles of all free cells, `(m, 2)`, meters."""
    rows, columns = np.nonzero(grid.free)
    return np.array(grid.origin) + grid.resolution * (np.stack([columns, rows], axis=1) + 0.5)


def drive(x: jax.Array, u: Any, t: Any) -> jax.Array:
    """Move the robot by one step of its odometry."""
    course = x[2] + u["turn"] / 2
    return jnp.stack([x[0] + u["forward"] * jnp.cos(course), x[1] + u["forward"] * jnp.sin(course), x[2] + u["turn"]])


def slip(x: jax.Array, u: Any, t: Any) -> jax.Array:
    """Covariance of the noise of a step."""
    place = 0.05**2 * jnp.abs(u["forward"]) + 0.01**2
    return jnp.diag(jnp.stack([place, place, 0.01**2 + 0.05**2 * jnp.abs(u["turn"])]))


def laser_model(grid: Grid, beams: np.ndarray) -> StateSpaceModel:
    """Build the model of a robot that may start anywhere.

    Args:
        grid: the map.
        beams: their bearings `(b,)`; measurements are ranges `(b,)`, NaN where nothing came back.
    """
    # a rim without walls stands for all that is beyond the map, where neither a beam ends nor the robot is
    apart = np.asarray(distance_transform_edt(~grid.occupied)) * grid.resolution
    field = jnp.asarray(np.pad(apart, 1, constant_values=FAR), float)
    free = jnp.asarray(np.pad(grid.free, 1))
    bearings = jnp.asarray(beams, float)
    rows, columns = field.shape

    def cell(x: jax.Array, y: jax.Array) -> tuple[jax.Array, jax.Array]:
        column, row = (jnp.floor((at - begin) / grid.resolution) + 1 for at, begin in zip((x, y), grid.origin, strict=True))
        return jnp.clip(row, 0, rows - 1).astype(jnp.int32), jnp.clip(column, 0, columns - 1).astype(jnp.int32)

    def likelihood(y: jax.Array, x: jax.Array, u: Any, t: Any) -> jax.Array:
        course = x[2] + bearings
        reach = jnp.where(jnp.isnan(y), 0, y)
        miss = jnp.where(free[cell(x[0], x[1])], field[cell(x[0] + reach * jnp.cos(course), x[1] + reach * jnp.sin(course))], FAR)
        density = SURE / (HIT_SD * np.sqrt(2 * np.pi)) * jnp.exp(-0.5 * (miss / HIT_SD) ** 2) + (1 - SURE) / FAR
        return SHARED * jnp.sum(jnp.where(jnp.isnan(y), 0, jnp.log(density)))

    rng = np.random.default_rng(0)
    places = free_places(grid)
    poses = np.column_stack([places[rng.integers(0, len(places), STARTS)], rng.uniform(-np.pi, np.pi, STARTS)])
    dynamics, sensor = AdditiveGaussian(drive, slip, angles=(2,)), Custom(None, likelihood, partial=True)
    return StateSpaceModel(Cloud.equal(jnp.asarray(poses.T, float)), dynamics, sensor, STATES)


def anywhere(grid: Grid) -> Callable[..., jax.Array]:
    """Return a function that draws a pose on the free part of the map."""
    places = jnp.asarray(free_places(grid), float)

    def drawn(key: jax.Array, y: jax.Array, u: Any, t: Any) -> jax.Array:
        first, second = jax.random.split(key)
        place = places[jax.random.randint(first, (), 0, len(places))]
        return jnp.append(place, jax.random.uniform(second, (), minval=-jnp.pi, maxval=jnp.pi))

    return drawn
