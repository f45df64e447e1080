"""Averages along a Markov chain, with errors by batch means (Glynn, Whitt 1991): a pure function, for many small problems at once.

1. Leave out the first steps.
2. Average the function over each of 20 batches of consecutive draws.
3. The mean of the batches is the estimate, and their standard deviation over sqrt(20) its error.
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

from motes.core import checks, random
from motes.core.types import KeyLike
from motes.mcmc.interface import Kernel, LogDensity, State, as_kernel
from motes.montecarlo.estimate import Estimate, warned

BATCHES = 20
"""Errors are Student's with one degree of freedom less."""


def chain_expectation(
    key: KeyLike, function: Any, kernel: Kernel, log_density: LogDensity, init: Any, draws: int = 1_000, burn_in: int = 1_000
) -> Estimate:
    """Estimate the mean of a function under a density along one Markov chain, of which nothing is kept.

    Where `mo.sample` draws chains of one density, to look at, this is for many densities: under `jax.jit` and `jax.vmap` thousands of
    chains, each of its own data, are one program.

    Args:
        key: JAX key or integer seed.
        function: of a position, to a number or a vector `(m,)`.
        kernel: what makes a step.
        log_density: of a position, up to a constant.
        init: position where the chain starts.
        draws: over which is averaged, a multiple of 20.
        burn_in: steps before them.

    Returns:
        The estimate; `ess` is how many independent draws would be as good for the worst component of the function, as far as 20 batches
        can tell.

    Raises:
        MotesError: an argument cannot be used, or the kernel does not fit.
    """
    as_kernel("chain_expectation kernel", kernel)
    for name, value in (("function", function), ("log_density", log_density)):
        if not callable(value):
            checks.refuse(f"chain_expectation {name}", "a function of a position", type(value).__name__)
    checks.positive_integer("chain_expectation draws", draws)
    if draws % BATCHES:
        checks.refuse("chain_expectation draws", f"a multiple of {BATCHES}", draws)
    checks.natural("chain_expectation burn_in", burn_in)
    key, init = random.as_key(key), jax.tree.map(jnp.asarray, init)
    if checks.is_concrete((key, init)):
        kernel.check(random.child(key, random.WORLD), log_density, init)
    steps = random.child(key, random.FILTER)

    def moved(t: jax.Array, state: State) -> State:
        return kernel.step(random.step_key(steps, t), log_density, state, t)[0]

    # 1. leave out the first steps
    begun = kernel.init(random.child(key, random.INITIAL), log_density, init)
    state = jax.lax.fori_loop(0, burn_in, moved, begun)
    # squares are taken about a value of the function, so that its size costs no digits
    center = _function_at(function, state.position)
    # 2. and 3.
    means, squares = _batches(moved, function, center, state, burn_in, draws // BATCHES)
    return warned(_estimate(center, means, squares, draws), "chain_expectation")


def _function_at(function: Any, position: Any) -> jax.Array:
    value = jnp.asarray(function(position)).astype(jnp.result_type(float))
    if value.ndim > 1:
        checks.refuse("chain_expectation function", "one that gives a number or a vector", f"shape {value.shape}")
    return value


def _batches(
    moved: Callable[[jax.Array, State], State], function: Any, center: jax.Array, state: State, first: int, length: int
) -> tuple[jax.Array, jax.Array]:
    """Return means of the function less a center, and of its square, over each batch of so many draws, `(20, *m)` both."""

    def draw(t: jax.Array, held: Any) -> Any:
        state, total, square = held
        state = moved(t, state)
        off = _function_at(function, state.position) - center
        return state, total + off, square + off**2

    def batch(state: State, begin: jax.Array) -> tuple[State, Any]:
        state, total, square = jax.lax.fori_loop(begin, begin + length, draw, (state, jnp.zeros_like(center), jnp.zeros_like(center)))
        return state, (total / length, square / length)

    return jax.lax.scan(batch, state, first + length * jnp.arange(BATCHES))[1]


def _estimate(center: jax.Array, means: jax.Array, squares: jax.Array, draws: int) -> Estimate:
    off = jnp.mean(means, axis=0)
    between = jnp.var(means, axis=0, ddof=1)
    variance = jnp.mean(squares, axis=0) - off**2
    # what never changed has no error of its own, and tells nothing of how many draws count
    size = jnp.where(between > 0, jnp.clip(BATCHES * variance / jnp.where(between > 0, between, 1), 1, draws), draws)
    nothing = jnp.full((), jnp.nan, off.dtype)
    return Estimate(center + off, jnp.sqrt(between / BATCHES), draws, jnp.min(size), nothing, nothing, nothing)
