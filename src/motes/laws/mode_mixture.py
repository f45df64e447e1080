"""Mixtures of Gaussians each of which belongs to a mode: the law of the filters for jump-Markov systems."""

from collections.abc import Sequence

import jax
import jax.numpy as jnp

from motes.core import linalg
from motes.core.record import record, replace, static
from motes.laws.gaussian import Gaussian
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

    def merged(self, last: int, certain: Sequence[int] = ()) -> "ModeMixture":
        """Return the mixture in which components that agree in their last modes are one, with the moments of all of them.

        It is where the heaviest of them was, whose modes before that it keeps; the others are left without weight.

        Args:
            last: number of modes, that of this step among them; so many less one, or more, are remembered.
            certain: states without variance, at increasing indices known now, in which they have to agree, too.
        """
        heavy = jnp.maximum(self.log_weights, jnp.finfo(self.log_weights.dtype).min)
        modes, places = self.part_modes[None], jnp.arange(heavy.shape[0])
        modes = modes if self.earlier_modes is None else jnp.concatenate([modes, self.earlier_modes[: last - 1]])
        fixed = linalg.take(self.parts.center, certain)
        alike = [jnp.all(rows[:, :, None] == rows[:, None], axis=0) for rows in (modes, fixed)]
        same = (alike[0] & alike[1]) | (places[:, None] == places)
        total = jax.nn.logsumexp(jnp.where(same, self.log_weights, -jnp.inf), axis=1)
        first = jnp.argmax(jnp.where(same, heavy, -jnp.inf), axis=1)
        shares = jnp.where(same, jnp.exp(self.log_weights - jnp.where(jnp.isfinite(total), total, 0)[:, None]), 0).T
        spread = [state for state in range(self.parts.center.shape[0]) if state not in certain]
        law = self.parts.marginal(spread)
        centers, covs = self._counted(law.center), self._counted(law.covariance)
        # moments about the heaviest, which are of the size of what the components differ by
        off = centers - centers[:, first]
        middle = linalg.product(off, shares)
        second = linalg.product((covs + off[:, None] * off).reshape(-1, off.shape[1]), shares).reshape(covs.shape)
        after = Gaussian(centers + middle, linalg.mirrored(second - middle[:, None] * middle))
        weights = jnp.where(first == places, total, -jnp.inf)
        return replace(self, parts=self.parts.with_marginal(spread, after), log_weights=weights)

    def resampled(self, ancestors: jax.Array) -> "ModeMixture":
        """Return the mixture of the named components `(n,)` with their modes, and with equal weights."""
        chosen = Mixture.resampled(self, ancestors)
        earlier = None if self.earlier_modes is None else self.earlier_modes[:, ancestors]
        modes = self.part_modes[ancestors]
        return replace(self, parts=chosen.parts, log_weights=chosen.log_weights, part_modes=modes, earlier_modes=earlier)
