"""The one loop forward over time."""

from collections.abc import Callable
from typing import Any, TypeVar

import jax
import jax.numpy as jnp

from motes.core.record import record, static

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

    def advance(held: tuple[C, Any], after: Any) -> tuple[tuple[C, Any], _Packed]:
        carry, now = held
        carry, kept = step(carry, now)
        return (carry, after), _Packed.of(kept)

    there = jax.tree.leaves(rows)[0].shape[0]
    after = jax.tree.map(lambda leaf: jnp.concatenate([leaf[1:], leaf[-1:]]), rows)
    now = jax.tree.map(lambda leaf: leaf[0] if there else jnp.zeros(leaf.shape[1:], leaf.dtype), rows)
    (last, _), kept = jax.lax.scan(advance, (first, now), after)
    return last, kept.unpacked()


@record
class _Packed:
    """What a step keeps, numbers of one type together: to write one array at each step takes less time than many.

    Attributes:
        arrays: those that are none of numbers as they are, of numbers one for each type `(k,)`; of many steps with the time axis first.
        places: for each of the arrays the places of its parts among the leaves.
        tree: structure of what was kept.
    """

    arrays: tuple[jax.Array, ...]
    places: tuple[tuple[int, ...], ...] = static()
    tree: Any = static()

    @classmethod
    def of(cls, kept: Any) -> "_Packed":
        leaves, tree = jax.tree.flatten(kept)
        leaves = [jnp.asarray(leaf) for leaf in leaves]
        groups: dict[Any, list[int]] = {}
        for place, leaf in enumerate(leaves):
            groups.setdefault(leaf.dtype if leaf.ndim == 0 else place, []).append(place)
        arrays = [leaves[own[0]] if len(own) == 1 else jnp.stack([leaves[place] for place in own]) for own in groups.values()]
        return cls(tuple(arrays), tuple(map(tuple, groups.values())), tree)

    def unpacked(self) -> Any:
        """Return what was kept of all steps, with the time axis first."""
        found = [(place, rows if len(own) == 1 else rows[:, k])
                 for rows, own in zip(self.arrays, self.places, strict=True) for k, place in enumerate(own)]  # fmt: skip
        return jax.tree.unflatten(self.tree, [leaf for _, leaf in sorted(found, key=lambda one: one[0])])


def with_first(first: K, rest: K) -> K:
    """Put what was kept of a first step before what was kept of the others, time axis first."""
    return jax.tree.map(lambda one, more: jnp.concatenate([one[None], more]), first, rest)
