"""Gaussians through conditionals, by slopes at the mean: exact where the conditional is linear, extended-Kalman elsewhere."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from motes.core import linalg
from motes.laws.conditional import AdditiveGaussian, Conditional, LinearGaussian, matrix, matrix_over
from motes.laws.density import measured_in
from motes.laws.gaussian import Correction, Gaussian
from motes.models.mixed_linear import user_order


def affine(part: Conditional, x: jax.Array, u: Any, t: Any) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Return the value at x `(z,)`, the slope `(z, x)` and the noise covariance `(z, z)`; exact where the conditional is linear."""
    if isinstance(part, LinearGaussian) and not callable(part.A):  # a function may depend on x, and then has a slope of its own
        slope = matrix(part.A, x, u, t)
        return slope @ x, slope, part.cov(x, u, t)
    return part.mean(x, u, t), jax.jacfwd(lambda x: part.mean(x, u, t))(x), part.cov(x, u, t)


def affine_each(part: Conditional, X: jax.Array, u: Any, t: Any) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Do what `affine` does at each of n states `(x, n)`; the particle axis is the last of all three."""
    return jax.vmap(lambda x: affine(part, x, u, t), in_axes=-1, out_axes=-1)(X)


def moved(dynamics: Conditional, law: Gaussian, u: Any, t: Any) -> Gaussian:
    """Move a Gaussian to time t: the mean through the dynamics, the covariance through their slope at the mean, plus noise."""
    center, slope, noise = affine(dynamics, law.center, u, t)
    return Gaussian(center, linalg.sandwich(slope, law.covariance) + noise)


def measured(sensor: Conditional, law: Gaussian, y: jax.Array, u: Any, t: Any, iterations: int = 1) -> Correction:
    """Condition a Gaussian on a measurement `(y,)` through the sensor's slope; NaN or an infinite variance means not measured.

    The slope is first taken at the mean, then at the mean that the last correction gave; all corrections start from the law given.
    """
    point = law.center
    for _ in range(iterations):
        prediction, slope, noise = affine(sensor, point, u, t)
        at_mean = prediction + slope @ (law.center - point)
        seen = measured_in(y, noise)
        done = law.corrected(sensor.residual(y, at_mean), slope, noise, seen)
        point = done.law.center
    return done._replace(count=jnp.sum(seen))


def moved_each(dynamics: Conditional, laws: Gaussian, u: Any, t: Any, shared: tuple[jax.Array, jax.Array] | None) -> Gaussian:
    """Move each of a batch of Gaussians as `moved` does.

    Args:
        dynamics: with additive Gaussian noise.
        laws: means `(x, n)`, covariances `(x, x, n)`.
        u: inputs of the step.
        t: the time moved to.
        shared: slope `(x, x)` and noise covariance `(x, x)` where they are the same at every state; None to work them out at each mean.
    """
    if shared is None:
        centers, slope, noise = affine_each(dynamics, laws.center, u, t)
    else:
        centers, (slope, noise) = dynamics.means(laws.center, u, t), shared  # type: ignore[attr-defined]
    return Gaussian(centers, linalg.add(linalg.sandwich(slope, laws.covariance), noise))


def moved_over(dynamics: AdditiveGaussian, states: Sequence[int], laws: Gaussian, u: Any, t: Any) -> Gaussian:
    """Move each of a batch of Gaussians by the plane of the dynamics through sigma points in some of the states (see `regressed`).

    Args:
        dynamics: with additive Gaussian noise.
        states: indices of the k states over which the plane is laid; in the others its slope is that at the mean.
        laws: means `(x, n)`, covariances `(x, x, n)`.
        u: inputs of the step.
        t: the time moved to.
    """
    size = laws.center.shape[0]
    others = tuple(i for i in range(size) if i not in states)
    factor = linalg.cholesky(linalg.take(linalg.take(laws.covariance, states), states, axis=1))
    prediction, tilt, unexplained = regressed(dynamics, states, laws.center, factor, u, t)
    straight = jax.vmap(lambda x: slope_in(dynamics, others, x, u, t), in_axes=-1, out_axes=-1)(laws.center)
    slope = linalg.take(jnp.concatenate([straight, untilted(tilt, factor)], axis=1), user_order(tuple(states), size), axis=1)
    noise = linalg.add(unexplained, matrix_over(dynamics.Q, laws.center, u, t))
    return Gaussian(prediction, linalg.add(linalg.sandwich(slope, laws.covariance), noise))


def measured_each(sensor: Conditional, laws: Gaussian, y: jax.Array, u: Any, t: Any) -> Correction:
    """Condition each of a batch of Gaussians, means `(x, n)`, covariances `(x, x, n)`, as `measured` does."""
    prediction, slope, noise = affine_each(sensor, laws.center, u, t)
    every = range(laws.center.shape[0])
    return laws.corrected_in_turn(sensor.residual(y, prediction), [(every, slope)], noise, measured_in(y, noise))


def slope_in(part: Conditional, states: Sequence[int], x: jax.Array, u: Any, t: Any) -> jax.Array:
    """Return the slope `(z, k)` of the mean in k of the states, at x `(x,)`."""
    rest = [i for i in range(x.shape[0]) if i not in states]
    order = user_order(tuple(states), x.shape[0])

    def mean(chosen: jax.Array) -> jax.Array:
        return part.mean(linalg.take(jnp.concatenate([linalg.take(x, rest), chosen]), order), u, t)

    return jax.jacfwd(mean)(linalg.take(x, states))


class Regression(NamedTuple):
    """A sensor replaced by a plane over each of n Gaussians.

    Attributes:
        prediction: mean of the measurement, `(y, n)`.
        tilt: slope per standard deviation, that is slope in the k states that were moved times L, `(y, k, n)`.
        unexplained: covariance of the measurement about the plane, `(y, y, n)`.
    """

    prediction: jax.Array
    tilt: jax.Array
    unexplained: jax.Array


def regressed(sensor: AdditiveGaussian, states: Sequence[int], centers: jax.Array, factor: jax.Array, u: Any, t: Any) -> Regression:
    """Regress a sensor on some of the states over sigma points of each of n Gaussians.

    With L the Cholesky factor of the covariance of the k states and s^2 = max(3, k), the points are the mean (weight 1 - k / s^2) and the
    mean plus and minus s times each column of L (weights 1 / (2 s^2)) (Julier, Uhlmann 1997). Exact for sensors of second degree.

    Args:
        sensor: the sensor.
        states: indices of the k states; the others stay at their means.
        centers: means `(x, n)`.
        factor: L, `(k, k, *n)`.
        u: inputs of the step.
        t: the time.
    """
    size = centers.shape[0]
    others = tuple(i for i in range(size) if i not in states)
    order = user_order(others, size)
    nothing = jnp.zeros((len(others), *factor.shape[1:]), factor.dtype)
    step = np.sqrt(max(3, len(states)))
    steps = step * linalg.take(jnp.concatenate([factor, nothing]), order)
    points = [centers, *(linalg.add_vectors(centers, sign * steps[:, j]) for sign in (1, -1) for j in range(len(states)))]
    # point by point: a look-up in a map that shares a loop with anything else is several times slower
    found = jnp.stack([sensor.means(X, u, t) for X in points], axis=1)
    middle, (above, below) = found[:, 0], jnp.split(sensor.residual(found[:, 1:], found[:, :1]), 2, axis=1)
    # one point beyond the edge of what is known (a void in a map) goes on as the other side does; both make it flat
    sides = (above, below), (below, above)
    above, below = (jnp.where(jnp.isnan(one), jnp.where(jnp.isnan(other), 0, -other), one) for one, other in sides)
    even, odd = (above + below) / (2 * step), (above - below) / (2 * step)
    bend = sum((even[:, j] for j in range(len(states))), jnp.zeros_like(middle)) / step
    # weighted mean of squares less square of the mean; what the slope explains, the odd parts, has dropped out of the difference
    unexplained = linalg.product_transposed(even, even) - bend[:, None] * bend[None]
    return Regression(middle + bend, odd, unexplained)


def untilted(tilt: jax.Array, factor: jax.Array) -> jax.Array:
    """Return the slope `(z, k, *n)` of a plane from that per standard deviation, slope times L, and the factor L `(k, k, *n)`."""
    return linalg.transpose(linalg.solve_upper(factor, linalg.transpose(tilt)))


def has_moments(part: Conditional) -> bool:
    """Tell whether a conditional has a mean function and a covariance."""
    return isinstance(part, AdditiveGaussian) or (hasattr(part, "law") and part.law.has_moments)  # type: ignore[attr-defined]
