"""Weights and sums in log space."""

from typing import Any, ClassVar

import jax
import jax.numpy as jnp

from motes.core import engine
from motes.core.record import record


def normalize(log_weights: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Return normalized log weights `(n,)` and the log of their former sum (minus infinity, and NaN weights, when all vanish)."""
    top = jnp.max(log_weights)
    anchor = jnp.where(jnp.isfinite(top), top, 0)
    log_sum = jnp.log(jnp.sum(jnp.exp(log_weights - anchor)))
    # the anchor goes first: a large common offset would round the small differences away
    return (log_weights - anchor) - log_sum, anchor + log_sum


@engine.replaceable
def joint_weights(log_weights: jax.Array, log_likelihood: jax.Array, max_log_likelihood: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Multiply weights by likelihoods; a likelihood that is not a number counts as zero.

    Args:
        log_weights: normalized, `(n,)`.
        log_likelihood: `(n,)`.
        max_log_likelihood: largest value the log likelihood can take, `()` or `(n,)`; infinite when not known.

    Returns:
        Normalized log weights `(n,)`, and six numbers `(6,)`: the log of the sum of weights times likelihoods, the effective sample size,
        the count of likelihoods that are not a number, the smallest and the largest log likelihood, and the smallest distance of one
        from the largest that it could be.
    """
    invalid = jnp.isnan(log_likelihood)
    log_likelihood = jnp.where(invalid, -jnp.inf, log_likelihood)
    weights, log_evidence = normalize(log_weights + log_likelihood)
    shortfall = jnp.min(jnp.where(jnp.isfinite(max_log_likelihood), max_log_likelihood - log_likelihood, 0))
    lowest, highest = jnp.min(log_likelihood), jnp.max(log_likelihood)
    return weights, jnp.stack([log_evidence, effective_size(weights), jnp.sum(invalid, dtype=weights.dtype), lowest, highest, shortfall])


def uniform_weights(n: int, dtype: jnp.dtype) -> jax.Array:
    """Return n equal normalized log weights."""
    return jnp.full((n,), -jnp.log(jnp.asarray(n, dtype)), dtype)


def effective_size(log_weights: jax.Array) -> jax.Array:
    """Effective sample size 1 / sum(w^2) of normalized log weights, between 1 and n (Kong, Liu, Wong 1994)."""
    return 1 / jnp.sum(jnp.exp(2 * log_weights))


def entropy_deficit(log_weights: jax.Array) -> jax.Array:
    """Log n minus the entropy of normalized log weights: 0 when equal, log n when one holds all (Dahia et al. 2004, criterion Ent)."""
    terms = jnp.where(jnp.isfinite(log_weights), jnp.exp(log_weights) * log_weights, 0)
    return jnp.log(jnp.asarray(log_weights.shape[0], log_weights.dtype)) + jnp.sum(terms)


@record
class RunningSum:
    """A sum over time in two numbers (Kahan): float32 loses a thousand nats in a million steps without it."""

    total: jax.Array
    missed: jax.Array
    _known: ClassVar[Any] = None

    @classmethod
    def zero(cls, dtype: jnp.dtype) -> "RunningSum":
        """Start at nothing."""
        return cls(jnp.zeros((), dtype), jnp.zeros((), dtype))

    def add(self, term: jax.Array) -> "RunningSum":
        """Add one term; an infinite term makes the sum infinite, never NaN."""
        wanted = term - self.missed
        total = self.total + wanted
        missed = (total - self.total) - wanted
        return RunningSum(total, jnp.where(jnp.isfinite(missed), missed, 0))

    def value(self) -> jax.Array:
        """Return the sum."""
        return self.total - self.missed if self._known is None else self._known

    def remember(self, value: jax.Array) -> None:
        """Keep the sum where the program that gave the two numbers gave it too: another one for it alone takes a tenth of a millisecond."""
        object.__setattr__(self, "_known", value)
