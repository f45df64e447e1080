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
from motes.applications.robot.model import rolled
from motes.core.record import record, static
from motes.laws.cloud import Cloud
from motes.laws.conditional import AdditiveGaussian
from motes.laws.custom import Custom
from motes.models.state_space import StateSpaceModel

STATES = ("px", "py", "heading")
HIT_SD, SURE, FAR = 0.2, 0.8, 10.0
"""Standard deviation of where a beam ends, m; share of beams that end at walls of the map; others end anywhere within so many meters."""
SHARED = 0.3
"""Neighboring beams tell much the same: their evidence counts by this power."""
DENSE, FEWEST, MOST = 100, 50_000, 500_000
"""Poses that stand for a start anywhere: so many for each square meter, but no fewer and no more than that."""
WIDE, APART = 0.5, (0.2, 0.2, 0.07)
"""Where a robot is sought among these poses: standard deviation of where a beam ends, m, and how far a pose may be off, m, m, radians."""
SHARPER = 0.8
"""Of that so much is left with each step after the start: poses that lie so far apart would be judged by chance."""


def drive(x: jax.Array, u: Any, t: Any) -> jax.Array:
    """Move the robot by one step of its odometry."""
    return jnp.stack(rolled(x, u["forward"], u["turn"]))


def slip(x: jax.Array, u: Any, t: Any) -> jax.Array:
    """Covariance of the noise of a step."""
    place = 0.05**2 * jnp.abs(u["forward"]) + 0.01**2
    own = jnp.stack([place, place, 0.01**2 + 0.05**2 * jnp.abs(u["turn"])])
    return jnp.diag(own + SHARPER**t * jnp.square(jnp.asarray(APART)))


def hit_sd(t: Any) -> jax.Array:
    """Standard deviation of where a beam of a step ends, meters: less and less after the start."""
    return jnp.sqrt(HIT_SD**2 + SHARPER**t * (WIDE**2 - HIT_SD**2))


@record
class LikelihoodField:
    """How a scan speaks for a pose.

    Attributes:
        apart: distance to the nearest wall, meters, `(rows, columns)`, with a rim that stands for all that is beyond the map.
        free: where the robot may be.
        bearings: of the beams, radians to the left of ahead, `(beams,)`.
        resolution: width of a cell, meters.
        origin: x, y of the south-west corner of the map, meters.
    """

    apart: jax.Array
    free: jax.Array
    bearings: jax.Array
    resolution: float = static()
    origin: tuple[float, float] = static()

    @classmethod
    def of(cls, grid: Grid, bearings: np.ndarray) -> "LikelihoodField":
        """Work it out for a map and the bearings of beams; on the rim neither a beam ends nor the robot is."""
        apart = np.asarray(distance_transform_edt(~grid.occupied)) * grid.resolution
        rim = jnp.asarray(np.pad(apart, 1, constant_values=FAR), float)
        return cls(rim, jnp.asarray(np.pad(grid.free, 1)), jnp.asarray(bearings, float), grid.resolution, grid.origin)

    def log_prob(self, y: jax.Array, x: jax.Array, sd: Any) -> jax.Array:
        """Log density of ranges `(beams,)`, NaN where nothing came back, from a pose, where a beam ends within so many meters."""
        course = x[2] + self.bearings
        reach = jnp.where(jnp.isnan(y), 0, y)
        ends = self._cell(x[0] + reach * jnp.cos(course), x[1] + reach * jnp.sin(course))
        miss = jnp.where(self.free[self._cell(x[0], x[1])], self.apart[ends], FAR)
        density = SURE / (sd * np.sqrt(2 * np.pi)) * jnp.exp(-0.5 * (miss / sd) ** 2) + (1 - SURE) / FAR
        return SHARED * jnp.sum(jnp.where(jnp.isnan(y), 0, jnp.log(density)))

    def _cell(self, x: jax.Array, y: jax.Array) -> tuple[jax.Array, jax.Array]:
        column, row = (jnp.floor((at - begin) / self.resolution) + 1 for at, begin in zip((x, y), self.origin, strict=True))
        rows, columns = self.apart.shape
        return jnp.clip(row, 0, rows - 1).astype(jnp.int32), jnp.clip(column, 0, columns - 1).astype(jnp.int32)


def usual(y: jax.Array, u: Any, t: Any) -> jax.Array:
    """Return the log density that a scan has on the average from where the robot is, by the model."""
    hit = jnp.log(SURE / (hit_sd(t) * np.sqrt(2 * np.pi))) - 0.5
    return SHARED * (SURE * hit + (1 - SURE) * np.log((1 - SURE) / FAR)) * jnp.sum(~jnp.isnan(y))


def poses_of(grid: Grid) -> np.ndarray:
    """Return poses all over the free part of a map, `(3, m)`."""
    rng = np.random.default_rng(0)
    rows, columns = np.nonzero(grid.free)
    count = int(np.clip(DENSE * len(rows) * grid.resolution**2, FEWEST, MOST))
    chosen = rng.integers(0, len(rows), count)
    place = np.stack([columns[chosen], rows[chosen]]) + rng.uniform(0, 1, (2, count))
    return np.concatenate([np.array(grid.origin)[:, None] + grid.resolution * place, rng.uniform(-np.pi, np.pi, (1, count))])


def laser_model(field: LikelihoodField, poses: np.ndarray) -> StateSpaceModel:
    """Build the model of a robot that may start at any of some poses `(3, m)`; measurements are ranges `(beams,)`, NaN for none."""
    sensor = Custom(None, lambda y, x, u, t: field.log_prob(y, x, hit_sd(t)), partial=True)
    return StateSpaceModel(Cloud.equal(jnp.asarray(poses, float)), AdditiveGaussian(drive, slip, angles=(2,)), sensor, STATES)


def seeking(field: LikelihoodField, poses: np.ndarray) -> Callable[..., jax.Array]:
    """Return a function that draws a pose near one of some poses `(3, m)`, by how well each fits the scan (Lenser, Veloso 2000)."""
    all_poses = jnp.asarray(poses, float)

    def drawn(key: jax.Array, y: jax.Array, u: Any, t: Any) -> jax.Array:
        # this depends on the scan alone: all particles that are drawn share it
        log_prob = jax.vmap(lambda x: field.log_prob(y, x, WIDE), 1)(all_poses)
        sums = jnp.cumsum(jnp.exp(log_prob - jnp.max(log_prob)))
        first, second = jax.random.split(key)
        chosen = jnp.searchsorted(sums, jax.random.uniform(first, (), sums.dtype) * sums[-1])
        off = jnp.asarray(APART, sums.dtype) * jax.random.normal(second, (3,), sums.dtype)
        return all_poses[:, jnp.minimum(chosen, sums.shape[0] - 1)] + off

    return drawn
