"""Kernels made of kernels: cycles, mixtures, repetitions, and kernels for a part of the position (Tierney 1994)."""

from collections.abc import Iterable, Mapping, Sequence
from itertools import count
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from motes.core import checks, random
from motes.core.record import record, replace, static
from motes.laws.cloud import pick
from motes.mcmc.interface import Info, Kernel, LogDensity, Position, State, Wrapper, as_kernel, check_part, put, take


class Compound(Kernel):
    """What cycles and mixtures share: several kernels, each with a state of its own."""

    kernels: tuple[Kernel, ...]

    @property
    def moves(self) -> tuple[str, ...]:
        """Those of all kernels; a name that comes again is numbered."""
        names: list[str] = []
        for move in (move for kernel in self.kernels for move in kernel.moves):
            names.append(move if move not in names else next(name for k in count(2) if (name := f"{move} {k}") not in names))
        return tuple(names)

    @property
    def of_one_density(self) -> bool:  # type: ignore[override]
        """Whether any of them is."""
        return any(kernel.of_one_density for kernel in self.kernels)

    def check(self, key: jax.Array, log_density: LogDensity, position: Position) -> None:
        """Check each kernel."""
        for kernel in self.kernels:
            kernel.check(key, log_density, position)

    def init_kernel_state(self, log_density: LogDensity, position: Position) -> Any:
        """Return the memories of all."""
        return tuple(kernel.init_kernel_state(log_density, position) for kernel in self.kernels)

    def step_of(self, place: int, key: jax.Array, log_density: LogDensity, state: State, t: Any) -> tuple[State, Info]:
        """Make a step of one kernel."""
        inner = replace(state, kernel_state=state.kernel_state[place])
        after, info = self.kernels[place].step(random.step_key(key, place), log_density, inner, t)
        kernel_state = (*state.kernel_state[:place], after.kernel_state, *state.kernel_state[place + 1 :])
        return replace(after, kernel_state=kernel_state), info


@record
class Cycle(Compound):
    """Several kernels, one after the other in every step.

    Source: Tierney 1994, Markov chains for exploring posterior distributions.

    Example:
        >>> walk = mo.mcmc.RandomWalkMetropolis(2.0)
        >>> kernel = mo.mcmc.Cycle([mo.mcmc.Block("x", walk), mo.mcmc.Block("y", walk)])
        >>> chains = mo.sample(0, kernel, lambda at: -0.5 * (at["x"] ** 2 + at["y"] ** 2), {"x": 0.0, "y": 0.0})
        >>> chains.positions["y"].shape
        (4, 1000)

    Attributes:
        kernels: in their order.
    """

    kernels: tuple[Kernel, ...]

    def __init__(self, kernels: Sequence[Kernel]):
        """Check the kernels.

        Raises:
            MotesError: there is none, or one is no kernel.
        """
        object.__setattr__(self, "kernels", _kernels("Cycle", kernels))

    def step(self, key: jax.Array, log_density: LogDensity, state: State, t: Any) -> tuple[State, Info]:
        """Make a step of each."""
        infos = []
        for place in range(len(self.kernels)):
            state, info = self.step_of(place, key, log_density, state, t)
            infos.append(info)
        return state, Info.joined(infos)


@record
class Mix(Compound):
    """One of several kernels in every step, drawn with fixed probabilities.

    Source: Tierney 1994, Markov chains for exploring posterior distributions.

    Example:
        >>> kernel = mo.mcmc.Mix([mo.mcmc.RandomWalkMetropolis(1.0), mo.mcmc.RandomWalkMetropolis(10.0)], weights=[0.8, 0.2])
        >>> chains = mo.sample(0, kernel, lambda x: -0.5 * x @ x, jnp.zeros(1))
        >>> chains.positions.shape
        (4, 1000, 1)

    Attributes:
        kernels: what there is to draw from.
        weights: their probabilities up to a factor; equal if not given.
    """

    kernels: tuple[Kernel, ...]
    weights: tuple[float, ...] = static()

    def __init__(self, kernels: Sequence[Kernel], weights: Sequence[float] | None = None):
        """Check kernels and weights.

        Raises:
            MotesError: there is none, one is no kernel, or weights do not fit.
        """
        object.__setattr__(self, "kernels", _kernels("Mix", kernels))
        chosen = tuple(float(weight) for weight in (weights if weights is not None else [1.0] * len(self.kernels)))
        if len(chosen) != len(self.kernels) or min(chosen) <= 0:
            checks.refuse("Mix weights", f"{len(self.kernels)} positive numbers, one per kernel", chosen)
        object.__setattr__(self, "weights", chosen)

    def step(self, key: jax.Array, log_density: LogDensity, state: State, t: Any) -> tuple[State, Info]:
        """Draw a kernel and make its step."""
        sizes = [len(kernel.moves) for kernel in self.kernels]

        def branch(place: int) -> Any:
            def stepped(state: State) -> tuple[State, Info]:
                after, info = self.step_of(place, key, log_density, state, t)
                return after, Info.joined([*map(Info.none, sizes[:place]), info, *map(Info.none, sizes[place + 1 :])])

            return stepped

        chosen = pick(jnp.asarray(self.weights), random.uniform(random.child(key, random.RESAMPLE), (), jnp.float32))
        return jax.lax.switch(chosen, [branch(place) for place in range(len(sizes))], state)


