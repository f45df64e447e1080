"""Long sums over particles: block by block, since a product that runs over millions of terms in float32 loses them one by one.

An accelerator shares each product out over thousands of threads, and loses nothing.
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

from motes.core import engine

BLOCK = 65_536
"""Terms that are added in one go; the partial sums of 1e8 terms are then as few as those of one block."""


def by_blocks(partial: Callable[..., Any], *arrays: jax.Array) -> Any:
    """Sum of what `partial` gives for consecutive blocks of arrays, cut along their last axis.

    Args:
        partial: from the same block of each array to its sums, an array or a tree of them.
        arrays: `(..., n)`, all of one n.
    """
    n = arrays[0].shape[-1]
    whole = n // BLOCK
    if whole < 2 or engine.accelerated():
        return partial(*arrays)

    def add(i: Any, sums: Any) -> Any:
        return jax.tree.map(jnp.add, sums, partial(*(jax.lax.dynamic_slice_in_dim(a, i * BLOCK, BLOCK, -1) for a in arrays)))

    # the last block takes the rest with it, so that nothing is padded or copied
    last = partial(*(a[..., (whole - 1) * BLOCK :] for a in arrays))
    return jax.lax.fori_loop(0, whole - 1, add, last)


def weighted_sum(values: jax.Array, weights: jax.Array) -> jax.Array:
    """Sum of values `(..., n)` times weights `(n,)`, `(...)`."""
    return by_blocks(lambda v, w: jnp.matmul(v, w, precision=jax.lax.Precision.HIGHEST), values, weights)
