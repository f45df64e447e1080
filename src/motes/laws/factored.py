"""The Gaussian law held by a factor of its covariance: it can never lose its positive variances to rounding."""

import jax
import jax.numpy as jnp

from motes.core import linalg, random
from motes.core.record import record
from motes.laws.density import among, carried, log_density, zeroed
from motes.laws.gaussian import Correction
from motes.laws.law import Law


@record
class FactoredGaussian(Law):
    """A Gaussian law of covariance L L'.

    Attributes:
        center: mean, `(x,)`.
        factor: L, lower triangular, `(x, x)`; in float32 it keeps the digits that a covariance keeps in float64.
    """

    center: jax.Array
    factor: jax.Array

    @classmethod
    def of(cls, law: Law) -> "FactoredGaussian":
        """Return the law with the moments of another."""
        return cls(law.mean(), linalg.cholesky(law.cov()))

    def mean(self) -> jax.Array:
        """Mean, `(x,)`."""
        return self.center

    def cov(self) -> jax.Array:
        """Covariance, `(x, x)`."""
        return linalg.sandwich(self.factor, linalg.identity_like(self.factor))

    def sample(self, key: jax.Array, n: int) -> jax.Array:
        """Draw n points, `(x, n)`."""
        noise = random.normal(key, (self.center.shape[0], n), self.center.dtype)
        return self.center[:, None] + linalg.times_vector(self.factor, noise)

    def moved(self, center: jax.Array, slope: jax.Array, noise: jax.Array) -> "FactoredGaussian":
        """Return the law of a state about the center `(x,)`, moved by a slope `(x, x)` with noise of covariance `(x, x)`."""
        both = jnp.concatenate([linalg.product(slope, self.factor), linalg.cholesky(noise)], axis=1)
        terms = jnp.sqrt(linalg.reach(slope, self._deviations()) ** 2 + linalg.diagonal_of(noise))
        return FactoredGaussian(center, linalg.triangle(both, terms))

    def corrected(self, innovation: jax.Array, H: jax.Array, R: jax.Array, seen: jax.Array) -> "Correction[FactoredGaussian]":
        """Condition on an innovation `(y,)` of y = H x + e, e of covariance R `(y, y)`, as `Gaussian.corrected` does.

        The triangle of [R^1/2, H L; 0, L] holds the factors of the innovation's covariance and of the new one, and the gain between them.
        """
        innovation, H, R = zeroed(innovation, seen), zeroed(H, seen, 2), among(R, seen)
        size = innovation.shape[0]
        nothing = jnp.zeros((self.center.shape[0], size), self.factor.dtype)
        noise = linalg.cholesky(R)
        rows = [[noise, linalg.product(H, self.factor)], [nothing, self.factor]]
        terms = jnp.concatenate([jnp.sqrt(linalg.reach(H, self._deviations()) ** 2 + linalg.diagonal_of(R)), self._deviations()])
        triangle = linalg.triangle(jnp.concatenate([jnp.concatenate(row, axis=1) for row in rows]), terms)
        factor, gain, left = triangle[:size, :size], triangle[size:, :size], triangle[size:, size:]
        size, exact = linalg.times_vector(jnp.abs(H), jnp.abs(self.center)), ~(linalg.diagonal_of(noise) > 0)
        log_evidence, max_log_evidence = log_density(innovation, factor, seen, size, exact, carried(factor.dtype))
        usable = jnp.where(jnp.isfinite(innovation), innovation, 0)
        center = self.center + linalg.times_vector(gain, linalg.solve_lower(factor, usable))
        return Correction(FactoredGaussian(center, left), log_evidence, max_log_evidence)

    def _deviations(self) -> jax.Array:
        """Standard deviations of the states, `(x,)`."""
        return jnp.sqrt(jnp.sum(self.factor**2, axis=1))

    def inflated(self, factor: float) -> "FactoredGaussian":
        """Return the law with its covariance times a factor."""
        return FactoredGaussian(self.center, self.factor * jnp.sqrt(jnp.asarray(factor, self.factor.dtype)))
