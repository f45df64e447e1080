"""The contract of Markov chain kernels: one step of a chain that leaves a density as it is (Djuric 2004, section 2.1).

A position is a tree of arrays: one array, or a dictionary of named ones. A log density is a function of a position, known up to a
constant. The density is an argument, never a field: a kernel is a frozen record of its own parameters.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree

from motes.core import checks, random
from motes.core.record import record, replace

Position = Any
LogDensity = Callable[[Any], jax.Array]


@record
class State:
    """What the next step of a chain needs.

    Attributes:
        position: tree of arrays.
        log_density: of the position, `()`.
        kernel_state: what the kernel keeps for itself: what it learns, or would have to work out again.
    """

    position: Position
    log_density: jax.Array
    kernel_state: Any = ()


@record
class Info:
    """What the moves of a kernel did in a step, or in many: each `(m,)`.

    Attributes:
        tried: how often each move was tried.
        accepted: sum of the probabilities with which they were accepted.
        invalid: how often the density of a proposed position was NaN or plus infinity, or a trajectory left all bounds; never accepted.
    """

    tried: jax.Array
    accepted: jax.Array
    invalid: jax.Array

    @classmethod
    def of_one(cls, accepted: Any, invalid: Any = False) -> "Info":
        """Return the record of a kernel with a single move."""
        return cls(jnp.ones(1), jnp.reshape(jnp.asarray(accepted, jnp.result_type(float)), 1), jnp.reshape(invalid, 1).astype(jnp.int32))

    @classmethod
    def none(cls, moves: int) -> "Info":
        """Return the record of moves that were not tried."""
        return cls(jnp.zeros(moves), jnp.zeros(moves), jnp.zeros(moves, jnp.int32))

    @classmethod
    def joined(cls, parts: list["Info"]) -> "Info":
        """Put the records of several kernels side by side."""
        return jax.tree.map(lambda *leaves: jnp.concatenate(leaves), *parts)


class Kernel(ABC):
    """A step of a Markov chain. Subclasses are records; methods are pure and work under jit and vmap.

    Attributes:
        of_one_density: whether what it keeps for itself belongs to one density, so that it can move no part of a position, whose law
            changes with the others.
    """

    of_one_density: ClassVar[bool] = False

    @property
    def moves(self) -> tuple[str, ...]:
        """Names of the moves, in the order of `Info`."""
        return (type(self).__name__,)

    def check(self, key: jax.Array, log_density: LogDensity, position: Position) -> None:  # noqa: B027 (most have nothing to check)
        """Refuse what cannot work for this density, before anything is compiled.

        Args:
            key: for trials.
            log_density: of a position.
            position: where a chain starts.

        Raises:
            MotesError: naming what is wrong.
        """

    def init_kernel_state(self, log_density: LogDensity, position: Position) -> Any:
        """Return the state of the kernel in a chain that starts at a position."""
        return ()

    def init(self, key: jax.Array, log_density: LogDensity, position: Position) -> State:
        """Return the state of a chain that starts at a position."""
        return State(position, jnp.asarray(log_density(position)), self.init_kernel_state(log_density, position))

    @abstractmethod
    def step(self, key: jax.Array, log_density: LogDensity, state: State, t: Any) -> tuple[State, Info]:
        """Make one step.

        Args:
            key: of this step.
            log_density: of a position.
            state: of the chain.
            t: number of the step, the same for all chains.
        """


class Tunable(ABC):
    """What a kernel has whose steps have a scale and a shape that `Adaptive` can learn."""

    @abstractmethod
    def target(self, size: int) -> float:
        """Acceptance probability that serves best in so many dimensions."""

    @abstractmethod
    def initial_scale(self, size: int) -> float:
        """Scale that serves best for a standard normal density in so many dimensions."""

    @abstractmethod
    def tuned(self, step_size: jax.Array, factor: jax.Array) -> Any:
        """Return the kernel with a step size `()` for densities of covariance L L', L `(x, x)` lower."""


def accept_or_stay(key: jax.Array, state: State, proposed: State, log_ratio: jax.Array) -> tuple[State, Info]:
    """Go to the proposed state with probability min(1, exp(log_ratio)), else stay (Djuric 2004, equations 5 and 8)."""
    invalid = jnp.isnan(log_ratio) | (log_ratio == jnp.inf)
    probability = jnp.where(invalid, 0, jnp.exp(jnp.minimum(log_ratio, 0)))
    taken = random.uniform(key, (), probability.dtype) < probability
    return jax.tree.map(lambda new, old: jnp.where(taken, new, old), proposed, state), Info.of_one(probability, invalid)


class Proposing(Kernel):
    """A kernel that proposes one position; subclasses write `proposed`."""

    @abstractmethod
    def proposed(self, key: jax.Array, x: jax.Array, t: Any) -> tuple[jax.Array, Any]:
        """Return a new position `(x,)` and the log of the proposals' densities, backward over forward."""

    def check(self, key: jax.Array, log_density: LogDensity, position: Position) -> None:
        """Ask for proposals that the position can hold."""
        check_whole(type(self).__name__, position, lambda x: self.proposed(key, x, 0)[0])

    def step(self, key: jax.Array, log_density: LogDensity, state: State, t: Any) -> tuple[State, Info]:
        """Make one step."""
        return self.step_by(key, lambda position: State(position, log_density(position)), state, t)

    def step_by(self, key: jax.Array, evaluate: Callable[[Position], State], state: State, t: Any) -> tuple[State, Info]:
        """Propose a position, give it to `evaluate`, which returns its state, and go there or stay."""
        x, rebuild = ravel_pytree(state.position)
        new, log_proposals = self.proposed(random.child(key, random.PREDICT), x, t)
        there = evaluate(rebuild(new))
        return accept_or_stay(random.child(key, random.UPDATE), state, there, there.log_density - state.log_density + log_proposals)


