"""Schemes in which a particle that survives keeps its place: the ancestors of n particles come out in no order, most of them their own.

With another number of children than particles there are no places to keep: every child is drawn anew, or its chain starts anywhere.
"""

import jax
import jax.numpy as jnp

from motes.core import checks, random
from motes.core.record import record, static
from motes.laws.cloud import draw, pick
from motes.resampling.schemes import Scheme


@record
class Killing(Scheme):
    """Particle i stays with probability w_i / max w, else its place is given to a draw by weight (Del Moral 2004). Unbiased.

    Source: Del Moral 2004, Feynman-Kac Formulae: Genealogical and Interacting Particle Systems with Applications.

    Example:
        >>> filter = mo.ParticleFilter(n=1000, scheme=mo.resampling.Killing())
    """

    def ancestors(self, key: jax.Array, log_weights: jax.Array, n: int) -> jax.Array:
        """Draw n ancestors; see `Scheme`."""
        weights = jnp.exp(log_weights)
        anew = draw(random.child(key, 0), log_weights, n)
        if n != weights.shape[0]:
            return anew
        stays = random.uniform(random.child(key, 1), (n,), weights.dtype) * jnp.max(weights) < weights
        return jnp.where(stays, jnp.arange(n, dtype=jnp.int32), anew)

    def conditional_ancestors(self, key: jax.Array, log_weights: jax.Array, fixed: jax.Array, slot: int = 0) -> jax.Array:
        """See `Scheme`: that child had place j with probability (1 + [j = fixed] / max w - w_j / max w) / n before all were turned."""
        n, weights = log_weights.shape[0], jnp.exp(log_weights)
        survival = weights / jnp.max(weights)
        own = jnp.arange(n) == fixed
        turned = 1 - survival + own * jnp.sum(survival)
        place = pick(turned, random.uniform(random.child(key, 0), (), weights.dtype))
        drawn = self.ancestors(random.child(key, 1), log_weights, n)
        return jnp.roll(drawn.at[place].set(jnp.asarray(fixed, jnp.int32)), slot - place)


@record
class MetropolisResampling(Scheme):
    """A Metropolis chain over indices for each child, from its own place: no sum over all particles (Murray, Lee, Jacob 2016).

    Biased towards particles that were there: the law of a child's ancestor is within (1 - mean w / max w)^steps of the weights in total
    variation. A likelihood estimate is not unbiased with it. A chain that has met nothing with any weight is drawn by weight, sum or not.

    Source: Murray, Lee, Jacob 2016, Parallel resampling in the particle filter.

    Example:
        >>> filter = mo.ParticleFilter(n=1000, scheme=mo.resampling.MetropolisResampling())

    Attributes:
        steps: length of the chains.
    """

    steps: int = static(default=32)

    def __post_init__(self) -> None:
        """Refuse what is not a number of steps."""
        checks.positive_integer("MetropolisResampling steps", self.steps)

    def ancestors(self, key: jax.Array, log_weights: jax.Array, n: int) -> jax.Array:
        """Draw n ancestors; see `Scheme`."""
        weights = jnp.exp(jax.lax.stop_gradient(log_weights))

        def advance(step: jax.Array, at: jax.Array) -> jax.Array:
            other, uniform = _offers(random.step_key(random.child(key, 0), step), weights, n)
            # what has no weight may be left for anything
            moves = (uniform * weights[at] < weights[other]) | (weights[at] == 0)
            return jnp.where(moves, other, at)

        at = jax.lax.fori_loop(0, self.steps, advance, _starts(random.child(key, 1), weights, n))
        lost = weights[at] == 0
        return jax.lax.cond(jnp.any(lost), lambda: jnp.where(lost, draw(random.child(key, 2), log_weights, n), at), lambda: at)


@record
class RejectionResampling(Scheme):
    """Each child tries its own place first, then uniform draws, and takes i with probability w_i / max w (Murray, Lee, Jacob 2016).

    Unbiased, and without a sum over all particles but for the largest weight: it takes max w / mean w tries on average. Who has not taken
    any after `trials` is drawn by weight, sum or not, so that the bound costs time at worst, never a bias.

    Source: Murray, Lee, Jacob 2016, Parallel resampling in the particle filter.

    Example:
        >>> filter = mo.ParticleFilter(n=1000, scheme=mo.resampling.RejectionResampling())

    Attributes:
        trials: most tries of one child.
    """

    trials: int = static(default=64)

    def __post_init__(self) -> None:
        """Refuse what is not a number of trials."""
        checks.positive_integer("RejectionResampling trials", self.trials)

    def ancestors(self, key: jax.Array, log_weights: jax.Array, n: int) -> jax.Array:
        """Draw n ancestors; see `Scheme`."""
        weights = jnp.exp(jax.lax.stop_gradient(log_weights))
        top = jnp.max(weights)

        def advance(held: tuple[jax.Array, jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array, jax.Array]:
            trial, at, done = held
            offer, uniform = _offers(random.step_key(random.child(key, 0), trial), weights, n)
            at = jnp.where(done | (trial == 0), at, offer)
            return trial + 1, at, done | (uniform * top < weights[at])

        start = (jnp.int32(0), _starts(random.child(key, 1), weights, n), jnp.zeros((n,), bool))
        _, at, done = jax.lax.while_loop(lambda held: (held[0] < self.trials) & ~jnp.all(held[2]), advance, start)
        return jax.lax.cond(jnp.all(done), lambda: at, lambda: jnp.where(done, at, draw(random.child(key, 2), log_weights, n)))


def _starts(key: jax.Array, weights: jax.Array, n: int) -> jax.Array:
    """First index of each child: its own place, or any where numbers differ."""
    size = weights.shape[0]
    return jnp.arange(n, dtype=jnp.int32) if n == size else _anywhere(random.uniform(key, (n,), weights.dtype), size)


def _offers(key: jax.Array, weights: jax.Array, n: int) -> tuple[jax.Array, jax.Array]:
    """A uniform index and a uniform number for each child."""
    numbers = random.uniform(key, (2, n), weights.dtype)
    return _anywhere(numbers[0], weights.shape[0]), numbers[1]


def _anywhere(uniform: jax.Array, size: int) -> jax.Array:
    return jnp.minimum((uniform * size).astype(jnp.int32), size - 1)
