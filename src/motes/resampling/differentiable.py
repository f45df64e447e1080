"""Resampling that derivatives pass through. Picking is a jump: with the other schemes the derivative of a likelihood leaves it out."""

from typing import Any

import jax
import jax.numpy as jnp

from motes.core import checks
from motes.core.record import record, static
from motes.laws.cloud import Cloud
from motes.resampling.schemes import Scheme, Systematic, W, weighted_anew


@record
class StopGradient(Scheme):
    """A scheme whose resampled particles keep the derivatives of their weights (Scibior, Wood 2021).

    A resampled particle weighs w / stop(w) / n, where stop(w) is w without derivatives. Values are those of the scheme, and the
    derivative of the likelihood estimate is unbiased; that of its logarithm becomes so as n grows. The variance grows with the number
    of steps.

    Source: Scibior, Wood 2021, Differentiable particle filtering without modifying the forward pass.

    Example:
        >>> filter = mo.ParticleFilter(n=1000, scheme=mo.resampling.StopGradient())

    Attributes:
        scheme: how ancestors are drawn.
    """

    scheme: Scheme = Systematic()
    has_gradient = True

    def ancestors(self, key: jax.Array, log_weights: jax.Array, n: int) -> jax.Array:
        """Draw n ancestors; see `Scheme`."""
        return self.scheme.ancestors(key, log_weights, n)

    def resampled(self, key: jax.Array, cloud: W, first: jax.Array | None) -> W:
        """See `Scheme`."""
        drawn_by = jax.lax.stop_gradient(cloud.log_weights if first is None else first)
        ancestors = self.ancestors(key, drawn_by, drawn_by.shape[0])
        return weighted_anew(cloud.resampled(ancestors), cloud.log_weights, drawn_by, ancestors)  # type: ignore[return-value]


@record
class EntropicTransport(Scheme):
    """Particles are moved, not resampled: by the plan that takes the weighted cloud to an equally weighted one at least cost.

    Reich 2013 for the plan; Corenflos, Thornton, Deligiannidis, Doucet 2021 for the entropy, which makes it differentiable. The cost is the
    squared distance over twice the number of states, each in units of its standard deviation, and `entropy` is the factor of the plan's
    entropy beside it: a small one asks for more Sinkhorn steps, a large one draws particles together. The mean is kept exactly, the
    covariance shrinks; the likelihood estimate is not unbiased. A step costs n^2, and only filters whose state is a `Cloud` can use it.

    Source: Reich 2013, A nonparametric ensemble transform method for Bayesian inference; Corenflos, Thornton, Deligiannidis, Doucet
    2021, Differentiable particle filtering via entropy-regularized optimal transport.

    Example:
        >>> filter = mo.ParticleFilter(n=1000, scheme=mo.resampling.EntropicTransport())

    Attributes:
        entropy: weight of the entropy.
        steps: Sinkhorn steps.
    """

    entropy: float = 0.1
    steps: int = static(default=50)
    has_gradient = True
    picks = False

    def __post_init__(self) -> None:
        """Refuse what cannot be."""
        checks.above_zero("EntropicTransport entropy", self.entropy)
        checks.positive_integer("EntropicTransport steps", self.steps)

    def ancestors(self, key: jax.Array, log_weights: jax.Array, n: int) -> jax.Array:
        """Refuse: no particle is resampled.

        Raises:
            MotesError: always.
        """
        checks.refuse("EntropicTransport", "a filter that moves the particles of a Cloud", "one that asks for ancestors", "Use Systematic.")

    def resampled(self, key: jax.Array, cloud: Any, first: jax.Array | None) -> Any:
        """See `Scheme`; each particle is its own ancestor."""
        if first is not None or not isinstance(cloud, Cloud):
            checks.refuse("EntropicTransport", "a filter with a Cloud that does not look ahead by scores",
                          "one with scores" if first is not None else type(cloud).__name__, "Use Systematic.")
        return cloud.transported(self.plan(cloud.log_weights, cloud.particles))

    def plan(self, log_weights: jax.Array, X: jax.Array) -> jax.Array:
        """Shares `(n, n)` of each old particle (column) in each new one (row): columns sum to n w exactly, rows to one in the limit."""
        weights = jnp.exp(log_weights)
        off = X - (X @ weights)[:, None]
        variance = (off**2) @ weights
        white = off / jnp.sqrt(jnp.where(variance > 0, variance, 1))[:, None]
        log_n = jnp.log(jnp.asarray(X.shape[-1], X.dtype))
        apart = jnp.sum((white[:, :, None] - white[:, None, :]) ** 2, axis=0) / (2 * X.shape[0] * self.entropy)

        @jax.checkpoint
        def turn(column: jax.Array, _: None) -> tuple[jax.Array, None]:
            row = -jax.nn.logsumexp(log_weights + column - apart, axis=1)
            return -jax.nn.logsumexp(row[:, None] - log_n - apart, axis=0), None

        column, _ = jax.lax.scan(turn, jnp.zeros_like(log_weights), None, self.steps)
        row = -jax.nn.logsumexp(log_weights + column - apart, axis=1)
        # the last half step is the columns': what sums to the weights keeps the mean
        shares = jax.nn.softmax(row[:, None] - apart, axis=0)
        return shares * (weights / jnp.sum(weights)) * X.shape[-1]
