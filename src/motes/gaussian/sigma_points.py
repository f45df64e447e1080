"""Rules by sigma points: what a function makes of a Gaussian is asked of a few points instead of a slope.

A rule holds points of the standard normal distribution and their weights. The function is replaced by the line that fits it best along the
points (statistical linear regression); what the line leaves unexplained is added to the noise. The moments are those of the usual formulas,
written so that a linear function is carried to rounding, a covariance is never a difference of large numbers, and components that are
angles are wrapped.
"""

from abc import abstractmethod
from collections.abc import Sequence
from itertools import product
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from motes.core import checks, linalg
from motes.core.record import record, static
from motes.gaussian.rule import Linearized, Rule
from motes.gaussian.taylor import affine, is_affine, slope_in
from motes.laws.conditional import AdditiveGaussian, Conditional, matrix_over, over_particles
from motes.laws.gaussian import Gaussian
from motes.models.mixed_linear import user_order

MOST = 100_000
"""More points than this are a particle filter's work."""


class Points(NamedTuple):
    """Sigma points of the standard normal law of x components: E[g] = g(0) + sum_i w_i (g(z_i) - g(0)), with E[z] = 0 and E[z z'] = 1.

    Attributes:
        nodes: points z_i other than the center, `(x, m)`.
        weights: w_i, `(m,)`; the center has what is left to one.
        offset: factor of d d' in a covariance, where d = E[g] - g(0): -1 by the definition of a covariance.
    """

    nodes: np.ndarray
    weights: np.ndarray
    offset: float = -1.0


class Regression(NamedTuple):
    """A conditional regressed on the states over sigma points of a Gaussian of covariance L L', or of each of n.

    Attributes:
        prediction: mean of the value, `(z, *n)`.
        scaled_slope: slope per standard deviation, that is slope times L, `(z, x, *n)`.
        unexplained: covariance of the value about the line, without the conditional's own noise, `(z, z, *n)`.
    """

    prediction: jax.Array
    scaled_slope: jax.Array
    unexplained: jax.Array


class SigmaPoints(Rule):
    """A rule by sigma points; subclasses say which."""

    @abstractmethod
    def points(self, size: int) -> Points:
        """Return the points for a number of states."""

    def linearized(self, part: Conditional, law: Gaussian, u: Any, t: Any) -> Linearized:
        """See `Rule`."""
        if law.center.ndim > 1:
            axes = (-1, -1 if law.covariance.ndim > 2 else None)
            return jax.vmap(lambda m, P: self.linearized(part, Gaussian(m, P), u, t), axes, -1)(law.center, law.covariance)
        if is_affine(part, law.center, u, t):  # points would find the line again, but for rounding
            return affine(part, law.center, u, t)
        factor = linalg.cholesky(law.covariance)
        near = self._scaled(part, law, factor, u, t)
        return near._replace(slope=unscaled(near.slope, factor))

    def through(self, part: Conditional, law: Gaussian, u: Any, t: Any) -> Gaussian:
        """See `Rule`; without dividing by the factor, so that a singular covariance costs nothing."""
        if law.center.ndim > 1 or is_affine(part, law.center, u, t):
            return Rule.through(self, part, law, u, t)
        factor = linalg.cholesky(law.covariance)
        return self._scaled(part, law, factor, u, t).over(Gaussian(law.center, linalg.identity_like(law.covariance)))

    def _scaled(self, part: Conditional, law: Gaussian, factor: jax.Array, u: Any, t: Any) -> Linearized:
        """Return the linear conditional in standard deviations, with the mean of the noise that the conditional has at the points."""
        found, own = regressed(part, self.points(law.center.shape[0]), law, factor, u, t)
        return Linearized(found.prediction, found.scaled_slope, found.unexplained + own)


@record
class Unscented(SigmaPoints):
    """The scaled unscented rule (Wan, van der Merwe 2000): points at s = alpha sqrt(x + kappa) along each axis, weights 1 / (2 s^2).

    Attributes:
        alpha: spread of the points, above 0.
        beta: what is known of the fourth moments; 2 suits Gaussians. The weight of the center in covariances is larger than that in means
            by 1 - alpha^2 + beta.
        kappa: second scaling, above -x.
    """

    alpha: float = static(default=1.0)
    beta: float = static(default=2.0)
    kappa: float = static(default=0.0)

    def check(self, asked_by: str) -> None:
        """See `Rule`."""
        checks.above_zero(f"{asked_by} alpha", self.alpha)

    def check_size(self, asked_by: str, size: int) -> None:
        """See `Rule`."""
        if not size + self.kappa > 0:
            checks.refuse(f"{asked_by} kappa", f"a number above -{size} (minus the number of states)", self.kappa)

    def points(self, size: int) -> Points:
        """See `SigmaPoints`."""
        square = self.alpha**2 * (size + self.kappa)
        axes = np.sqrt(square) * np.eye(size)
        return Points(np.hstack([axes, -axes]), np.full(2 * size, 0.5 / square), self.beta - self.alpha**2)


@record
class Cubature(SigmaPoints):
    """The third-degree spherical-radial rule: 2 x points at the distance sqrt(x) (Arasaratnam, Haykin 2009, equation 24)."""

    def points(self, size: int) -> Points:
        """See `SigmaPoints`."""
        return Unscented(1.0, 0.0, 0.0).points(size)


