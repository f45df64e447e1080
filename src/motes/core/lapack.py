"""Decompositions by LAPACK, each matrix by itself where many at a time could stop the process for good.

In JAX before 0.12 on CPUs, what `jnp.linalg` does for many matrices at a time (under `vmap`, or with axes before the last two) is shared
out over the threads of XLA's pool by one of these threads, which then waits for the others. Where as many such calls are at hand at the
same time as there are threads, all of them wait, and none is left to do the work: the process sleeps in `block_until_ready`. A call for one
matrix is made by the thread that is there. So all of ours go through this file, in a loop over the matrices that costs about a microsecond
for each; on accelerators, and in a JAX that was mended, they stay together.
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jax.custom_batching import sequential_vmap

MENDED = (0, 12)
"""The first JAX that was never seen to stop."""


def _one_by_one(function: Callable[[jax.Array], Any]) -> Callable[[jax.Array], Any]:
    """Return a function of one matrix that does one after the other where it is mapped over many."""
    alone = sequential_vmap(function)
    return lambda a: (alone if stops() else function)(a)


def stops() -> bool:
    """Tell whether decompositions of many matrices at a time can stop the process: with this JAX, on this device."""
    return jax.__version_info__ < MENDED and jax.default_backend() == "cpu"


_inverse = _one_by_one(jnp.linalg.inv)
_log_volume = _one_by_one(lambda a: jnp.linalg.slogdet(a)[1])
_eigen = _one_by_one(lambda a: tuple(jnp.linalg.eigh(a)))


@jax.custom_jvp
def inverse(a: jax.Array) -> jax.Array:
    """Inverse of a regular matrix `(i, i)`; to be mapped over many."""
    return _inverse(a)


@inverse.defjvp
def _(primals: Any, tangents: Any) -> Any:
    found = inverse(*primals)
    return found, -found @ tangents[0] @ found


@jax.custom_jvp
def log_volume(a: jax.Array) -> jax.Array:
    """Log of the absolute value of the determinant of a matrix `(i, i)`, minus infinity where it is 0; to be mapped over many."""
    return _log_volume(a)


@log_volume.defjvp
def _(primals: Any, tangents: Any) -> Any:
    return log_volume(*primals), jnp.trace(inverse(*primals) @ tangents[0])


@jax.custom_jvp
def eigen(a: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Eigenvalues `(i,)`, ascending, and orthonormal eigenvectors as columns of a symmetric matrix `(i, i)`; to be mapped over many."""
    return _eigen(a)


@eigen.defjvp
def _(primals: Any, tangents: Any) -> Any:
    values, vectors = eigen(*primals)
    turned = vectors.T @ tangents[0] @ vectors
    apart = values - values[:, None] + jnp.eye(values.shape[0], dtype=values.dtype)
    return (values, vectors), (jnp.diagonal(turned), vectors @ (turned * (1 / apart - jnp.eye(values.shape[0], dtype=values.dtype))))
