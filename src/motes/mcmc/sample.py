"""The one loop over the steps of chains."""

import math
from collections.abc import Iterator
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from motes.core import checks, random
from motes.core.devices import laid_out
from motes.core.progress import tracked
from motes.core.record import is_function, record, static
from motes.core.settings import enforced, in_force
from motes.core.types import KeyLike
from motes.core.watchdog import watched
from motes.core.workers import Workers
from motes.mcmc import continuing, judgement
from motes.mcmc.chains import Chains, joined
from motes.mcmc.interface import Info, Kernel, LogDensity, State, as_kernel, check_start
from motes.models.canonical import shape_of
from motes.tracing.compiling import jitted
from motes.tracing.identity import Beside, canonical_function

PIECES, MOST_PIECES = 20, 200
"""Chains are drawn in about so many pieces, at most as many as the second, for progress and so that an interruption loses little."""


@record
class Target:
    """The log density as an argument of compiled code: a function is structure, a record with data in it is data."""

    log_density: Any
    beside: Beside = static()


def sample(
    key: KeyLike, kernel: Kernel, log_density: LogDensity, init: Any, draws: int = 1_000, chains: int = 4, burn_in: int = 1_000
) -> Chains:
    """Draw Markov chains that leave a density as it is; all chains at once, on all of the devices of `with mo.devices(8):`.

    Shows progress where the error stream is a terminal. Interrupted (Ctrl-C), it gives what was drawn so far, with a warning. Thin with
    `mcmc.Repeat`. Chains of pieces are joined by `mcmc.joined`.

    Args:
        key: JAX key or integer seed.
        kernel: what makes a step, such as `mcmc.Adaptive(mcmc.RandomWalkMetropolis())`.
        log_density: of a position, up to a constant; -inf where it cannot be.
        init: a position (tree of arrays) where all chains start; or a function of a key that draws one for each chain; or `Chains`, to
            continue: with the same key the draws equal those of an uncut run, bit for bit; another density than theirs is refused.
        draws: kept from each chain.
        chains: how many; as many as there were when continuing.
        burn_in: steps before the first draw; none when continuing.

    Raises:
        MotesError: an argument cannot be used; the density at a start is not a finite number; the kernel does not fit.
        KeyboardInterrupt: it was interrupted before there were draws to give.
    """
    as_kernel("sample kernel", kernel)
    if not callable(log_density):
        checks.refuse("sample log_density", "a function of a position", type(log_density).__name__)
    for name, value in (("draws", draws), ("chains", chains)):
        checks.positive_integer(f"sample {name}", value)
    checks.natural("sample burn_in", burn_in)
    key = random.as_key(key)
    if isinstance(init, Chains):
        target, states, begun = _continued(kernel, log_density, init)
        pieces = _pieces(0, draws)
    else:
        positions = _starts(random.child(key, random.INITIAL), init, chains)
        first = jax.tree.map(lambda leaf: leaf[0], positions)
        target, begun = _target(kernel, log_density, positions), 0
        values = jax.vmap(target.log_density)(positions)
        checks.shape("log_density at init", values, (None,), "(one number for each chain)")
        check_start(values)
        kernel.check(random.child(key, random.WORLD), log_density, first)
        states = _states_at(random.child(key, random.FILTER), kernel, target, positions)
        # an estimate is not that of the check above
        check_start(states.log_density)
        pieces = _pieces(burn_in, draws)
    kept: list[Chains] = []
    states = laid_out(states, states.log_density.shape[0], "chains")
    try:
        for last, info, out, steps in _drawn(key, kernel, target, states, begun, pieces):
            if out is not None:
                kept.append(Chains(*out, info, last, jnp.int32(steps), kernel.moves, repr(kernel)))
    except KeyboardInterrupt:
        if not kept:
            raise KeyboardInterrupt(f"sample: interrupted before the first {pieces[-1][0]} draws; there is nothing to keep.") from None
        checks.warn(f"sample: interrupted after {int(kept[-1].steps)} steps; here are the draws so far. Continue with init=chains and the "
                    "same key.")
    return _looked_at(joined(kept))


def _looked_at(found: Chains) -> Chains:
    """Return chains; warn of what a caller should hear of at once."""
    try:
        for finding in judgement.at_once(found):
            checks.warn(str(finding))
    except KeyboardInterrupt:
        checks.warn("sample: interrupted after the last draw; here are all of them, but nobody has looked at them.")
    return found


def _drawn(
    key: jax.Array, kernel: Kernel, target: Target, states: State, begun: int, pieces: list[tuple[int, bool]]
) -> Iterator[tuple[State, Info, tuple[Any, jax.Array] | None, int]]:
    """Give states, counts, draws (None in the burn-in) and the number of steps so far after each piece, drawn by a thread of its own."""
    settings, total = in_force(), begun + sum(count for count, _ in pieces)

    def advance(states: State, begun: int, count: int) -> Any:
        with enforced(settings):
            try:
                return jax.block_until_ready(_advance(key, kernel, target, states, jnp.int32(begun), count))
            except TypeError as reason:
                continuing.explain(kernel, target.log_density, states, reason)
                raise

    with watched("sample", lambda: f"{begun} of {total} steps", "; the draws so far are kept") as progressed, Workers(1) as worker:
        for count, keep in tracked(pieces, "sampling", None):
            states, info, out = worker.submit(advance, states, begun, count).result()
            begun += count
            progressed()
            yield states, info, out if keep else None, begun


