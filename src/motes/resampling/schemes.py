"""How ancestors are drawn. Every scheme is unbiased: particle i gets n w_i children on average; indices come out in order, int32.

Schemes that leave particles in their places, whose indices are in no order, are in `slotwise.py`.

No scheme trusts a float32 cumulative sum: n w is split into whole numbers, summed exactly, and fractions, summed in short blocks, so that
every boundary is right to about 1e-3 children up to 1e7 particles (Douc, Cappe, Moulines 2005 compare the schemes).
"""

from abc import ABC, abstractmethod
from typing import ClassVar, NamedTuple, Protocol, TypeVar

import jax
import jax.numpy as jnp

from motes.core import checks, random
from motes.core.record import record, replace
from motes.laws.cloud import draw, last_positive, pick

_BLOCK = 1024


class Weighted(Protocol):
    """A law of n weighted particles of any kind."""

    @property
    def log_weights(self) -> jax.Array:
        """Normalized, `(n,)`."""
        ...

    def resampled(self, ancestors: jax.Array) -> "Weighted":
        """Return the law of the named particles `(n,)`, with equal weights."""
        ...

    def not_resampled(self) -> "Weighted":
        """Return the law as it is, each particle its own ancestor."""
        ...


W = TypeVar("W", bound=Weighted)


class Scheme(ABC):
    """A way of drawing ancestors.

    Attributes:
        picks: whether a particle is one of those before, as it is; not so where they are mixed.
    """

    picks: ClassVar[bool] = True

    def resampled(self, key: jax.Array, cloud: W, first: jax.Array | None) -> W:
        """Return n particles with the ancestors drawn.

        Args:
            key: JAX key.
            cloud: law of n weighted particles.
            first: normalized log weights `(n,)` that ancestors are drawn by; None for those of the cloud. A particle's weight is what its
                weight in the cloud exceeds them by.
        """
        drawn_by = cloud.log_weights if first is None else first
        ancestors = self.ancestors(key, drawn_by, drawn_by.shape[0])
        chosen: W = cloud.resampled(ancestors)  # type: ignore[assignment]
        return chosen if first is None else weighted_anew(chosen, cloud.log_weights, first, ancestors)

    @abstractmethod
    def ancestors(self, key: jax.Array, log_weights: jax.Array, n: int) -> jax.Array:
        """Draw n ancestors.

        Args:
            key: JAX key.
            log_weights: normalized log weights, any number of them.
            n: number of children.

        Returns:
            Indices `(n,)` int32; non-decreasing, except from a scheme of `slotwise.py`.
        """

    def conditional_ancestors(self, key: jax.Array, log_weights: jax.Array, fixed: jax.Array, slot: int = 0) -> jax.Array:
        """Draw n ancestors of n particles given that of one child, for conditional sequential Monte Carlo.

        The joint law is that of the scheme with its children turned by a random number of places (of `Multinomial`: shuffled), which gives
        each child the ancestor i with probability w_i (Chopin, Singh 2015; Karppinen, Singh, Vihola 2023). Offered by `Multinomial`,
        `Systematic` and `Killing`.

        Args:
            key: JAX key.
            log_weights: normalized log weights `(n,)`.
            fixed: the ancestor of that child, of positive weight.
            slot: index of the child.

        Returns:
            Indices `(n,)` int32, `fixed` at the slot.

        Raises:
            MotesError: the scheme has no conditional form.
        """
        checks.refuse("conditional_ancestors", "Multinomial, Systematic or Killing", type(self).__name__)


def weighted_anew(chosen: W, log_weights: jax.Array, drawn_by: jax.Array, ancestors: jax.Array) -> W:
    """Multiply the weights of resampled particles by what the weights of their ancestors exceed those that they were drawn by."""
    # a biased scheme may pick what has no weight: it gets none
    excess = jnp.where(drawn_by[ancestors] > -jnp.inf, (log_weights - drawn_by)[ancestors], -jnp.inf)
    return replace(chosen, log_weights=chosen.log_weights + excess)


class Boundaries(NamedTuple):
    """Cumulative sums of n w in two parts, whole and small, one entry per particle; a boundary is their sum."""

    whole: jax.Array
    part: jax.Array
    last: jax.Array
    """Index of the last particle with any weight."""


