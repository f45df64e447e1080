"""Clouds of particles with costs in place of probabilities: the state of a cost-reference particle filter."""

import jax
import jax.numpy as jnp

from motes.core import logspace
from motes.core.record import record, replace, static
from motes.laws.circular import gathered
from motes.laws.cloud import Cloud, draw, weighted_moments
from motes.laws.law import Law


@record
class CostCloud(Law):
    """Particles, what each has cost, and weights that fall with the cost.

    Attributes:
        particles: `(x, n)`.
        log_weights: normalized, `(n,)`.
        ancestors: index of each particle's parent at the step before, `(n,)` int32.
        costs: cost of each particle's path above the smallest, `(n,)`; infinite for a particle whose cost is not a number.
        least: the smallest cost, `()`; apart from the others, so that a large one does not round their differences away.
        spread: factor on the scale of the next propagation, `(n,)`.
        at_least_cost: whether the mean is the particle of the smallest cost, not the weighted mean.
    """

    weighted = marks_ancestors = True
    particles: jax.Array
    log_weights: jax.Array
    ancestors: jax.Array
    costs: jax.Array
    least: jax.Array
    spread: jax.Array
    at_least_cost: bool = static(default=False)

    @classmethod
    def free(cls, particles: jax.Array, at_least_cost: bool) -> "CostCloud":
        """Give particles `(x, n)` no cost and equal weights."""
        cloud = Cloud.equal(particles)
        nothing = jnp.zeros_like(cloud.log_weights)
        zero = jnp.zeros((), particles.dtype)
        return cls(particles, cloud.log_weights, cloud.ancestors, nothing, zero, jnp.ones_like(nothing), at_least_cost)

    def mean(self) -> jax.Array:
        """Weighted mean, or the particle of the smallest cost, `(x,)`."""
        if self.at_least_cost:
            return self.particles[:, jnp.argmin(self.costs)]
        return weighted_moments(self.log_weights, self.particles)[0]

    def cov(self) -> jax.Array:
        """Weighted spread about `mean`, `(x, x)`; it tells how far the particles lie apart, and is no probability statement."""
        mean, cov = weighted_moments(self.log_weights, self.particles)
        off = mean - self.mean()
        return cov + off[:, None] * off[None, :]

    def sample(self, key: jax.Array, n: int) -> jax.Array:
        """Draw n particles by their weights, with replacement, `(x, n)`."""
        return self.particles[:, draw(key, self.log_weights, n)]

    def chosen(self, ancestors: jax.Array) -> "CostCloud":
        """Return the cloud of the named particles `(n,)`; they keep their costs."""
        equal = logspace.uniform_weights(ancestors.shape[0], self.log_weights.dtype)
        return replace(self, particles=self.particles[:, ancestors], log_weights=equal, ancestors=ancestors,
                       costs=self.costs[ancestors], spread=self.spread[ancestors])

    def gathered(self, angles: tuple[int, ...]) -> "CostCloud":
        """Return the cloud with particles on one branch of the states that are angles."""
        return replace(self, particles=gathered(self.particles, self.log_weights, angles)) if angles else self

    def inflated(self, factor: float) -> "CostCloud":
        """Return the cloud spread about its mean so that its covariance grows by a factor."""
        center = self.mean()[:, None]
        return replace(self, particles=center + jnp.sqrt(jnp.asarray(factor, self.particles.dtype)) * (self.particles - center))
