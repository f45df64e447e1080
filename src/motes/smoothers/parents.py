"""How the parent of a state at the next step is drawn from a cloud: P(i) ~ w_i p(x' | x_i), a value apart from the smoother.

Where the dynamics have no noise in some direction hardly any particle but the true ancestor has a density: it stays the parent where no
other has one, whatever rounding makes of its own.
"""

from abc import ABC, abstractmethod
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from motes.core import checks, logspace, pairs, random
from motes.core.record import record, static
from motes.laws.cloud import Cloud, draw, pick
from motes.laws.conditional import AdditiveGaussian, Conditional

FOLLOWED = 1e-4
"""A state that lies off what its ancestor leads to, by more than this share of the size of the states, did not come from it."""


class Move(NamedTuple):
    """A move of a cloud from one step to the next.

    Attributes:
        dynamics: with a density.
        u: inputs of the step moved to.
        t: index of the step moved to.
        size: how large the states are, `(x,)`, for what rounding makes of them; None for that of each.
    """

    dynamics: Conditional
    u: Any
    t: Any
    size: jax.Array | None = None

    def among(self, *states: jax.Array) -> "Move":
        """Return the move with the size that states `(x, n)` have, those that are numbers."""
        sizes = [jnp.max(jnp.where(jnp.isnan(X), 0, jnp.abs(X)), axis=1) for X in states]
        return self._replace(size=jnp.max(jnp.stack(sizes), axis=0))

    def log_prob(self, after: jax.Array, before: jax.Array, trusted: float | None = None) -> jax.Array:
        """Log density of states `(x, m)` given a state each `(x, m)`, as `(m,)`; or of one state `(x,)` given each of n, as `(n,)`.

        `trusted` is the share of the size that rounding may have; None for that of the type.
        """
        if isinstance(self.dynamics, AdditiveGaussian):
            return self.dynamics.log_prob(after, before, self.u, self.t, self.size, trusted)
        return self.dynamics.log_prob(after, before, self.u, self.t)

    def possible(self, after: jax.Array, before: jax.Array) -> jax.Array:
        """Tell whether states `(x, m)` may have come from a state each `(x, m)`, as `(m,)`."""
        numbers = ~jnp.any(jnp.isnan(after), axis=0)
        return numbers & (self.log_prob(after, before, FOLLOWED) > -jnp.inf) if isinstance(self.dynamics, AdditiveGaussian) else numbers


class Drawn(NamedTuple):
    """Parents of m states.

    Attributes:
        parents: indices `(m,)` int32.
        known: whether the state may have come from its parent, `(m,)`; if not, from none: it was not moved by the dynamics alone.
    """

    parents: jax.Array
    known: jax.Array


class Parents(ABC):
    """A way of drawing parents; subclasses write `chosen`."""

    def draw(self, key: jax.Array, cloud: Cloud, move: Move, after: jax.Array, ancestors: jax.Array) -> Drawn:
        """Draw a parent for each of m states; arguments are those of `chosen`."""
        move = move.among(cloud.particles, after)
        parents = self.chosen(key, cloud, move, after, ancestors)
        return Drawn(parents, move.possible(after, cloud.particles[:, parents]))

    @abstractmethod
    def chosen(self, key: jax.Array, cloud: Cloud, move: Move, after: jax.Array, ancestors: jax.Array) -> jax.Array:
        """Choose a parent for each of m states.

        Args:
            key: JAX key.
            cloud: law of n particles at the step before.
            move: the move that led to the states.
            after: the states, `(x, m)`.
            ancestors: a particle each that they may have come from, `(m,)`.

        Returns:
            Indices `(m,)` int32.
        """

    def check(self, dynamics: Conditional) -> None:  # noqa: B027 (most need nothing more than a density)
        """Refuse dynamics that the rule cannot work with."""


def _exact(cloud: Cloud, move: Move, after: jax.Array, ancestor: jax.Array, point: jax.Array) -> jax.Array:
    """Parent of one state `(x,)` that belongs to the uniform number; the ancestor where no particle has a density."""
    weights, total = logspace.normalize(cloud.log_weights + move.log_prob(after, cloud.particles))
    return jnp.where(jnp.isfinite(total), pick(jnp.exp(weights), point), ancestor)