@record
class Block(Kernel):
    """A kernel for a part of the position, all else held fixed; several in a `Cycle` are Metropolis within Gibbs.

    Source: Tierney 1994, Markov chains for exploring posterior distributions.

    Example:
        >>> kernel = mo.mcmc.Block("x", mo.mcmc.RandomWalkMetropolis(2.0))
        >>> chains = mo.sample(0, kernel, lambda at: -0.5 * (at["x"] - at["y"]) ** 2, {"x": 0.0, "y": 5.0})
        >>> float(chains.positions["y"].max())
        5.0

    Attributes:
        part: of a dictionary a name or a tuple of names, of a record or named tuple a name, of an array an index or several.
        kernel: for the part.
    """

    part: Any = static()
    kernel: Kernel

    def __post_init__(self) -> None:
        """Check the kernel.

        Raises:
            MotesError: it is none, or serves one density alone.
        """
        as_kernel("Block kernel", self.kernel, of_many=True)
        if isinstance(self.part, (list, np.ndarray, jax.Array)):
            object.__setattr__(self, "part", tuple(np.ravel(self.part).tolist()))

    @property
    def moves(self) -> tuple[str, ...]:
        """Those of the kernel, with the part's name."""
        return tuple(f"{self.part}: {move}" for move in self.kernel.moves)

    def _given(self, log_density: LogDensity, position: Position) -> LogDensity:
        return lambda value: log_density(put(position, self.part, value))

    def check(self, key: jax.Array, log_density: LogDensity, position: Position) -> None:
        """Ask for a part that is there."""
        inner = check_part("Block part", position, self.part)
        self.kernel.check(key, self._given(log_density, position), inner)

    def init_kernel_state(self, log_density: LogDensity, position: Position) -> Any:
        """Return the state of the inner kernel."""
        return self.kernel.init_kernel_state(self._given(log_density, position), take(position, self.part))

    def step(self, key: jax.Array, log_density: LogDensity, state: State, t: Any) -> tuple[State, Info]:
        """Move the part."""
        inner = replace(state, position=take(state.position, self.part))
        after, info = self.kernel.step(key, self._given(log_density, state.position), inner, t)
        return replace(after, position=put(state.position, self.part, after.position)), info


@record
class Repeat(Wrapper):
    """Several steps of a kernel as one: thinning.

    Source: Tierney 1994, Markov chains for exploring posterior distributions.

    Example:
        >>> kernel = mo.mcmc.Repeat(mo.mcmc.RandomWalkMetropolis(2.4), times=5)
        >>> chains = mo.sample(0, kernel, lambda x: -0.5 * x @ x, jnp.zeros(1))
        >>> chains.positions.shape
        (4, 1000, 1)

    Attributes:
        kernel: whose steps they are.
        times: how many.
    """

    kernel: Kernel
    times: int = static()

    def __post_init__(self) -> None:
        """Check the parameters.

        Raises:
            MotesError: times is no positive whole number, or kernel no kernel.
        """
        as_kernel("Repeat kernel", self.kernel)
        checks.positive_integer("Repeat times", self.times)

    def step(self, key: jax.Array, log_density: LogDensity, state: State, t: Any) -> tuple[State, Info]:
        """Make all the steps."""

        def again(held: tuple[State, Info], k: jax.Array) -> tuple[tuple[State, Info], None]:
            state, info = self.kernel.step(random.step_key(key, k), log_density, held[0], t * self.times + k)
            return (state, jax.tree.map(jnp.add, held[1], info)), None

        return jax.lax.scan(again, (state, Info.none(len(self.moves))), jnp.arange(self.times, dtype=jnp.int32))[0]


def within_gibbs(kernels: Mapping[Any, Kernel]) -> Cycle:
    """Return the cycle of a kernel for each part of a position: Metropolis within Gibbs."""
    if not isinstance(kernels, Mapping):
        checks.refuse("within_gibbs kernels", "a dictionary from parts to kernels", type(kernels).__name__)
    return Cycle([Block(part, kernel) for part, kernel in kernels.items()])


def _kernels(asked_by: str, kernels: Sequence[Kernel]) -> tuple[Kernel, ...]:
    if not isinstance(kernels, Iterable):
        checks.refuse(f"{asked_by} kernels", "a list of kernels", type(kernels).__name__)
    chosen = tuple(kernels)
    for kernel in chosen:
        as_kernel(f"{asked_by} kernel", kernel)
    if not chosen:
        checks.refuse(f"{asked_by} kernels", "at least one kernel", "none")
    return chosen
