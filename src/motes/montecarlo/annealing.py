"""Simulated annealing (Kirkpatrick, Gelatt, Vecchi 1983): a Markov chain whose density is raised to a growing power finds its maximum."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from motes.core import checks, random
from motes.core.types import KeyLike
from motes.mcmc.interface import Kernel, LogDensity, State, as_kernel, check_start
from motes.tracing.compiling import jitted


class Annealed(NamedTuple):
    """What `anneal` gives.

    Attributes:
        position: the best of all chains and steps.
        log_density: there.
        best: the best of each chain, `(chain,)`; chains that end apart tell of several maxima, or of too fast a cooling.
    """

    position: Any
    log_density: float
    best: np.ndarray


def anneal(key: KeyLike, kernel: Kernel, log_density: LogDensity, init: Any, steps: int = 10_000, chains: int = 8) -> Annealed:
    """Look for the position with the largest log density.

    At step t of T the density is raised to the power 1 / c_t, with c_t from 1 down to 0.001 in equal ratios; a kernel whose steps do not
    shrink by themselves, such as a random walk, is then best mixed with one of smaller steps.

    Args:
        key: JAX key or integer seed.
        kernel: of a Markov chain.
        log_density: to be made large; a cost with its sign changed.
        init: position where all chains start.
        steps: T.
        chains: that search, each on its own.

    Raises:
        MotesError: an argument cannot be used, or the start has no finite density.
    """
    as_kernel("anneal kernel", kernel, of_many=True)
    for name, value in (("steps", steps), ("chains", chains)):
        checks.positive_integer(f"anneal {name}", value)
    position = jax.tree.map(lambda leaf: checks.as_float("anneal init", leaf), init)
    check_start(jnp.asarray(log_density(position))[None])
    key = random.as_key(key)
    kernel.check(random.child(key, random.WORLD), log_density, position)

    def one(key: jax.Array) -> tuple[Any, jax.Array]:
        def cooled(held: Any, t: jax.Array) -> tuple[Any, None]:
            position, kernel_state, best, most = held
            power = 10.0 ** (3 * t / max(steps - 1, 1))

            def raised(position: Any) -> jax.Array:
                return power * log_density(position)

            state, _ = kernel.step(random.step_key(key, t), raised, State(position, raised(position), kernel_state), t)
            value = state.log_density / power
            better = value > most
            best = jax.tree.map(lambda new, old: jnp.where(better, new, old), state.position, best)
            return (state.position, state.kernel_state, best, jnp.where(better, value, most)), None

        begun = (position, kernel.init_kernel_state(log_density, position), position, jnp.asarray(log_density(position)))
        (_, _, best, most), _ = jax.lax.scan(cooled, begun, jnp.arange(steps, dtype=jnp.int32))
        return best, most

    best, most = jitted(jax.vmap(one))(random.step_keys(key, chains))
    winner = int(jnp.argmax(most))
    return Annealed(jax.tree.map(lambda leaf: leaf[winner], best), float(most[winner]), np.asarray(most))
