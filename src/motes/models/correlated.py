"""Process noise that is correlated with the measurement noise before it, made independent (Gram-Schmidt).

With S the cross-covariance, x_t = f(x_{t-1}) + S R^-1 (y_{t-1} - h(x_{t-1})) + w is the same law given the measurements, and w, of
covariance Q - S R^-1 S', is independent of all measurement noise (Karlsson, Schon, Gustafsson 2005, after equation 5). A step then needs
the inputs and the measurement of the step before: filters hand them on with its own inputs, as one value, and the user's functions never
see them.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from motes.core import linalg
from motes.core.record import record, static
from motes.core.types import Inputs, MatrixLike
from motes.laws.conditional import AdditiveGaussian, matrix


class Augmented(NamedTuple):
    """Inputs of a step with what its process noise depends on: inputs and measurement `(y,)` of the step before."""

    now: Inputs
    before: Inputs
    y: jax.Array


def users(u: Any) -> Inputs:
    """Return the user's own inputs of those that a filter hands on: what a function of the user's is given."""
    return u.now if isinstance(u, Augmented) else u


@record
class Drive:
    """Makes the inputs of a model with independent noises of the user's.

    Attributes:
        correlated: whether the noises were correlated; the inputs are the user's own otherwise.
    """

    correlated: bool = static(default=False)

    def of(self, u: Inputs, before: Inputs, y: jax.Array) -> Any:
        """Return the inputs of one step.

        Args:
            u: the user's.
            before: the user's, of the step before.
            y: measurement of the step before, `(y,)`; NaN where nothing was measured.
        """
        return Augmented(u, before, y) if self.correlated else u

    def over(self, inputs: Inputs, ys: jax.Array | None) -> Any:
        """Return the inputs of all steps, time axis first; measurements `(t, y)` may be None where the noises were independent."""
        if not self.correlated:
            return inputs
        before, y_before = (jax.tree.map(lambda leaf: jnp.concatenate([leaf[:1], leaf[:-1]]), tree) for tree in (inputs, ys))
        return Augmented(inputs, before, y_before)


def decorrelated(
    dynamics: AdditiveGaussian, sensor: AdditiveGaussian, cross_cov: MatrixLike
) -> tuple[AdditiveGaussian, AdditiveGaussian]:
    """Return dynamics and sensor with independent noises; their inputs are `Augmented`, the user's functions get their own.

    Args:
        dynamics: with noise of covariance Q.
        sensor: with noise of covariance R.
        cross_cov: S, `(x, y)`, or a user function.
    """

    def gain(x: jax.Array, u: Augmented, t: Any) -> tuple[jax.Array, jax.Array, jax.Array]:
        """Return S R^-1 `(x, y)` with unseen components left out, the innovation, and S."""
        seen = ~jnp.isnan(u.y)
        innovation = jnp.where(seen, sensor.residual(u.y, sensor.mean(x, u.before, t - 1)), 0)
        S = jnp.where(seen[None, :], matrix(cross_cov, x, u.now, t), 0)
        R = jnp.where(seen[:, None] & seen[None, :], sensor.cov(x, u.before, t - 1), jnp.eye(seen.shape[0], dtype=x.dtype))
        return linalg.solve(linalg.cholesky(R), S.T).T, innovation, S

    def mean(x: jax.Array, u: Augmented, t: Any) -> jax.Array:
        pull, innovation, _ = gain(x, u, t)
        return dynamics.mean(x, u.now, t) + pull @ innovation

    def cov(x: jax.Array, u: Augmented, t: Any) -> jax.Array:
        pull, _, S = gain(x, u, t)
        return dynamics.cov(x, u.now, t) - linalg.symmetric(pull @ S.T)

    R = (lambda x, u, t: sensor.cov(x, u.now, t)) if callable(sensor.Q) else sensor.Q
    return AdditiveGaussian(mean, cov, dynamics.angles), AdditiveGaussian(lambda x, u, t: sensor.mean(x, u.now, t), R, sensor.angles)
