"""Mixtures of Gaussians each of which belongs to a mode: the law of the filters for jump-Markov systems."""

import jax
import jax.numpy as jnp

from motes.core.record import record, replace, static
from motes.laws.mixture import Mixture
from motes.laws.switching import mode_weights


@record
class ModeMixture(Mixture):
    """A weighted sum of n Gaussians, each the law of the states in one of m modes.

    Attributes:
        parts: batch of n Gaussians: means `(x, n)`, covariances `(x, x, n)`.
        log_weights: normalized, `(n,)`.
        part_modes: mode of each, `(n,)` int32.
        count: number m of modes.
        earlier_modes: modes of each in the steps before, the last first, `(lag, n)` int32, -1 before there was a step; None where the
            filter does not remember them.
    """

    part_modes: jax.Array
    count: int = static()
    earlier_modes: jax.Array | None = None

    def mode_probabilities(self, count: int = 0) -> jax.Array:
        """Probabilities of the modes, `(m,)`."""
        return mode_weights(self.part_modes, self.weights, self.count)

    def delayed_mode_probabilities(self) -> jax.Array | None:
        """Probabilities `(lag + 1, m)` of the modes of this step and the last ones, the newest first, given all measurements till now.

        NaN before there was a step. None where the filter remembers no modes.
        """
        if self.earlier_modes is None:
            return None
        modes = jnp.concatenate([self.part_modes[None], self.earlier_modes])
        found = jax.vmap(lambda modes: mode_weights(modes, self.weights, self.count))(modes)
        return jnp.where(modes[:, :1] < 0, jnp.nan, found)

    def resampled(self, ancestors: jax.Array) -> "ModeMixture":
        """Return the mixture of the named components `(n,)` with their modes, and with equal weights."""
        chosen = Mixture.resampled(self, ancestors)
        earlier = None if self.earlier_modes is None else self.earlier_modes[:, ancestors]
        modes = self.part_modes[ancestors]
        return replace(self, parts=chosen.parts, log_weights=chosen.log_weights, part_modes=modes, earlier_modes=earlier)