class Wrapper(Kernel):
    """A kernel around another: moves, checks, start and state are the inner one's, in what `around` puts about them."""

    kernel: Any

    @property
    def moves(self) -> tuple[str, ...]:
        """Those of the kernel."""
        return self.kernel.moves

    @property
    def of_one_density(self) -> bool:  # type: ignore[override]
        """As the kernel."""
        return self.kernel.of_one_density

    def check(self, key: jax.Array, log_density: LogDensity, position: Position) -> None:
        """Check the kernel."""
        self.kernel.check(key, log_density, position)

    def around(self, kernel_state: Any, position: Position) -> Any:
        """Return the state of this kernel with that of the inner one in it."""
        return kernel_state

    def init_kernel_state(self, log_density: LogDensity, position: Position) -> Any:
        """Return the state of the kernel in a chain that starts at a position."""
        return self.around(self.kernel.init_kernel_state(log_density, position), position)

    def init(self, key: jax.Array, log_density: LogDensity, position: Position) -> State:
        """Start as the inner kernel does."""
        inner = self.kernel.init(key, log_density, position)
        return replace(inner, kernel_state=self.around(inner.kernel_state, position))


def as_kernel(argument: str, value: Any, of_many: bool = False) -> Kernel:
    """Return a kernel.

    Args:
        argument: the argument that it was given as.
        value: what was given.
        of_many: whether it has to serve many densities.

    Raises:
        MotesError: it is none, or serves one density alone.
    """
    checks.instance(argument, value, Kernel, "a kernel such as mo.mcmc.RandomWalkMetropolis(0.5)")
    if jax.tree_util.all_leaves([value]):
        checks.refuse(argument, "a kernel that JAX knows as a tree", type(value).__name__,
                      "Make it a frozen dataclass and register it by jax.tree_util.register_dataclass.")
    if of_many and value.of_one_density:
        wanted = "a kernel whose density may change from step to step"
        checks.refuse(argument, wanted, f"{value!r}"[:200], "Put ParallelTempering around all.")
    return value


def check_start(log_density: jax.Array) -> None:
    """Refuse starts of chains, by their log densities `(chain,)`, that are not finite."""
    found = np.asarray(log_density)
    if not np.isfinite(found).all():
        chain = int(np.argmax(~np.isfinite(found)))
        checks.refuse("log_density at init", "a finite number", f"{found[chain]} for chain {chain}", "Start where the density is positive.")


def check_part(argument: str, position: Position, part: Any) -> Any:
    """Return a part of a position; see `take`.

    Raises:
        MotesError: there is no such part; an index beyond the end would read, and lose, another number without a word.
    """
    there = list(position) if isinstance(position, dict) else jax.tree.map(jnp.shape, position)
    try:
        places = () if isinstance(position, dict) or isinstance(part, str) else np.ravel(part)
        if any(not -len(position) <= place < len(position) for place in places):
            raise IndexError
        return take(position, part)
    except (KeyError, IndexError, TypeError, AttributeError):
        checks.refuse(argument, f"a part of the position ({there})", repr(part))


def check_whole(argument: str, position: Position, proposed: Callable[[jax.Array], jax.Array]) -> None:
    """Refuse proposals that are not whole where the position holds whole numbers: they would be cut off, which favors small ones.

    Args:
        argument: the kernel.
        position: where a chain starts.
        proposed: returns a proposal `(x,)` for it.
    """
    if all(jnp.issubdtype(jnp.asarray(leaf).dtype, jnp.floating) for leaf in jax.tree.leaves(position)):
        return
    x, rebuild = ravel_pytree(position)
    new = proposed(x.astype(jnp.result_type(float)))
    held = jax.tree.map(lambda leaf, old: leaf.astype(jnp.asarray(old).dtype), rebuild(new), position)
    if not bool(jnp.all(ravel_pytree(held)[0] == new)):
        checks.refuse(f"{argument} position", "real numbers, or proposals that are whole where it is", "whole numbers",
                      "Write 3.0 for 3, or draw whole numbers by a proposal of their own.")


def take(position: Position, part: Any) -> Any:
    """Return a part of a position: of a dictionary by name or names, of a record or named tuple by name, of an array by index."""
    if isinstance(position, dict):
        return {name: position[name] for name in part} if isinstance(part, tuple) else position[part]
    return getattr(position, part) if isinstance(part, str) else position[jnp.asarray(part)]


def put(position: Position, part: Any, value: Any) -> Position:
    """Return the position with a part replaced; see `take`."""
    if isinstance(position, dict):
        return {**position, **(value if isinstance(part, tuple) else {part: value})}
    if isinstance(part, str):
        return position._replace(**{part: value}) if hasattr(position, "_replace") else replace(position, **{part: value})
    return position.at[jnp.asarray(part)].set(value)
