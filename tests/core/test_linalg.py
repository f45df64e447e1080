"""Small-matrix algebra against NumPy, one matrix or one per particle."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from motes.core import linalg

RNG = np.random.default_rng(0)


def batch(*shape, n=5):
    return RNG.normal(size=(*shape, n))


def each(function, *arrays):
    """Apply a NumPy function to each particle's matrices; arrays without the particle axis are shared."""
    n = 5
    picked = [[a[..., i] if a.shape[-1] == n and a.ndim > 1 and full else a for a, full in arrays] for i in range(n)]
    return np.stack([function(*p) for p in picked], axis=-1)


@pytest.mark.parametrize("size", [1, 2, 4, 9])
@pytest.mark.parametrize("left", [True, False])
@pytest.mark.parametrize("right", [True, False])
def test_products(size, left, right, double):
    a = batch(size, 3) if left else RNG.normal(size=(size, 3))
    b = batch(3, size) if right else RNG.normal(size=(3, size))
    found = np.asarray(linalg.product(jnp.asarray(a), jnp.asarray(b)))
    wanted = each(np.matmul, (a, left), (b, right)) if left or right else a @ b
    assert np.allclose(found, wanted)


@pytest.mark.parametrize("size", [1, 2, 5, 15])
@pytest.mark.parametrize("batched", [True, False])
def test_cholesky_and_solves(size, batched, double):
    root = batch(size, size + 2) if batched else RNG.normal(size=(size, size + 2))
    A = np.asarray(linalg.product(jnp.asarray(root), linalg.transpose(jnp.asarray(root))))
    b = batch(size, 2) if batched else RNG.normal(size=(size, 2))
    factor = jax.jit(linalg.cholesky)(jnp.asarray(A))
    x = np.asarray(jax.jit(linalg.solve)(factor, jnp.asarray(b)))
    log_det = np.asarray(linalg.log_determinant(factor))
    if batched:
        assert np.allclose(factor, each(np.linalg.cholesky, (A, True)))
        assert np.allclose(x, each(np.linalg.solve, (A, True), (b, True)))
        assert np.allclose(log_det, [np.linalg.slogdet(A[..., i])[1] for i in range(5)])
    else:
        assert np.allclose(factor, np.linalg.cholesky(A))
        assert np.allclose(x, np.linalg.solve(A, b))
        assert np.allclose(log_det, np.linalg.slogdet(A)[1])


@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_semi_definite_matrices_keep_exact_zeros(dtype, double):
    """N4: rank 0, rank 1, a state without variance, condition 1e12."""
    for A in (np.zeros((3, 3)), np.outer([1, 2, -1], [1, 2, -1]), np.diag([4.0, 0, 9]), np.diag([1.0, 1e-12, 1e6])):
        factor = np.asarray(jax.jit(linalg.cholesky)(jnp.asarray(A, dtype)), np.float64)
        assert np.isfinite(factor).all()
        assert np.allclose(factor @ factor.T, A, rtol=1e-5, atol=1e-30)
        empty = np.diag(A) == 0
        assert np.all(factor[empty] == 0)
        solved = np.asarray(linalg.solve(jnp.asarray(factor), jnp.asarray(A @ np.ones(3))))
        assert np.allclose(A @ solved, A @ np.ones(3), rtol=1e-4)


def test_nothing_is_a_size_too():
    nothing = jnp.zeros((0, 0, 4))
    assert linalg.cholesky(nothing).shape == (0, 0, 4)
    assert linalg.product(jnp.zeros((2, 0, 4)), jnp.zeros((0, 3, 4))).shape == (2, 3, 4)
    assert linalg.times_vector(jnp.zeros((2, 0)), jnp.zeros((0, 4))).shape == (2, 4)
