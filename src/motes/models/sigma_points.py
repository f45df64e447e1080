"""Gaussians through conditionals, by sigma points: what a Gaussian does to a function is asked of a few points instead of a slope.

A rule holds points of the standard normal law and their weights. Along the points a function is replaced by the plane that fits it best;
what the plane leaves unexplained is added to the noise. The moments are those of the usual formulas, written so that a plane is carried
to rounding, a covariance is never a difference of large numbers, and components that are angles are wrapped.
"""

from itertools import product
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from motes.core import linalg
from motes.core.record import record, static
from motes.laws.conditional import Conditional, matrix_over, over_particles
from motes.laws.density import measured_in
from motes.laws.gaussian import Correction, Gaussian
from motes.models import linearize


@record
class SigmaPoints:
    """A rule for the standard normal law of x components: E[g] = g(0) + sum_i w_i (g(z_i) - g(0)), with E[z] = 0 and E[z z'] = 1.

    Attributes:
        nodes: points z_i other than the center, `(x, m)`.
        weights: w_i, `(m,)`; the center has what is left to one.
        bend: factor of d d' in a covariance, where d = E[g] - g(0): -1 by the definition of a covariance.
    """

    nodes: np.ndarray
    weights: np.ndarray
    bend: float = static(default=-1.0)


def cubature(size: int) -> SigmaPoints:
    """Third-degree spherical-radial rule: 2 x points at the distance sqrt(x) (Arasaratnam, Haykin 2009, equation 24)."""
    return unscented(size, 1.0, 0.0, 0.0)


def unscented(size: int, alpha: float, beta: float, kappa: float) -> SigmaPoints:
    """Scaled unscented rule: points at s = alpha sqrt(x + kappa) along each axis, weights 1 / (2 s^2) (Wan, van der Merwe 2000).

    Its weight of the center in covariances is larger by 1 - alpha^2 + beta than in means; here that stands in `bend`.
    """
    square = alpha**2 * (size + kappa)
    axes = np.sqrt(square) * np.eye(size)
    return SigmaPoints(np.hstack([axes, -axes]), np.full(2 * size, 0.5 / square), beta - alpha**2)


def gauss_hermite(size: int, degree: int) -> SigmaPoints:
    """Every combination of the `degree` Gauss-Hermite points of each axis: exact for degree 2 `degree` - 1 in each (Ito, Xiong 2000)."""
    points, weights = np.polynomial.hermite_e.hermegauss(degree)
    nodes = np.array(list(product(points, repeat=size))).T
    masses = np.prod(np.array(list(product(weights / weights.sum(), repeat=size))), axis=1)
    away = np.any(np.abs(nodes) > 1e-9, axis=0)
    return SigmaPoints(nodes[:, away], masses[away])


class Plane(NamedTuple):
    """A conditional replaced by a plane over a Gaussian of covariance L L'.

    Attributes:
        center: value at the mean, `(z,)`.
        offset: mean of the values less the one at the mean, `(z,)`.
        tilt: slope per standard deviation, that is slope times L, `(z, x)`.
        noise: covariance about the plane: the noise's own mean, plus what the plane leaves unexplained, `(z, z)`.
    """

    center: jax.Array
    offset: jax.Array
    tilt: jax.Array
    noise: jax.Array


def fitted(part: Conditional, rule: SigmaPoints, law: Gaussian, factor: jax.Array, u: Any, t: Any) -> Plane:
    """Fit a plane to the mean of a conditional over a Gaussian with the Cholesky factor `(x, x)`."""
    nodes, weights = jnp.asarray(rule.nodes, factor.dtype), jnp.asarray(rule.weights, factor.dtype)
    X = law.center[:, None] + jnp.concatenate([jnp.zeros_like(law.center)[:, None], linalg.product(factor, nodes)], axis=1)
    values = over_particles(part.mean, X, u, t)
    off = part.residual(values[:, 1:], values[:, :1])
    offset = linalg.times_vector(off, weights)
    tilt = linalg.product_transposed(off * weights, nodes)
    rest = off - linalg.product(tilt, nodes)
    unexplained = linalg.rank_update(linalg.product_transposed(rest * weights, rest), offset, rule.bend)
    own = matrix_over(part.cov, X, u, t)
    if own.ndim == 3:
        own = own[..., 0] + (own[..., 1:] - own[..., :1]) @ weights
    return Plane(values[:, 0], offset, tilt, unexplained + own)


def moved(dynamics: Conditional, rule: SigmaPoints, law: Gaussian, u: Any, t: Any) -> Gaussian:
    """Move a Gaussian to time t: mean and covariance of the dynamics over it."""
    plane = fitted(dynamics, rule, law, linalg.cholesky(law.covariance), u, t)
    return Gaussian(plane.center + plane.offset, linalg.sandwich(plane.tilt, linalg.identity_like(law.covariance)) + plane.noise)


def measured(sensor: Conditional, rule: SigmaPoints, law: Gaussian, y: jax.Array, u: Any, t: Any) -> Correction:
    """Condition a Gaussian on a measurement `(y,)` with the joint moments of state and measurement; NaN means not measured."""
    prediction, slope, noise = affine(sensor, rule, law, u, t)
    seen = measured_in(y, noise)
    return law.corrected(sensor.residual(y, prediction), slope, noise, seen)._replace(count=jnp.sum(seen))


def affine(part: Conditional, rule: SigmaPoints, law: Gaussian, u: Any, t: Any) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Return the mean over a Gaussian `(z,)`, the slope `(z, x)` of the plane there and the noise about it `(z, z)`."""
    factor = linalg.cholesky(law.covariance)
    plane = fitted(part, rule, law, factor, u, t)
    return plane.center + plane.offset, linearize.untilted(plane.tilt, factor), plane.noise
