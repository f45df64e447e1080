"""Running a function of a cloud's arrays as a native kernel, beside JAX."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from motes.native import blocks
from motes.native.stage import call_move, movement

AGAINST = blocks.standing(tried=True)
needs_compiler = pytest.mark.skipif(bool(AGAINST), reason=f"no native kernels on this machine: {AGAINST}")


def natively(function, *leaves):
    """Work a function of arrays `(..., n)` out by a native kernel, each particle its own ancestor."""
    leaves = [jnp.asarray(leaf, float) for leaf in leaves]
    stage = movement(lambda *lanes: list(function(*lanes)), leaves)
    own = jnp.arange(leaves[0].shape[-1], dtype=jnp.int32)
    return [np.asarray(out) for out in call_move(stage, stage.shared, own, leaves)]


def by_jax(function, *leaves):
    return [np.asarray(out) for out in jax.jit(function)(*(jnp.asarray(leaf, float) for leaf in leaves))]


def ulps(ours, exact):
    """Distance in units in the last place of our numbers, float32 or float64; NaN and infinities must agree."""
    exact = np.asarray(exact, np.longdouble)
    with np.errstate(over="ignore"):
        rounded = exact.astype(ours.dtype)
    special = ~np.isfinite(rounded)
    assert np.array_equal(ours[special], rounded[special], equal_nan=True)
    smallest = ours.dtype.type(10 * np.finfo(ours.dtype).tiny)
    unit = np.spacing(np.maximum(np.abs(rounded[~special]), smallest)).astype(np.longdouble)
    return np.abs(ours[~special].astype(np.longdouble) - exact[~special]) / unit
