"""The one loop forward over time."""

from collections.abc import Callable
from typing import Any, TypeVar

import jax
import jax.numpy as jnp

from motes.core.packed import Packed

C = TypeVar("C")
K = TypeVar("K")


def loop(step: Callable[[C, Any], tuple[C, K]], first: C, rows: Any, count: jax.Array | None = None) -> tuple[C, K]:
    """Go through rows one by one, handing something on from each to the next.

    Each row is fetched a step ahead: compilers would look a row up again for every particle and state that uses it.

    Args:
        step: from what is handed on and a row, to what is handed on and what is kept of the step.
        first: what the first step is handed.
        rows: tree with the time axis first.
        count: how many rows to go through, where only the compiled program knows; what is kept is then None.

    Returns:
        What the last step hands on, and what was kept with the time axis first.
    """
    if count is not None:
        last = jax.lax.fori_loop(0, count, lambda t, carry: step(carry, jax.tree.map(lambda leaf: leaf[t], rows))[0], first)
        return last, None  # type: ignore[return-value]

    def advance(held: tuple[C, Any], after: Any) -> tuple[tuple[C, Any], Packed]:
        carry, now = held
        carry, kept = step(carry, now)
        return (carry, after), Packed.of(kept)

    there = jax.tree.leaves(rows)[0].shape[0]
    after = jax.tree.map(lambda leaf: jnp.concatenate([leaf[1:], leaf[-1:]]), rows)
    now = jax.tree.map(lambda leaf: leaf[0] if there else jnp.zeros(leaf.shape[1:], leaf.dtype), rows)
    (last, _), kept = jax.lax.scan(advance, (first, now), after)
    return last, kept.whole()


def with_first(first: K, rest: K) -> K:
    """Put what was kept of a first step before what was kept of the others, time axis first."""
    return jax.tree.map(lambda one, more: jnp.concatenate([jnp.asarray(one)[None], more]), first, rest)