@record
class GaussHermite(SigmaPoints):
    """Every combination of the `degree` Gauss-Hermite points of each axis (Ito, Xiong 2000).

    Attributes:
        degree: points per state, at least 2; moments are exact for polynomials up to the degree 2 `degree` - 1 in each state.
    """

    degree: int = static(default=3)

    def check(self, asked_by: str) -> None:
        """See `Rule`."""
        checks.positive_integer(f"{asked_by} degree", self.degree)
        if self.degree < 2:
            checks.refuse(f"{asked_by} degree", "at least 2 points per state", self.degree)

    def check_size(self, asked_by: str, size: int) -> None:
        """See `Rule`."""
        if self.degree**size > MOST:
            hint = "Use CubatureKalmanFilter or UnscentedKalmanFilter."
            checks.refuse(f"{asked_by} degree", f"at most {MOST} points", f"{self.degree}^{size}", hint)

    def points(self, size: int) -> Points:
        """See `SigmaPoints`."""
        points, weights = np.polynomial.hermite_e.hermegauss(self.degree)
        nodes = np.array(list(product(points, repeat=size))).T
        masses = np.prod(np.array(list(product(weights / weights.sum(), repeat=size))), axis=1)
        away = np.any(np.abs(nodes) > 1e-9, axis=0)
        return Points(nodes[:, away], masses[away])


def regressed(part: Conditional, points: Points, law: Gaussian, factor: jax.Array, u: Any, t: Any) -> tuple[Regression, jax.Array]:
    """Regress a conditional on the states over sigma points of one Gaussian with the Cholesky factor `(x, x)`.

    Returns:
        The regression, and the mean of the conditional's own noise covariance over the points, `(z, z)`.
    """
    nodes, weights = jnp.asarray(points.nodes, factor.dtype), jnp.asarray(points.weights, factor.dtype)
    X = law.center[:, None] + jnp.concatenate([jnp.zeros_like(law.center)[:, None], linalg.product(factor, nodes)], axis=1)
    values = over_particles(part.mean, X, u, t)
    off = part.residual(values[:, 1:], values[:, :1])
    offset = linalg.times_vector(off, weights)
    slope = linalg.product_transposed(off * weights, nodes)
    rest = off - linalg.product(slope, nodes)
    unexplained = linalg.rank_update(linalg.product_transposed(rest * weights, rest), offset, points.offset)
    own = matrix_over(part.cov, X, u, t)
    if own.ndim == 3:
        own = own[..., 0] + (own[..., 1:] - own[..., :1]) @ weights
    return Regression(values[:, 0] + offset, slope, unexplained), own


def regressed_on(sensor: AdditiveGaussian, states: Sequence[int], centers: jax.Array, factor: jax.Array, u: Any, t: Any) -> Regression:
    """Regress a conditional on some of the states over sigma points of each of n Gaussians.

    With L the Cholesky factor of the covariance of the k states and s^2 = max(3, k), the points are the mean (weight 1 - k / s^2) and the
    mean plus and minus s times each column of L (weights 1 / (2 s^2)) (Julier, Uhlmann 1997), which is `Unscented(1, 0, s^2 - k)` in these
    states. Exact for sensors of second degree.

    Args:
        sensor: the conditional.
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
    offset = sum((even[:, j] for j in range(len(states))), jnp.zeros_like(middle)) / step
    # weighted mean of squares less square of the mean; what the slope explains, the odd parts, has dropped out of the difference
    unexplained = linalg.product_transposed(even, even) - offset[:, None] * offset[None]
    return Regression(middle + offset, odd, unexplained)


def unscaled(scaled_slope: jax.Array, factor: jax.Array) -> jax.Array:
    """Return the slope `(z, k, *n)` from that per standard deviation, slope times L, and the factor L `(k, k, *n)`."""
    return linalg.transpose(linalg.solve_upper(factor, linalg.transpose(scaled_slope)))


def through_on(dynamics: AdditiveGaussian, states: Sequence[int], laws: Gaussian, u: Any, t: Any) -> Gaussian:
    """Move each of a batch of Gaussians by the dynamics regressed on some of the states (see `regressed_on`).

    Args:
        dynamics: with additive Gaussian noise.
        states: indices of the k states that are regressed on; in the others the slope is that at the mean.
        laws: means `(x, n)`, covariances `(x, x, n)`.
        u: inputs of the step.
        t: the time moved to.
    """
    size = laws.center.shape[0]
    others = tuple(i for i in range(size) if i not in states)
    factor = linalg.cholesky(linalg.take(linalg.take(laws.covariance, states), states, axis=1))
    prediction, scaled_slope, unexplained = regressed_on(dynamics, states, laws.center, factor, u, t)
    straight = slope_in(dynamics, others, laws.center, u, t)
    slope = linalg.take(jnp.concatenate([straight, unscaled(scaled_slope, factor)], axis=1), user_order(tuple(states), size), axis=1)
    return Linearized(prediction, slope, linalg.add(unexplained, matrix_over(dynamics.Q, laws.center, u, t))).over(laws)