def boundaries(log_weights: jax.Array, n: int | jax.Array) -> Boundaries:
    """Sum n w without losing what float32 loses; n is the number of children, or a share of it that is no whole number."""
    weights = jnp.exp(log_weights)
    expected = weights * (n / jnp.sum(weights))
    floors = jnp.floor(expected)
    count = weights.shape[0]
    blocks = -(-count // _BLOCK)
    fractions = jnp.pad(expected - floors, (0, blocks * _BLOCK - count)).reshape(blocks, _BLOCK)
    within = jnp.cumsum(fractions, axis=1)
    before_whole = jnp.floor(within[:, -1])
    before_part = within[:, -1] - before_whole
    carried = jnp.cumsum(before_whole.astype(jnp.int32)) - before_whole.astype(jnp.int32)
    part = within + (jnp.cumsum(before_part) - before_part)[:, None]
    # not jnp.repeat: compilers work out the index that it sums up for every particle, which takes them minutes for ten million
    carried = jnp.broadcast_to(carried[:, None], (blocks, _BLOCK)).reshape(-1)[:count]
    whole = jnp.cumsum(floors.astype(jnp.int32)) + carried
    part = part.reshape(-1)[:count]
    # rounding of n w leaves the sum a little off n: spread in proportion, or the last particle would get it all
    missing = (n - whole[-1]) - part[-1]
    part = part + missing * ((whole + part) / jnp.maximum(whole[-1] + part[-1], jnp.finfo(part.dtype).tiny))
    return Boundaries(whole, part, last_positive(weights))


def ancestors_from_ends(ends: jax.Array, n: int, last: jax.Array) -> jax.Array:
    """Turn cumulative numbers of children (one per particle) into ancestors `(n,)`: each end raises the index by one."""
    raised = jnp.zeros((n,), jnp.int32).at[ends].add(1, mode="drop")
    return jnp.minimum(jnp.cumsum(raised), last).astype(jnp.int32)


@record
class Given(Scheme):
    """Ancestors that were drawn elsewhere, and the weights of their children: a stage resamples by them whatever its own weights are.

    Attributes:
        indices: `(n,)` int32, into any number of particles.
        log_weights: normalized, of the children, `(n,)`.
    """

    indices: jax.Array
    log_weights: jax.Array

    def resampled(self, key: jax.Array, cloud: W, first: jax.Array | None) -> W:
        """Give the children."""
        return replace(cloud.resampled(self.indices), log_weights=self.log_weights)  # type: ignore[return-value]

    def ancestors(self, key: jax.Array, log_weights: jax.Array, n: int) -> jax.Array:
        """Give the ancestors."""
        return self.indices


@record
class Systematic(Scheme):
    """One uniform number for all: n equally spaced points; each count is within one of n w (Kitagawa 1996).

    Source: Kitagawa 1996, Monte Carlo filter and smoother for non-Gaussian nonlinear state space models.

    Example:
        >>> filter = mo.ParticleFilter(n=1000, scheme=mo.resampling.Systematic())
    """

    def ancestors(self, key: jax.Array, log_weights: jax.Array, n: int) -> jax.Array:
        """Draw n ancestors; see `Scheme`."""
        return self.at(random.uniform(key, (), log_weights.dtype), log_weights, n)

    def at(self, u: jax.Array, log_weights: jax.Array, n: int) -> jax.Array:
        """Give the ancestors that belong to the uniform number u in [0, 1)."""
        edge = boundaries(log_weights, n)
        return ancestors_from_ends(edge.whole + jnp.ceil(edge.part - u).astype(jnp.int32), n, edge.last)

    def conditional_ancestors(self, key: jax.Array, log_weights: jax.Array, fixed: jax.Array, slot: int = 0) -> jax.Array:
        """See `Scheme`: the point of that child lies anywhere in its ancestor's share, and all points follow from it."""
        n = log_weights.shape[0]
        edge = boundaries(log_weights, n)
        before = jnp.maximum(fixed - 1, 0)
        whole, part = (jnp.where(fixed > 0, side[before], 0) for side in (edge.whole, edge.part))
        share = (edge.whole[fixed] - whole) + (edge.part[fixed] - part)
        point = part + random.uniform(key, (), log_weights.dtype) * share
        stratum = jnp.clip(whole + jnp.floor(point).astype(jnp.int32), 0, n - 1)
        drawn = jnp.roll(self.at(point - jnp.floor(point), log_weights, n), slot - stratum)
        return drawn.at[slot].set(jnp.asarray(fixed, jnp.int32))


@record
class Stratified(Scheme):
    """One uniform number in each of n equal strata (Kitagawa 1996).

    Source: Kitagawa 1996, Monte Carlo filter and smoother for non-Gaussian nonlinear state space models.

    Example:
        >>> filter = mo.ParticleFilter(n=1000, scheme=mo.resampling.Stratified())
    """

    def ancestors(self, key: jax.Array, log_weights: jax.Array, n: int) -> jax.Array:
        """Draw n ancestors; see `Scheme`."""
        points = random.uniform(key, (n,), log_weights.dtype)
        edge = boundaries(log_weights, n)
        floor = jnp.floor(edge.part)
        stratum = edge.whole + floor.astype(jnp.int32)
        beyond = edge.part - floor > points[jnp.clip(stratum, 0, n - 1)]
        return ancestors_from_ends(stratum + beyond, n, edge.last)


@record
class Multinomial(Scheme):
    """Independent draws; the simplest and the noisiest. It searches, hence is slower than the others.

    Source: Gordon, Salmond, Smith 1993, Novel approach to nonlinear/non-Gaussian Bayesian state estimation.

    Example:
        >>> filter = mo.ParticleFilter(n=1000, scheme=mo.resampling.Multinomial())
    """

    def ancestors(self, key: jax.Array, log_weights: jax.Array, n: int) -> jax.Array:
        """Draw n ancestors; see `Scheme`."""
        weights = jnp.exp(log_weights)
        counts = _independent_counts(key, weights, n, jnp.int32(n))
        return ancestors_from_ends(jnp.cumsum(counts), n, last_positive(weights))

    def conditional_ancestors(self, key: jax.Array, log_weights: jax.Array, fixed: jax.Array, slot: int = 0) -> jax.Array:
        """See `Scheme`: the other children do not look at that one."""
        drawn = draw(key, log_weights, log_weights.shape[0])
        return drawn.at[slot].set(jnp.asarray(fixed, jnp.int32))


@record
class Residual(Scheme):
    """The whole part of n w for certain, the rest by independent draws (Liu, Chen 1998). It searches, as `Multinomial` does.

    Source: Liu, Chen 1998, Sequential Monte Carlo methods for dynamic systems.

    Example:
        >>> filter = mo.ParticleFilter(n=1000, scheme=mo.resampling.Residual())
    """

    def ancestors(self, key: jax.Array, log_weights: jax.Array, n: int) -> jax.Array:
        """Draw n ancestors; see `Scheme`."""
        weights = jnp.exp(log_weights)
        expected = weights * (n / jnp.sum(weights))
        certain = jnp.floor(expected).astype(jnp.int32)
        counts = certain + _independent_counts(key, expected - certain, n, n - jnp.sum(certain))
        return ancestors_from_ends(jnp.cumsum(counts), n, last_positive(weights))


@record
class SSP(Scheme):
    """Srinivasan's sampling process: counts within one of n w, as of `Systematic`, and negatively associated in any order of particles.

    Hence it is known to converge, and its variance is at most that of `Multinomial` (Gerber, Chopin, Whiteley 2019). Fractions of n w meet
    in pairs, one pair after the other: on many particles it is much slower than the others.

    Source: Gerber, Chopin, Whiteley 2019, Negative association, ordering and convergence of resampling methods.

    Example:
        >>> filter = mo.ParticleFilter(n=1000, scheme=mo.resampling.SSP())
    """

    def ancestors(self, key: jax.Array, log_weights: jax.Array, n: int) -> jax.Array:
        """Draw n ancestors; see `Scheme`."""
        weights = jnp.exp(log_weights)
        expected = weights * (n / jnp.sum(weights))
        certain = jnp.floor(expected).astype(jnp.int32)
        size = weights.shape[0]
        uniforms = random.uniform(key, (size,), weights.dtype)

        def meet(held: tuple[jax.Array, jax.Array], other: tuple[jax.Array, ...]) -> tuple[tuple[jax.Array, jax.Array], jax.Array]:
            """Bring one of two fractions to 0, or to 1 where they exceed it; the other holds what is left and meets the next."""
            (index, p), (challenger, q, uniform) = held, other
            over = p + q > 1
            stays = jnp.where(over, uniform * (2 - p - q) >= 1 - q, uniform * (p + q) < p)
            done = jnp.where(stays, challenger, index)
            left = jnp.where(over, p + q - 1, p + q)
            return (jnp.where(stays, index, challenger), left), jnp.where(over, done, size)

        fractions = expected - certain
        start = (jnp.int32(0), fractions[0])
        (last, _), raised = jax.lax.scan(meet, start, (jnp.arange(1, size, dtype=jnp.int32), fractions[1:], uniforms[1:]))
        counts = certain.at[raised].add(1, mode="drop")
        # what rounding leaves of the last fraction is whole: it goes where the number of children asks for
        counts = counts.at[last].add(jnp.maximum(n - jnp.sum(counts), 0))
        return ancestors_from_ends(jnp.cumsum(counts), n, last_positive(weights))


def _independent_counts(key: jax.Array, weights: jax.Array, n: int, draws: jax.Array) -> jax.Array:
    """Count how often each index comes up in `draws` (at most n) independent draws in proportion to weights."""
    chosen = pick(weights, random.uniform(key, (n,), weights.dtype))
    used = jnp.arange(n) < draws
    return jnp.zeros(weights.shape, jnp.int32).at[chosen].add(used.astype(jnp.int32))
