"""Rules by slopes: first-order Taylor expansion at the mean, exact where the conditional is linear, extended Kalman elsewhere."""

from collections.abc import Sequence
from typing import Any, ClassVar

import jax
import jax.numpy as jnp

from motes.core import checks, linalg
from motes.core.record import record, static
from motes.gaussian.rule import Linearized, Rule, conditioned
from motes.laws.conditional import Conditional, LinearGaussian, matrix
from motes.laws.gaussian import Correction, Gaussian
from motes.models.mixed_linear import user_order
from motes.tracing.affinity import dependence


@record
class Linear(Rule):
    """The slope at the mean, of models that are linear: exact, by matrices given as such or found by tracing (Kalman 1960)."""

    exact: ClassVar[bool] = True

    def linearized(self, part: Conditional, law: Gaussian, u: Any, t: Any) -> Linearized:
        """See `Rule`."""
        return affine(part, law.center, u, t)


@record
class Taylor(Rule):
    """The slope at the mean (Jazwinski 1970, Stochastic Processes and Filtering Theory), by automatic differentiation.

    Attributes:
        iterations: linearizations of the sensor in a correction: first at the mean, then at the mean that the last correction gave
            (Bell, Cathey 1993, The iterated Kalman filter update as a Gauss-Newton method). Steps are not damped.
    """

    iterations: int = static(default=1)

    def check(self, asked_by: str) -> None:
        """See `Rule`."""
        checks.positive_integer(f"{asked_by} iterations", self.iterations)

    def linearized(self, part: Conditional, law: Gaussian, u: Any, t: Any) -> Linearized:
        """See `Rule`."""
        return affine(part, law.center, u, t)

    def measured(self, sensor: Conditional, law: Gaussian, y: jax.Array, u: Any, t: Any) -> Correction:
        """See `Rule`; all corrections start from the law given."""
        done = Rule.measured(self, sensor, law, y, u, t)
        for _ in range(self.iterations - 1):
            point = done.law.center
            there = affine(sensor, point, u, t)
            at_mean = there.prediction + linalg.times_vector(there.slope, law.center - point)
            done = conditioned(sensor, law, y, there._replace(prediction=at_mean))
        return done


def affine(part: Conditional, x: jax.Array, u: Any, t: Any) -> Linearized:
    """Return value, slope and noise covariance at x `(x,)`, or at each of n states `(x, n)`; exact where the conditional is linear."""
    if x.ndim > 1:
        return jax.vmap(lambda x: affine(part, x, u, t), in_axes=-1, out_axes=-1)(x)
    if isinstance(part, LinearGaussian) and not callable(part.A):  # a function may depend on x, and then has a slope of its own
        slope = matrix(part.A, x, u, t)
        return Linearized(slope @ x, slope, part.cov(x, u, t))
    return Linearized(part.mean(x, u, t), jax.jacfwd(lambda x: part.mean(x, u, t))(x), part.cov(x, u, t))


def is_affine(part: Conditional, x: Any, u: Any, t: Any) -> bool:
    """Tell whether a conditional is a line with a noise that is the same everywhere, given arrays or their shapes and types."""
    kinds = ("elements", "fixed", "fixed")
    mean = dependence(part.mean, (x, u, t), kinds)
    return not mean.pairs.any() and not dependence(part.cov, (x, u, t), kinds).uses.any()


def slope_in(part: Conditional, states: Sequence[int], X: jax.Array, u: Any, t: Any) -> jax.Array:
    """Return the slope `(z, k, *n)` of the mean in k of the states, at X `(x,)` or `(x, n)`."""
    if X.ndim > 1:
        return jax.vmap(lambda x: slope_in(part, states, x, u, t), in_axes=-1, out_axes=-1)(X)
    rest = [i for i in range(X.shape[0]) if i not in states]
    order = user_order(tuple(states), X.shape[0])

    def mean(chosen: jax.Array) -> jax.Array:
        return part.mean(linalg.take(jnp.concatenate([linalg.take(X, rest), chosen]), order), u, t)

    return jax.jacfwd(mean)(linalg.take(X, states))