@record
class ExactParents(Parents):
    """All n weights are worked out for each state: m n densities (Godsill, Doucet, West 2004)."""

    def chosen(self, key: jax.Array, cloud: Cloud, move: Move, after: jax.Array, ancestors: jax.Array) -> jax.Array:
        """See `Parents`."""
        points = random.uniform(key, (after.shape[-1],), after.dtype)
        return pairs.against_all(lambda pair: _exact(cloud, move, *pair), (after.T, ancestors, points), cloud.log_weights.shape[0])


@record
class RejectedParents(Parents):
    """Parents are proposed by weight and accepted by density against its largest value (Douc, Garivier, Moulines, Olsson 2011).

    As exact as `ExactParents`: states that accept none of the trials get a parent by its rule. Cheap where the dynamics' noise is wide.

    Attributes:
        trials: most proposals for each state.
    """

    trials: int = static(default=32)

    def __post_init__(self) -> None:
        """Check the parameters.

        Raises:
            MotesError: trials is not a positive whole number.
        """
        checks.positive_integer("RejectedParents trials", self.trials)

    def check(self, dynamics: Conditional) -> None:
        """Ask for a density whose largest value is known.

        Raises:
            MotesError: it is not.
        """
        if not isinstance(dynamics, AdditiveGaussian):
            checks.refuse("RejectedParents dynamics", "additive Gaussian noise (the largest density must be known)",
                          type(dynamics).__name__, "Use ExactParents or SteppedParents.")

    def chosen(self, key: jax.Array, cloud: Cloud, move: Move, after: jax.Array, ancestors: jax.Array) -> jax.Array:
        """See `Parents`."""
        m = after.shape[-1]
        most = jnp.max(move.dynamics.max_log_prob(after[:, 0], cloud.particles, move.u, move.t))

        def go_on(held: tuple[jax.Array, jax.Array, jax.Array]) -> jax.Array:
            trial, _, found = held
            return (trial < self.trials) & ~jnp.all(found)

        def propose(held: tuple[jax.Array, jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array, jax.Array]:
            trial, parents, found = held
            own = random.step_key(key, trial)
            proposed = draw(random.child(own, random.RESAMPLE), cloud.log_weights, m)
            probability = jnp.exp(move.log_prob(after, cloud.particles[:, proposed]) - most)
            accepted = random.uniform(random.child(own, random.NOISE), (m,), after.dtype) < probability
            return trial + 1, jnp.where(found, parents, proposed), found | accepted

        start = (jnp.int32(0), jnp.zeros((m,), jnp.int32), jnp.zeros((m,), bool))
        _, parents, found = jax.lax.while_loop(go_on, propose, start)
        points = random.uniform(random.child(key, random.MEASURE), (m,), after.dtype)

        def searched(row: tuple[jax.Array, ...]) -> jax.Array:
            parent, known, *rest = row
            return jax.lax.cond(known, lambda: parent, lambda: _exact(cloud, move, *rest))

        return jax.lax.map(searched, (parents, found, after.T, ancestors, points))


@record
class SteppedParents(Parents):
    """A few steps of an independence sampler from the true ancestor (Bunch, Godsill 2013): the cheapest, exact only for many particles.

    Attributes:
        steps: number of steps; two do for long runs (Dau, Chopin 2023).
    """

    steps: int = static(default=4)

    def __post_init__(self) -> None:
        """Check the parameters.

        Raises:
            MotesError: steps is not a positive whole number.
        """
        checks.positive_integer("SteppedParents steps", self.steps)

    def chosen(self, key: jax.Array, cloud: Cloud, move: Move, after: jax.Array, ancestors: jax.Array) -> jax.Array:
        """See `Parents`."""
        m = after.shape[-1]

        def step(k: jax.Array, held: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
            parents, density = held
            own = random.step_key(key, k)
            proposed = draw(random.child(own, random.RESAMPLE), cloud.log_weights, m)
            other = move.log_prob(after, cloud.particles[:, proposed])
            accepted = jnp.log(random.uniform(random.child(own, random.NOISE), (m,), after.dtype)) < other - density
            return jnp.where(accepted, proposed, parents), jnp.where(accepted, other, density)

        start = ancestors, move.log_prob(after, cloud.particles[:, ancestors])
        return jax.lax.fori_loop(0, self.steps, step, start)[0]
