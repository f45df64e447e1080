"""Clouds of several targets, each independent of the others."""

import jax
import jax.numpy as jnp
import numpy as np

from motes.core import random
from motes.core.record import record, replace, static
from motes.laws.cloud import Cloud
from motes.laws.law import Law


@record
class TargetClouds(Law):
    """A cloud of n weighted particles for each of several targets, which are independent.

    Attributes:
        clouds: of each target, its axis first: particles `(m, x_i, n)`, weights `(m, n)`.
        targets: indices of the states of each, in the order of its particles' rows.
    """

    clouds: Cloud
    targets: tuple[tuple[int, ...], ...] = static()

    @classmethod
    def of(cls, particles: jax.Array, targets: tuple[tuple[int, ...], ...]) -> "TargetClouds":
        """Give each target its rows of particles `(x, n)`, of equal weights."""
        return cls(jax.vmap(Cloud.equal)(particles[np.array(targets)]), targets)

    @property
    def _order(self) -> np.ndarray:
        return np.argsort(np.ravel(self.targets))

    def _in_order(self, rows: jax.Array) -> jax.Array:
        """Bring rows of the states of each target `(m, x_i, *n)` into the user's order, `(x, *n)`."""
        return rows.reshape(-1, *rows.shape[2:])[self._order]

    @property
    def particles(self) -> jax.Array:
        """Particles of all targets `(x, n)`, in the user's order of states: rows of different targets have weights of their own."""
        return self._in_order(self.clouds.particles)

    def moved(self, particles: jax.Array) -> "TargetClouds":
        """Return the law with other particles `(x, n)`, of the same weights."""
        return replace(self, clouds=replace(self.clouds, particles=particles[np.array(self.targets)]))

    def mean(self) -> jax.Array:
        """Mean, `(x,)`."""
        return self._in_order(jax.vmap(Cloud.mean)(self.clouds))

    def cov(self) -> jax.Array:
        """Covariance, `(x, x)`; zero between targets."""
        found = jax.vmap(Cloud.cov)(self.clouds)
        size = sum(map(len, self.targets))
        own = np.array(self.targets)
        return jnp.zeros((size, size), found.dtype).at[own[:, :, None], own[:, None, :]].set(found)

    def sample(self, key: jax.Array, n: int) -> jax.Array:
        """Draw n points `(x, n)`, each target's on its own."""
        keys = random.step_keys(key, len(self.targets))
        return self._in_order(jax.vmap(lambda key, cloud: cloud.sample(key, n))(keys, self.clouds))

    def weighted_points(self) -> tuple[jax.Array, jax.Array] | None:
        """Return the particles and their log weights where there is one target; those of several have none together."""
        return (self.particles, self.clouds.log_weights[0]) if len(self.targets) == 1 else None

    def gathered(self, angles: tuple[int, ...]) -> "TargetClouds":
        """Return the law with the particles of each target on one branch of the states that are angles."""
        if not angles:
            return self
        places = [tuple(own.index(angle) for angle in angles if angle in own) for own in self.targets]
        found = [jax.tree.map(lambda leaf, i=i: leaf[i], self.clouds).gathered(own) for i, own in enumerate(places)]
        return replace(self, clouds=jax.tree.map(lambda *leaves: jnp.stack(leaves), *found))

    def inflated(self, factor: float) -> "TargetClouds":
        """Return each cloud spread about its mean so that its covariance grows by a factor."""
        return replace(self, clouds=jax.vmap(lambda cloud: cloud.inflated(factor))(self.clouds))
