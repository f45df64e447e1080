"""Parallel tempering (Geyer 1991): replicas of a chain whose density is raised to powers below one, which exchange their positions.

1. Move each replica by a kernel that leaves its own power of the density as it is: the flatter ones go where the first would not.
2. Exchange the positions of neighbours i and i + 1 with probability min(1, exp((b_i - b_{i+1}) (log p_{i+1} - log p_i))); even and odd
   neighbours take turns (Okabe, Kawata, Okamoto, Mikami 2001).

The first replica has the density itself, and its positions are the chain's.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from motes.core import checks, random
from motes.core.record import record, replace, static
from motes.mcmc.interface import Info, Kernel, LogDensity, Position, State, as_kernel


class Replicas(NamedTuple):
    """What parallel tempering keeps for itself.

    Attributes:
        own: state of the kernel in the first replica.
        others: the other replicas, whose axis comes first; their log densities are those of power one.
    """

    own: Any
    others: State


@record
class ParallelTempering(Kernel):
    """A kernel in several replicas of the chain, for densities with modes that the kernel alone does not leave.

    It belongs to one density, and cannot be within a `Block`. Positions must be such that powers of the density can be summed, too.

    Source: Geyer 1991, Markov chain Monte Carlo maximum likelihood; Okabe, Kawata, Okamoto, Mikami 2001, Replica-exchange Monte Carlo
    method for the isobaric-isothermal ensemble.

    Example:
        >>> far = mo.Mixture.of([0.3, 0.7], [[-10.0, 10.0]], [[[1.0, 1.0]]])
        >>> kernel = mo.mcmc.ParallelTempering(mo.mcmc.RandomWalkMetropolis(2.0), (1.0, 0.3, 0.1, 0.03, 0.01))
        >>> chains = mo.sample(0, kernel, far.log_prob, jnp.zeros(1), draws=4_000)
        >>> bool(abs((chains.positions > 0).mean() - 0.7) < 0.1)
        True

    Attributes:
        kernel: moves each replica.
        exponents: powers of the density, the first 1, each smaller than the one before and all above zero. Neighbours should be exchanged
            in a quarter of the tries or more (`chains.acceptance`).
    """

    kernel: Kernel
    exponents: tuple[float, ...] = static()
    of_one_density = True

    def __post_init__(self) -> None:
        """Check kernel and exponents.

        Raises:
            MotesError: kernel is none, or exponents do not fall from 1 towards 0.
        """
        as_kernel("ParallelTempering kernel", self.kernel, of_many=True)
        values = np.asarray(checks.as_numbers("ParallelTempering exponents", self.exponents), float)
        if not (values.ndim == 1 and values.size > 1 and values[0] == 1 and values[-1] > 0 and (np.diff(values) < 0).all()):
            checks.refuse("ParallelTempering exponents", "two or more numbers that fall from 1 towards 0", self.exponents)
        object.__setattr__(self, "exponents", tuple(values.tolist()))

    @property
    def moves(self) -> tuple[str, ...]:
        """Those of the kernel in the first replica, and the exchanges."""
        pairs = zip(self.exponents[:-1], self.exponents[1:], strict=True)
        return (*self.kernel.moves, *(f"exchange {upper:.3g} and {lower:.3g}" for upper, lower in pairs))

    def check(self, key: jax.Array, log_density: LogDensity, position: Position) -> None:
        """Check the kernel with a power of the density."""
        self.kernel.check(key, _power(log_density, self.exponents[-1]), position)

    def init_kernel_state(self, log_density: LogDensity, position: Position) -> Replicas:
        """Start all replicas where the chain starts."""
        states = [self.kernel.init_kernel_state(_power(log_density, b), position) for b in self.exponents]
        found = jnp.asarray(log_density(position))
        return Replicas(states[0], jax.tree.map(lambda *leaves: jnp.stack(leaves), *[State(position, found, each) for each in states[1:]]))

    def step(self, key: jax.Array, log_density: LogDensity, state: State, t: Any) -> tuple[State, Info]:
        """Move each replica, and let neighbours exchange their positions."""
        held: Replicas = state.kernel_state
        first = replace(state, kernel_state=held.own)
        states = jax.tree.map(lambda one, others: jnp.concatenate([jnp.asarray(one)[None], others]), first, held.others)
        exponents = jnp.asarray(self.exponents, state.log_density.dtype)
        # 1. move each
        keys = random.step_keys(random.child(key, random.PREDICT), len(self.exponents))

        def moved(key: jax.Array, b: jax.Array, state: State) -> tuple[State, Info]:
            after, info = self.kernel.step(key, _power(log_density, b), replace(state, log_density=b * state.log_density), t)
            return replace(after, log_density=after.log_density / b), info

        states, infos = jax.vmap(moved)(keys, exponents, states)
        # 2. exchange neighbours
        order, info = self._exchanged(random.child(key, random.UPDATE), exponents, states.log_density, t)
        position, found = jax.tree.map(lambda leaf: leaf[order], (states.position, states.log_density))
        states = State(position, found, states.kernel_state)
        first, others = jax.tree.map(lambda leaf: leaf[0], states), jax.tree.map(lambda leaf: leaf[1:], states)
        own = jax.tree.map(lambda leaf: leaf[0], infos)
        return replace(first, kernel_state=Replicas(first.kernel_state, others)), Info.joined([own, info])

    def _exchanged(self, key: jax.Array, exponents: jax.Array, log_densities: jax.Array, t: Any) -> tuple[jax.Array, Info]:
        """Return which replica's position each of them gets, `(r,)`, and what the exchanges did."""
        pairs = jnp.arange(len(self.exponents) - 1)
        log_ratio = (exponents[:-1] - exponents[1:]) * (log_densities[1:] - log_densities[:-1])
        # where both densities are zero there is nothing to choose between
        probability = jnp.where(jnp.isnan(log_ratio), 0, jnp.exp(jnp.minimum(log_ratio, 0)))
        tried = (pairs % 2 == t % 2) | (len(self.exponents) == 2)
        done = tried & (random.uniform(key, pairs.shape, probability.dtype) < probability)
        none = jnp.zeros(1, bool)
        up, down = jnp.concatenate([done, none]), jnp.concatenate([none, done])
        order = jnp.arange(len(self.exponents)) + up.astype(jnp.int32) - down.astype(jnp.int32)
        return order, Info(1.0 * tried, jnp.where(tried, probability, 0), jnp.zeros(pairs.shape, jnp.int32))


def _power(log_density: LogDensity, b: Any) -> LogDensity:
    return lambda position: b * log_density(position)
