"""Mixtures of Gaussians."""

from collections.abc import Sequence
from typing import Any, Self

import jax
import jax.numpy as jnp
from jax.typing import ArrayLike

from motes.core import checks, linalg, logspace, random, sums
from motes.core.record import record, replace
from motes.laws.circular import gathered
from motes.laws.cloud import draw, weighted_moments
from motes.laws.density import log_normal
from motes.laws.gaussian import Gaussian
from motes.laws.law import Law


def moments_each(log_weights: jax.Array, points: jax.Array, angles: tuple[int, ...] = ()) -> Gaussian:
    """Return the m Gaussians with the moments of m clouds `(x, n, m)`, each under its own normalized log weights `(n, m)`.

    The rows in `angles` may lie on any branch.
    """
    points = gathered(jnp.where(log_weights > -jnp.inf, points, 0), log_weights, angles)
    weights, exact = jnp.exp(log_weights), jax.lax.Precision.HIGHEST
    center = jnp.einsum("inm,nm->im", points, weights, precision=exact)
    off = points - center[:, None]
    return Gaussian(center, linalg.symmetric(jnp.einsum("inm,jnm->ijm", off * weights, off, precision=exact)))


@record
class Mixture(Law):
    """A weighted sum of n Gaussians.

    Attributes:
        parts: batch of n Gaussians: means `(x, n)`, covariance `(x, x)` or `(x, x, n)`.
        log_weights: normalized, `(n,)`.
    """

    weighted = True
    marginalizes = True  # type: ignore[override]
    parts: Gaussian
    log_weights: jax.Array

    @classmethod
    def of(cls, weights: ArrayLike | Sequence[Any], means: ArrayLike | Sequence[Any], covs: ArrayLike | Sequence[Any]) -> "Mixture":
        """Build a mixture from weights `(n,)`, means `(x, n)` and covariances `(x, x, n)`.

        Raises:
            MotesError: shapes do not fit, or weights are negative or all zero.
        """
        parts, weights = Gaussian(means, covs), checks.as_float("Mixture weights", weights)
        checks.shape("Mixture weights", weights, (parts.center.shape[-1],), "(one weight per component)")
        if checks.is_concrete(weights) and not (bool((weights >= 0).all()) and float(weights.sum()) > 0):
            checks.refuse("Mixture weights", "weights >= 0 with a positive sum", weights.tolist())
        return cls(parts, logspace.normalize(jnp.log(weights.astype(parts.center.dtype)))[0])

    @property
    def weights(self) -> jax.Array:
        """Weights that sum to one, `(n,)`."""
        return jnp.exp(self.log_weights)

    def mean(self) -> jax.Array:
        """Mean, `(x,)`."""
        return weighted_moments(self.log_weights, self._counted(self.parts.center))[0]

    def _counted(self, each: jax.Array) -> jax.Array:
        """What components `(..., n)` have that count: what is no number has zeros in place of it where the weight is zero."""
        return jnp.where(self.log_weights > -jnp.inf, each, 0)

    def cov(self) -> jax.Array:
        """Covariance within and between the components, `(x, x)`."""
        within = self.parts.covariance
        inside = sums.weighted_sum(self._counted(within), self.weights) if within.ndim == 3 else within
        return inside + weighted_moments(self.log_weights, self._counted(self.parts.center))[1]

    def sample(self, key: jax.Array, n: int) -> jax.Array:
        """Draw n points, `(x, n)`."""
        return self.resampled(draw(random.child(key, 0), self.log_weights, n)).parts.sample(random.child(key, 1), n)

    def log_prob(self, value: jax.Array) -> jax.Array:
        """Log density at `(x,)` or `(x, n)`; NaN components are left out."""
        shape = value.shape[1:]
        points = value.reshape(value.shape[0], -1)
        cov = self.parts.covariance
        if cov.ndim == 2:
            cov = jnp.broadcast_to(cov[..., None], (*cov.shape, self.log_weights.shape[0]))

        def of_one(center: jax.Array, spread: jax.Array) -> jax.Array:
            return log_normal(points - center[:, None], spread, ~jnp.isnan(points), jnp.abs(points))

        each = jax.vmap(of_one, in_axes=(-1, -1))(self.parts.center, cov)
        return jax.nn.logsumexp(each + self.log_weights[:, None], axis=0).reshape(shape)

    def weighted_points(self) -> tuple[jax.Array, jax.Array]:
        """Return the means of the components and their log weights: clusters leave out the covariances within."""
        return self._counted(self.parts.center), self.log_weights

    def resampled(self, ancestors: jax.Array) -> "Mixture":
        """Return the mixture of the named components `(n,)`, with equal weights."""
        cov = self.parts.covariance
        parts = Gaussian(self.parts.center[:, ancestors], cov[..., ancestors] if cov.ndim == 3 else cov)
        return Mixture(parts, logspace.uniform_weights(ancestors.shape[0], self.log_weights.dtype))

    def not_resampled(self) -> "Mixture":
        """Return the mixture as it is; components keep no record of their ancestors."""
        return self

    def gathered(self, angles: tuple[int, ...]) -> Self:
        """Return the mixture with means on one branch of the states that are angles."""
        if not angles:
            return self
        return replace(self, parts=Gaussian(gathered(self._counted(self.parts.center), self.log_weights, angles), self.parts.covariance))

    def inflated(self, factor: float) -> "Mixture":
        """Return the mixture with each component's covariance times a factor and the means spread to match."""
        center = self.mean()[:, None]
        spread = center + jnp.sqrt(jnp.asarray(factor, center.dtype)) * (self.parts.center - center)
        return replace(self, parts=Gaussian(spread, linalg.symmetric(self.parts.covariance * factor)))
