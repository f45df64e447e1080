"""Components that are angles, in radians: differences the short way round, and points brought to one branch before they are averaged.

Values that differ by whole turns are the same angle, so that plain sums over points on both sides of the cut mean nothing. Points that all
lie within half a turn of their mean direction are numbers like any others: their mean is the circular mean, about which the signed
deviations sum to zero, and every covariance, kernel and gain made of them is that of the same problem with an unwrapped angle. Laws are
therefore kept so (`Law.gathered`) from step to step, and nothing that averages has to know of angles (Mardia, Jupp 2000, section 2.2).
"""

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np

from motes.core import linalg

TURN = 2 * np.pi


def wrap(difference: jax.Array, angles: tuple[int, ...]) -> jax.Array:
    """Wrap the named rows of differences `(z, *n)` to (-pi, pi]; radians."""
    if not angles:
        return difference
    return jnp.where(_named(difference, angles), difference - TURN * _turns(difference), difference)


def near(points: jax.Array, reference: jax.Array, angles: tuple[int, ...]) -> jax.Array:
    """Move the named rows of points `(x, *n)` by whole turns to within half a turn of a reference `(x,)`."""
    if not angles:
        return points
    turns = _turns(linalg.add_vectors(points, -reference))
    return jnp.where(_named(points, angles), points - TURN * turns, points)


def _total(rows: jax.Array) -> jax.Array:
    return jnp.sum(rows, axis=1)


def gathered(
    points: jax.Array, log_weights: jax.Array, angles: tuple[int, ...], total: Callable[[jax.Array], jax.Array] = _total
) -> jax.Array:
    """Move the named rows of points by whole turns to within half a turn of their mean direction, on the branch where most weight is.

    Points that lie so are left alone to the last bit. Those that are not numbers stay so, and move no others.

    Args:
        points: `(x, n, *m)`.
        log_weights: normalized along the first axis, `(n, *m)`.
        angles: rows that are angles.
        total: how rows `(z, n, *m)` are summed over all points, as `(z, *m)`.
    """
    if not angles:
        return points
    rows = np.array(angles) % points.shape[0]
    values = jnp.stack([points[i] for i in rows])
    known, weights = jnp.isfinite(values), jnp.exp(log_weights)
    usable = jnp.where(known, values, 0)
    weights = jnp.where(known, weights, 0)
    direction = jnp.arctan2(total(weights * jnp.sin(usable)), total(weights * jnp.cos(usable)))
    turns = _turns(usable - direction[:, None])
    mass = total(weights)
    branch = jnp.round(total(weights * turns) / jnp.where(mass > 0, mass, 1))
    moved = values - TURN * (turns - branch[:, None])
    for k, i in enumerate(rows):
        points = points.at[i].set(moved[k])
    return points


def _named(values: jax.Array, angles: tuple[int, ...]) -> np.ndarray:
    """Tell which rows of values `(z, *n)` are named, in a shape that broadcasts."""
    circular = np.isin(np.arange(values.shape[0]), np.array(angles) % values.shape[0])
    return circular.reshape(-1, *([1] * (values.ndim - 1)))


def _turns(difference: jax.Array) -> jax.Array:
    """Whole turns by which a difference in radians lies outside of (-pi, pi]."""
    return jnp.ceil(difference / TURN - 0.5)
