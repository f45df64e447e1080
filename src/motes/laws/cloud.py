"""Clouds of weighted particles."""

import jax
import jax.numpy as jnp

from motes.core import engine, logspace, random, sums
from motes.core.record import record, replace
from motes.laws.circular import gathered
from motes.laws.law import Law
from motes.laws.switching import mode_weights, number_of


@engine.replaceable
def weighted_moments(log_weights: jax.Array, *parts: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Mean `(x,)` and covariance `(x, x)` of points under normalized log weights `(n,)`; points come in parts `(x_1, n)`, ...

    In two passes (Chan, Golub, LeVeque 1983, Algorithms for computing the sample variance): what the first mean is off by, through rounding
    of weights and sums, is seen in the mean of the differences from it, and taken out of mean and covariance.
    """
    points, weights = jnp.concatenate(parts), jnp.exp(log_weights)
    total = jnp.sum(weights)
    total = jnp.where(total > 0, total, 1)
    mean = sums.weighted_sum(points, weights) / total

    def scatter(points: jax.Array, weights: jax.Array) -> tuple[jax.Array, jax.Array]:
        off = points - mean[:, None]
        weighted = off * weights
        return jnp.sum(weighted, axis=-1), jnp.matmul(weighted, off.T, precision=jax.lax.Precision.HIGHEST)

    missed, spread = (found / total for found in sums.by_blocks(scatter, points, weights))
    return mean + missed, spread - missed[:, None] * missed


@record
class Cloud(Law):
    """Weighted particles.

    Attributes:
        particles: `(x, n)`.
        log_weights: normalized, `(n,)`.
        ancestors: index of each particle's parent at the step before, `(n,)` int32.
    """

    weighted = marks_ancestors = True
    particles: jax.Array
    log_weights: jax.Array
    ancestors: jax.Array

    @classmethod
    def equal(cls, particles: jax.Array) -> "Cloud":
        """Give particles `(x, n)` equal weights, each its own ancestor."""
        n = particles.shape[-1]
        return cls(particles, logspace.uniform_weights(n, particles.dtype), jnp.arange(n, dtype=jnp.int32))

    @property
    def weights(self) -> jax.Array:
        """Weights that sum to one, `(n,)`."""
        return jnp.exp(self.log_weights)

    def mean(self) -> jax.Array:
        """Weighted mean, `(x,)`."""
        return weighted_moments(self.log_weights, self.particles)[0]

    def cov(self) -> jax.Array:
        """Weighted covariance, `(x, x)`."""
        return weighted_moments(self.log_weights, self.particles)[1]

    def mode_probabilities(self, count: int = 0) -> jax.Array | None:
        """Probabilities of the modes, `(count,)`; see `Law`."""
        return mode_weights(number_of(self.particles[-1], count), self.weights, count) if count else None

    def sample(self, key: jax.Array, n: int) -> jax.Array:
        """Draw n particles with replacement, `(x, n)`."""
        return self.particles[:, draw(key, self.log_weights, n)]

    def weighted_points(self) -> tuple[jax.Array, jax.Array]:
        """Return the particles and their log weights."""
        return self.particles, self.log_weights

    def resampled(self, ancestors: jax.Array) -> "Cloud":
        """Return the cloud of the named particles `(n,)`, with equal weights."""
        return Cloud(self.particles[:, ancestors], logspace.uniform_weights(ancestors.shape[0], self.particles.dtype), ancestors)

    def not_resampled(self) -> "Cloud":
        """Return the cloud as it is, each particle its own ancestor."""
        return replace(self, ancestors=jnp.arange(self.ancestors.shape[0], dtype=jnp.int32))

    def transported(self, plan: jax.Array) -> "Cloud":
        """Return the cloud of n particles, equally weighted, by a transport plan `(n, n)` of the old ones (columns sum to n w)."""
        center = self.mean()[:, None]
        moved = center + jnp.matmul(self.particles - center, plan.T, precision=jax.lax.Precision.HIGHEST)
        return Cloud.equal(moved)

    def gathered(self, angles: tuple[int, ...]) -> "Cloud":
        """Return the cloud with particles on one branch of the states that are angles."""
        return replace(self, particles=gathered(self.particles, self.log_weights, angles)) if angles else self

    def inflated(self, factor: float) -> "Cloud":
        """Return the cloud spread about its mean so that its covariance grows by a factor."""
        center = self.mean()[:, None]
        return replace(self, particles=center + jnp.sqrt(jnp.asarray(factor, self.particles.dtype)) * (self.particles - center))


def draw(key: jax.Array, log_weights: jax.Array, n: int) -> jax.Array:
    """Draw n independent indices `(n,)` int32 with the given normalized log weights."""
    return pick(jnp.exp(log_weights), random.uniform(key, (n,), log_weights.dtype))


def pick(weights: jax.Array, points: jax.Array) -> jax.Array:
    """Indices int32 that belong to uniform numbers in [0, 1), of any shape, in proportion to weights `(n,)`."""
    edges = jax.lax.cummax(jnp.cumsum(weights))
    return jnp.minimum(jnp.searchsorted(edges, points * edges[-1], side="right"), last_positive(weights)).astype(jnp.int32)


def last_positive(weights: jax.Array) -> jax.Array:
    """Index of the last weight that is not zero, `()` int32: rounding must not lead beyond it."""
    return jnp.max(jnp.where(weights > 0, jnp.arange(weights.shape[0], dtype=jnp.int32), 0))
