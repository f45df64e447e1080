"""Decompositions by LAPACK against NumPy's, alone and mapped over many, with derivatives; and that nothing of ours goes past."""

import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from motes.core import lapack
from sources import SOURCE
from tiers import each

RNG = np.random.default_rng(5)
NEEDS_CARE = pytest.mark.skipif(not lapack.stops(), reason="from JAX 0.12 on many matrices at a time stop nothing")


@pytest.mark.parametrize("size", [1, 2, 5, 12])
def test_inverse_and_volume(size, double):
    A = RNG.normal(size=(6, size, size))
    A[0] = np.eye(size)[::-1]
    found, volume = jax.jit(jax.vmap(lambda a: (lapack.inverse(a), lapack.log_volume(a))))(A)
    np.testing.assert_allclose(found, np.linalg.inv(A), rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(volume, np.linalg.slogdet(A)[1], atol=1e-10)
    assert lapack.log_volume(jnp.zeros((size, size))) == -np.inf


def _three(a):
    values, vectors = lapack.eigen(a + a.T)
    return lapack.log_volume(a) + jnp.sum(jnp.sin(values)) + jnp.sum(vectors[:, 0] ** 4) + jnp.sum(lapack.inverse(a) ** 2)


def _three_by_jax(a):
    values, vectors = jnp.linalg.eigh(a + a.T)
    return jnp.linalg.slogdet(a)[1] + jnp.sum(jnp.sin(values)) + jnp.sum(vectors[:, 0] ** 4) + jnp.sum(jnp.linalg.inv(a) ** 2)


WAYS = {"grad": jax.grad, "jacfwd": jax.jacfwd, "hessian": lambda f: jax.jacfwd(jax.grad(f))}


@pytest.mark.parametrize("way", each(WAYS, {"jacfwd", "hessian"}))
def test_derivatives_are_those_of_jax_mapped_and_not(way, double):
    A = jnp.asarray(RNG.normal(size=(4, 3, 3)) + 2 * np.eye(3))
    np.testing.assert_allclose(way(_three)(A[0]), way(_three_by_jax)(A[0]), rtol=1e-6, atol=1e-8)
    np.testing.assert_allclose(jax.vmap(way(_three))(A), jax.vmap(way(_three_by_jax))(A), rtol=1e-6, atol=1e-8)


def calls(function, *arguments):
    """Shapes of the matrices that a program hands to LAPACK."""
    return re.findall(r"lapack_\w+.*?tensor<((?:\d+x)+)f", jax.jit(function).lower(*arguments).as_text())


@NEEDS_CARE
@pytest.mark.parametrize("name", ["inverse", "log_volume", "eigen"])
def test_one_matrix_at_a_time(name):
    many = jnp.ones((4, 5, 3, 3))
    ours, theirs = getattr(lapack, name), jnp.linalg.eigh
    shapes = calls(jax.vmap(jax.vmap(ours)), many)
    assert shapes and all(shape in ("3x3x", "3x") for shape in shapes)
    assert "4x5x3x3x" in calls(jax.vmap(jax.vmap(theirs)), many), "the check sees calls for many"


def test_nothing_of_ours_goes_past():
    words = re.compile(r"(jnp|jax\.numpy|jax\.scipy|jax\.lax|lax|jsp)\.(linalg|scipy\.linalg)\b|linalg import")
    past = sorted(path.name for path in SOURCE.rglob("*.py") if words.search(path.read_text()))
    assert past == ["inertial.py", "lapack.py"], "inertial.py takes SciPy's expm, while a model is built"
    assert words.search("jnp.linalg.slogdet(a)") and words.search("from jax.scipy.linalg import expm")
