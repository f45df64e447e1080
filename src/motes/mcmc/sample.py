"""The one loop over the steps of chains."""

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from motes.core import checks, random
from motes.core.progress import tracked
from motes.core.record import is_function, record
from motes.core.types import KeyLike
from motes.mcmc import judgement
from motes.mcmc.chains import Chains, joined
from motes.mcmc.interface import Info, Kernel, LogDensity, State
from motes.models.canonical import canonical_function, shape_of

PIECES = 20
"""Chains are drawn in so many pieces, for progress and so that an interruption loses little."""


@record
class Target:
    """The log density as an argument of compiled code: a function is structure, a record with data in it is data."""

    log_density: Any


def sample(
    key: KeyLike, kernel: Kernel, log_density: LogDensity, init: Any, draws: int = 1_000, chains: int = 4, burn_in: int = 1_000
) -> Chains:
    """Draw Markov chains that leave a density as it is; all chains at once.

    Shows progress where the error stream is a terminal. Interrupted (Ctrl-C), it gives what was drawn so far, with a warning. Thin with
    `mcmc.Repeat`. Chains of pieces are joined by `mcmc.joined`.

    Args:
        key: JAX key or integer seed.
        kernel: what makes a step, such as `mcmc.Adaptive(mcmc.RandomWalkMetropolis())`.
        log_density: of a position, up to a constant; -inf where it cannot be.
        init: a position (tree of arrays) where all chains start; or a function of a key that draws one for each chain; or `Chains`, to
            continue: with the same key the draws equal those of an uncut run, bit for bit.
        draws: kept from each chain.
        chains: how many; as many as there were when continuing.
        burn_in: steps before the first draw; none when continuing.

    Raises:
        MotesError: an argument cannot be used; the density at a start is not a finite number; the kernel does not fit.
    """
    if not isinstance(kernel, Kernel):
        checks.refuse("sample kernel", "a kernel such as mo.mcmc.RandomWalkMetropolis(0.5)", type(kernel).__name__)
    if not callable(log_density):
        checks.refuse("sample log_density", "a function of a position", type(log_density).__name__)
    for name, value in (("draws", draws), ("chains", chains)):
        checks.positive_integer(f"sample {name}", value)
    if isinstance(burn_in, bool) or not isinstance(burn_in, (int, np.integer)) or burn_in < 0:
        checks.refuse("sample burn_in", "a whole number of at least 0", repr(burn_in))
    key = random.as_key(key)
    if isinstance(init, Chains):
        target, states, begun = _target(log_density, init.last.position), init.last, int(init.steps)
        pieces = _pieces(0, draws)
    else:
        positions = _starts(random.child(key, random.INITIAL), init, chains)
        first = jax.tree.map(lambda leaf: leaf[0], positions)
        target, begun = _target(log_density, positions), 0
        _check_density(target, positions)
        kernel.check(random.child(key, random.WORLD), log_density, first)
        states = _begin(random.child(key, random.FILTER), kernel, target, positions)
        pieces = _pieces(burn_in, draws)
    kept: list[Chains] = []
    try:
        for count, keep in tracked(pieces, "sampling", None):
            states, info, out = _advance(key, kernel, target, states, jnp.int32(begun), count, keep)
            begun += count
            if out is not None:
                jax.block_until_ready(out)
                kept.append(Chains(out[0], out[1], info, states, jnp.int32(begun), kernel.moves, repr(kernel)))
    except KeyboardInterrupt:
        if not kept:
            raise
        checks.warn(f"sample: interrupted after {begun} steps; here are the draws so far. Continue with init=chains and the same key.")
    found = joined(kept)
    for finding in judgement.at_once(found):
        checks.warn(str(finding))
    return found


def _starts(key: jax.Array, init: Any, chains: int) -> Any:
    if is_function(init):
        return jax.vmap(init)(jnp.stack([random.step_key(key, chain) for chain in range(chains)]))
    try:
        position = jax.tree.map(lambda leaf: jnp.asarray(leaf) if not isinstance(leaf, float) else checks.as_float("init", leaf), init)
    except TypeError:
        checks.refuse("sample init", "a position (array, dictionary of arrays), a function of a key, or Chains", type(init).__name__)
    if not jax.tree.leaves(position):
        checks.refuse("sample init", "a position with at least one number", repr(init))
    return jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, (chains, *leaf.shape)), position)


def _target(log_density: LogDensity, positions: Any) -> Target:
    one = jax.tree.map(lambda leaf: jax.ShapeDtypeStruct(leaf.shape[1:], leaf.dtype), jax.tree.map(shape_of, positions))
    return Target(canonical_function(log_density, (one,)))


def _check_density(target: Target, positions: Any) -> None:
    values = jax.vmap(target.log_density)(positions)
    checks.shape("log_density at init", values, (None,), "(one number for each chain)")
    found = np.asarray(values)
    if not np.isfinite(found).all():
        chain = int(np.argmax(~np.isfinite(found)))
        checks.refuse("log_density at init", "a finite number", f"{found[chain]} for chain {chain}", "Start where the density is positive.")


def _pieces(burn_in: int, draws: int) -> list[tuple[int, bool]]:
    """Split steps into pieces of equal length, since each length is compiled anew; True where draws are kept."""

    def split(count: int) -> int:
        return max(pieces for pieces in range(1, PIECES + 1) if count % pieces == 0)

    burning = [(burn_in // split(burn_in), False)] * split(burn_in) if burn_in else []
    return burning + [(draws // split(draws), True)] * split(draws)


@jax.jit
def _begin(key: jax.Array, kernel: Kernel, target: Target, positions: Any) -> State:
    chains = jax.tree.leaves(positions)[0].shape[0]
    keys = jax.vmap(lambda chain: random.step_key(key, chain))(jnp.arange(chains))
    return jax.vmap(lambda key, position: kernel.init(key, target.log_density, position))(keys, positions)


@partial(jax.jit, static_argnames=("count", "keep"))
def _advance(
    key: jax.Array, kernel: Kernel, target: Target, states: State, begun: jax.Array, count: int, keep: bool
) -> tuple[State, Info, tuple[Any, jax.Array] | None]:
    chains = states.log_density.shape[0]
    keys = jax.vmap(lambda chain: random.step_key(key, chain))(jnp.arange(chains))

    def advance(held: tuple[State, Info], t: jax.Array) -> tuple[tuple[State, Info], Any]:
        # the barrier keeps the compiler from fusing steps, so that a step computes the same bits in a run of any length
        states, info = jax.lax.optimization_barrier(held)
        states, more = jax.vmap(lambda key, state: kernel.step(random.step_key(key, t), target.log_density, state, t))(keys, states)
        return (states, jax.tree.map(jnp.add, info, more)), (states.position, states.log_density) if keep else None

    nothing = jax.tree.map(lambda leaf: jnp.zeros((chains, *leaf.shape), leaf.dtype), Info.none(len(kernel.moves)))
    (states, info), out = jax.lax.scan(advance, (states, nothing), begun + jnp.arange(count, dtype=jnp.int32))
    return states, info, jax.tree.map(lambda leaf: jnp.moveaxis(leaf, 0, 1), out)
