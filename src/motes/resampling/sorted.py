"""Resampling in the order of a state, so that two runs whose numbers are nearly the same pick nearly the same particles."""

import jax
import jax.numpy as jnp

from motes.core import checks
from motes.core.record import record, static
from motes.resampling.schemes import Scheme, Systematic, W, weighted_anew


@record
class Sorted(Scheme):
    """Another scheme on particles sorted by one state (Deligiannidis, Doucet, Pitt 2018, for states of one dimension).

    The likelihoods of two runs that share most of their random numbers then differ little, which is what correlated pseudo-marginal chains
    live on.

    Source: Deligiannidis, Doucet, Pitt 2018, The correlated pseudomarginal method.

    Example:
        >>> filter = mo.ParticleFilter(n=1000, scheme=mo.resampling.Sorted())

    Attributes:
        scheme: how ancestors are drawn; one whose indices come out in order, such as `Systematic`.
        by: index of the state.
    """

    scheme: Scheme = Systematic()
    by: int = static(default=0)

    def __post_init__(self) -> None:
        """Check the parameters.

        Raises:
            MotesError: the scheme is none.
        """
        if not isinstance(self.scheme, Scheme):
            checks.refuse("Sorted scheme", "a scheme such as mo.resampling.Systematic()", type(self.scheme).__name__)

    def resampled(self, key: jax.Array, cloud: W, first: jax.Array | None) -> W:
        """See `Scheme`."""
        drawn_by = cloud.log_weights if first is None else first
        particles = getattr(cloud, "particles", None)
        if particles is None or not 0 <= self.by < particles.shape[0]:
            given = type(cloud).__name__ if particles is None else f"{particles.shape[0]} states in particles"
            checks.refuse("Sorted by", f"a law of particles with a state {self.by}", given)
        order = jnp.argsort(particles[self.by])
        ancestors = order[self.scheme.ancestors(key, drawn_by[order], drawn_by.shape[0])].astype(jnp.int32)
        chosen: W = cloud.resampled(ancestors)  # type: ignore[assignment]
        return chosen if first is None else weighted_anew(chosen, cloud.log_weights, first, ancestors)

    def ancestors(self, key: jax.Array, log_weights: jax.Array, n: int) -> jax.Array:
        """Draw as the scheme does; there are no particles to sort by."""
        return self.scheme.ancestors(key, log_weights, n)
