"""Clouds of particles that carry a Gaussian each: the law of a marginalized (Rao-Blackwellized) particle filter."""

import jax
import jax.numpy as jnp

from motes.core import linalg, logspace, random, sums
from motes.core.record import record, replace, static
from motes.laws.circular import gathered
from motes.laws.cloud import Cloud, draw, weighted_moments
from motes.laws.gaussian import Gaussian
from motes.laws.law import Law


@record
class MarginalCloud(Law):
    """Weighted particles of x_p, with the Gaussian law of x_k given each.

    Attributes:
        particles: x_p, `(p, n)`.
        kalman: law of x_k given each particle: means `(k, n)`, covariance `(k, k)` shared by all or `(k, k, n)`.
        log_weights: normalized, `(n,)`.
        ancestors: index of each particle's parent at the step before, `(n,)` int32.
        order: for each state in the user's order, its place in (x_p, x_k).
    """

    weighted = marks_ancestors = True
    particles: jax.Array
    kalman: Gaussian
    log_weights: jax.Array
    ancestors: jax.Array
    order: tuple[int, ...] = static()

    @property
    def weights(self) -> jax.Array:
        """Weights that sum to one, `(n,)`."""
        return jnp.exp(self.log_weights)

    def _spread(self) -> tuple[jax.Array, jax.Array]:
        """Mean and covariance of (x_p, mean of x_k) over the particles."""
        return weighted_moments(self.log_weights, self.particles, self.kalman.center)

    def mean(self) -> jax.Array:
        """Mean of all states in the user's order, `(x,)`."""
        return linalg.take(self._spread()[0], self.order)

    def cov(self) -> jax.Array:
        """Covariance of all states in the user's order, `(x, x)`: spread of the particles plus what each Gaussian leaves."""
        p = self.particles.shape[0]
        within = self.kalman.covariance
        inside = sums.weighted_sum(within, self.weights) if within.ndim == 3 else within
        whole = self._spread()[1].at[p:, p:].add(inside)
        return linalg.take(linalg.take(whole, self.order), self.order, axis=1)

    def sample(self, key: jax.Array, n: int) -> jax.Array:
        """Draw n points of all states in the user's order, `(x, n)`."""
        chosen = self.resampled(draw(random.child(key, 0), self.log_weights, n))
        x_k = chosen.kalman.sample(random.child(key, 1), n)
        return linalg.take(jnp.concatenate([chosen.particles, x_k]), self.order)

    def weighted_points(self) -> tuple[jax.Array, jax.Array]:
        """Return particles and means of the Kalman part, in the user's order, and their log weights."""
        return linalg.take(self._concatenated(), self.order), self.log_weights

    def resampled(self, ancestors: jax.Array) -> "MarginalCloud":
        """Return the cloud of the named particles `(n,)` with their Gaussians, equal weights."""
        cov = self.kalman.covariance
        kalman = Gaussian(self.kalman.center[:, ancestors], cov[..., ancestors] if cov.ndim == 3 else cov)
        equal = logspace.uniform_weights(ancestors.shape[0], self.log_weights.dtype)
        return MarginalCloud(self.particles[:, ancestors], kalman, equal, ancestors, self.order)

    def not_resampled(self) -> "MarginalCloud":
        """Return the cloud as it is, each particle its own ancestor."""
        return replace(self, ancestors=jnp.arange(self.ancestors.shape[0], dtype=jnp.int32))

    def gathered(self, angles: tuple[int, ...]) -> "MarginalCloud":
        """Return the cloud with particles and means on one branch of the states, in the user's order, that are angles."""
        if not angles:
            return self
        return self.with_points(gathered(self._concatenated(), self.log_weights, tuple(self.order[a] for a in angles)))

    def with_points(self, points: jax.Array) -> "MarginalCloud":
        """Return the cloud with other particles and means, `(p + k, n)`."""
        p = self.particles.shape[0]
        return replace(self, particles=points[:p], kalman=Gaussian(points[p:], self.kalman.covariance))

    def inflated(self, factor: float) -> "MarginalCloud":
        """Return the cloud with the covariance of both parts times a factor."""
        spread = Cloud(self._concatenated(), self.log_weights, self.ancestors).inflated(factor).particles
        p = self.particles.shape[0]
        return replace(self, particles=spread[:p], kalman=Gaussian(spread[p:], self.kalman.covariance * factor))

    def _concatenated(self) -> jax.Array:
        return jnp.concatenate([self.particles, self.kalman.center])