def _continued(kernel: Kernel, log_density: LogDensity, chains: Chains) -> tuple[Target, State, int]:
    """Return what to go on with, or refuse what these chains cannot go on with."""
    if not isinstance(chains.last, State):
        checks.refuse("sample init", "chains that were loaded with their kernel and log_density", "chains loaded without")
    target = _target(kernel, log_density, chains.last.position)
    shape = jax.tree.map(jax.typeof, chains.last)
    try:
        like = jax.tree.map(jax.typeof, jax.eval_shape(_states_at, random.as_key(0), kernel, target, chains.last.position))
        fits = jax.tree.map(lambda one, other: (one.shape, one.dtype) == (other.shape, other.dtype), shape, like)
    except (TypeError, ValueError):
        fits = False
    if not jax.tree.all(fits):
        checks.refuse("sample kernel", f"that of the chains, {chains.label[:200]}", f"{kernel!r}"[:200])
    anew = [_states_at(random.as_key(seed), kernel, target, chains.last.position).log_density for seed in range(2)]
    estimated = hasattr(log_density, "estimate") or not np.array_equal(*anew, equal_nan=True)
    if estimated:
        anew += [_states_at(random.as_key(seed), kernel, target, chains.last.position).log_density for seed in range(2, 8)]
    continuing.check_same(chains.last.log_density, anew, estimated)
    return target, chains.last, int(chains.steps)


def _starts(key: jax.Array, init: Any, chains: int) -> Any:
    if isinstance(init, list):
        init = checks.as_float("sample init", init)
    if is_function(init):
        return jax.jit(lambda key: jax.vmap(init)(random.step_keys(key, chains)))(key)
    try:
        position = jax.tree.map(lambda leaf: jnp.asarray(leaf) if not isinstance(leaf, float) else checks.as_float("init", leaf), init)
    except TypeError:
        checks.refuse("sample init", "a position (array, dictionary of arrays), a function of a key, or Chains", type(init).__name__)
    if not jax.tree.leaves(position):
        checks.refuse("sample init", "a position with at least one number", repr(init))
    return jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, (chains, *leaf.shape)), position)


def _target(kernel: Kernel, log_density: LogDensity, positions: Any) -> Target:
    if hasattr(log_density, "estimate") and is_function(log_density):
        checks.refuse("sample log_density", "one whose class JAX knows as a tree (it has an estimate)", type(log_density).__name__,
                      "Make it a frozen dataclass and register it by jax.tree_util.register_dataclass.")
    one = jax.tree.map(lambda leaf: jax.ShapeDtypeStruct(leaf.shape[1:], leaf.dtype), jax.tree.map(shape_of, positions))
    known = canonical_function(log_density, (one,), "log_density(position)")
    return Target(known, Beside((kernel, known)))


def _pieces(burn_in: int, draws: int) -> list[tuple[int, bool]]:
    """Split steps into pieces, of one length where that can be since each length is compiled anew; True where draws are kept."""
    common = math.gcd(burn_in, draws)
    if common * MOST_PIECES >= burn_in + draws:
        least = min(common, -(-common * PIECES // (burn_in + draws)))
        length = common // next(parts for parts in range(least, common + 1) if common % parts == 0)
        return [(length, k * length >= burn_in) for k in range((burn_in + draws) // length)]

    def split(count: int) -> int:
        return max(parts for parts in range(1, PIECES + 1) if count % parts == 0)

    return [(burn_in // split(burn_in), False)] * split(burn_in) + [(draws // split(draws), True)] * split(draws)


@jitted
def _states_at(key: jax.Array, kernel: Kernel, target: Target, positions: Any) -> State:
    keys = random.step_keys(key, jax.tree.leaves(positions)[0].shape[0])
    return jax.vmap(lambda key, position: kernel.init(key, target.log_density, position))(keys, positions)


@partial(jitted, static_argnames="count")
def _advance(
    key: jax.Array, kernel: Kernel, target: Target, states: State, begun: jax.Array, count: int
) -> tuple[State, Info, tuple[Any, jax.Array]]:
    chains = states.log_density.shape[0]
    keys = random.step_keys(key, chains)

    def advance(held: tuple[State, Info], t: jax.Array) -> tuple[tuple[State, Info], Any]:
        # the barrier keeps the compiler from fusing steps, so that a step computes the same bits in a run of any length
        states, info = jax.lax.optimization_barrier(held)
        states, more = jax.vmap(lambda key, state: kernel.step(random.step_key(key, t), target.log_density, state, t))(keys, states)
        return (states, jax.tree.map(jnp.add, info, more)), (states.position, states.log_density)

    nothing = jax.tree.map(lambda leaf: jnp.zeros((chains, *leaf.shape), leaf.dtype), Info.none(len(kernel.moves)))
    (states, info), out = jax.lax.scan(advance, (states, nothing), begun + jnp.arange(count, dtype=jnp.int32))
    return states, info, jax.tree.map(lambda leaf: jnp.moveaxis(leaf, 0, 1), out)
