"""Mixtures of Gaussians each of which belongs to a mode: the law of the filters for jump-Markov systems."""

import jax

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
    """

    part_modes: jax.Array
    count: int = static()

    def mode_probabilities(self, count: int = 0) -> jax.Array:
        """Probabilities of the modes, `(m,)`."""
        return mode_weights(self.part_modes, self.weights, self.count)

    def resampled(self, ancestors: jax.Array) -> "ModeMixture":
        """Return the mixture of the named components `(n,)` with their modes, and with equal weights."""
        chosen = Mixture.resampled(self, ancestors)
        return replace(self, parts=chosen.parts, log_weights=chosen.log_weights, part_modes=self.part_modes[ancestors])
