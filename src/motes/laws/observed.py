"""Measurements that are no vectors: images, padded sets of plots, several sensors by name.

Those with numbers that can be NaN say by NaN what was not measured, as vectors do; an image of whole numbers cannot, so whether anything
was measured at all goes with it.
"""

from typing import Any

import jax
import jax.numpy as jnp

from motes.core.record import record


@record
class Observed:
    """One measurement of any form, or, with the time axis first, those of a run.

    Attributes:
        value: tree of arrays of any shape and type: what the user's density is given.
        there: whether anything was measured, bool `()`.
    """

    value: Any
    there: Any


def value_of(y: Any) -> Any:
    """Return a measurement as the user's functions get it."""
    return y.value if isinstance(y, Observed) else y


def is_nothing(y: Any) -> jax.Array:
    """Tell whether nothing was measured, bool `()`."""
    return ~y.there if isinstance(y, Observed) else jnp.all(jnp.isnan(y))


def nothing_like(y: Any) -> Any:
    """Return a measurement of the same form that says that nothing was measured."""

    def blank(leaf: Any) -> jax.Array:
        return jnp.full(leaf.shape, jnp.nan if jnp.issubdtype(leaf.dtype, jnp.floating) else 0, leaf.dtype)

    if isinstance(y, Observed):
        return Observed(jax.tree.map(blank, y.value), jnp.zeros((), bool))
    return blank(y)
