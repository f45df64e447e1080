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
    leaves = [jnp.asarray(leaf, jnp.float32) for leaf in leaves]
    stage = movement(lambda *lanes: list(function(*lanes)), leaves)
    own = jnp.arange(leaves[0].shape[-1], dtype=jnp.int32)
    return [np.asarray(out) for out in call_move(stage, stage.shared, own, leaves)]


def by_jax(function, *leaves):
    return [np.asarray(out) for out in jax.jit(function)(*(jnp.asarray(leaf, jnp.float32) for leaf in leaves))]


def ulps(ours, exact):
    """Distance in units in the last place of float32; NaN and infinities must agree."""
    exact = np.asarray(exact, np.float64)
    rounded = exact.astype(np.float32)
    special = ~np.isfinite(rounded)
    assert np.array_equal(ours[special], rounded[special], equal_nan=True)
    unit = np.spacing(np.maximum(np.abs(rounded[~special]), np.float32(1e-37))).astype(np.float64)
    return np.abs(ours[~special].astype(np.float64) - exact[~special]) / unit
