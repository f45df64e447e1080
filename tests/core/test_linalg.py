"""Small-matrix algebra against NumPy, one matrix or one per particle."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from motes.core import linalg
from tiers import each

RNG = np.random.default_rng(0)


def batch(*shape, n=5):
    return RNG.normal(size=(*shape, n))


def of_each(function, *arrays):
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
    wanted = of_each(np.matmul, (a, left), (b, right)) if left or right else a @ b
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
        assert np.allclose(factor, of_each(np.linalg.cholesky, (A, True)))
        assert np.allclose(x, of_each(np.linalg.solve, (A, True), (b, True)))
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


@jax.jit
def worked_out(a, b, v, scale, root):
    P = linalg.symmetric(linalg.product_transposed(root, root))
    return {
        "P": P,
        "product": linalg.product_transposed(a, b),
        "rank": linalg.rank_update(P, v, scale),
        "sandwich": linalg.sandwich(linalg.transpose(b), P),
        "factor": linalg.cholesky_update(linalg.cholesky(P), b),
    }


@pytest.mark.parametrize("size", each(range(1, 21), lambda size: int(size) not in (1, 2, 5, 20)))
@pytest.mark.parametrize("deficient", [False, True])
def test_updates_at_all_sizes(size, deficient, double):
    """Precisions and operands with and without particles take turns; deficient: of rank two, and one state without variance."""
    left, right, dtype = size % 2 == 0, size // 2 % 2 == 0, ("float32", "float64")[size // 4 % 2]

    def drawn(*shape, many):
        return RNG.normal(size=(*shape, 5) if many else shape).astype(dtype) / dtype_of(np.sqrt(size))

    def particles_first(array, many):
        return np.moveaxis(np.asarray(array, np.float64), -1, 0) if many else np.asarray(array, np.float64)

    dtype_of = np.dtype(dtype).type
    a, b, v = drawn(size, 3, many=left), drawn(size, 3, many=right), drawn(size, many=right)
    root = drawn(size, size + 1, many=left)
    scale = drawn(many=right) if right else dtype_of(-0.7)
    if deficient:
        b[size // 2], root[size // 2], root[:, 2:] = 0, 0, 0
    found = worked_out(a, b, v, scale, root)
    assert all(value.dtype == dtype for value in found.values())
    either = left or right
    P, A, B, w = particles_first(found["P"], left), particles_first(a, left), particles_first(b, right), particles_first(v, right)
    Bt, s = B.swapaxes(-1, -2), np.asarray(scale, np.float64).reshape(-1, 1, 1) if right else float(scale)
    wanted = {"product": A @ Bt, "rank": P + s * w[..., None] * w[..., None, :], "sandwich": Bt @ P @ B}
    tolerance = 100 * size * float(np.finfo(dtype).eps)
    for name, value in wanted.items():
        np.testing.assert_allclose(particles_first(found[name], either), value, rtol=0, atol=tolerance, err_msg=name)
    for name in ("rank", "sandwich"):
        np.testing.assert_allclose(found[name], np.swapaxes(found[name], 0, 1), rtol=0, atol=4 * float(np.finfo(dtype).eps))
    factor = particles_first(found["factor"], either)
    assert np.array_equal(factor, np.tril(factor)) and (np.diagonal(factor, axis1=-2, axis2=-1) >= 0).all()
    assert not deficient or (factor[..., size // 2, :] == 0).all()
    # where the rank is deficient, the factor of P itself may carry directions of the size of rounding's root
    slack = 4 * size * float(np.finfo(dtype).eps) ** 0.5 if deficient else tolerance
    np.testing.assert_allclose(factor @ factor.swapaxes(-1, -2), P + B @ Bt, rtol=0, atol=slack)


@pytest.mark.parametrize("size", [1, 3, 8])
def test_updated_factor_is_that_of_the_sum(size, double):
    L = np.linalg.cholesky(np.cov(RNG.normal(size=(size, 40))).reshape(size, size))
    V = RNG.normal(size=(size, 2))
    found = jax.jit(linalg.cholesky_update)(jnp.asarray(L), jnp.asarray(V))
    np.testing.assert_allclose(found, np.linalg.cholesky(L @ L.T + V @ V.T), rtol=1e-12, atol=1e-14)
    from_nothing = linalg.cholesky_update(jnp.zeros((size, size)), jnp.asarray(L))
    np.testing.assert_allclose(from_nothing, L, rtol=1e-12, atol=1e-14)


def test_nothing_is_a_size_too():
    nothing = jnp.zeros((0, 0, 4))
    assert linalg.cholesky(nothing).shape == (0, 0, 4)
    assert linalg.cholesky_update(nothing, jnp.zeros((0, 2, 4))).shape == (0, 0, 4)
    assert np.array_equal(linalg.cholesky_update(jnp.eye(2), jnp.zeros((2, 0))), np.eye(2))
    assert linalg.product_transposed(jnp.zeros((2, 0, 4)), jnp.zeros((3, 0, 4))).shape == (2, 3, 4)
    assert linalg.product(jnp.zeros((2, 0, 4)), jnp.zeros((0, 3, 4))).shape == (2, 3, 4)
    assert linalg.times_vector(jnp.zeros((2, 0)), jnp.zeros((0, 4))).shape == (2, 4)


@pytest.mark.parametrize("size", [1, 2, 3, 6])
def test_eigen(size, double):
    rng = np.random.default_rng(size)
    A = rng.normal(size=(size, size, 20)) * 10.0 ** rng.integers(-3, 4, size=20)
    A = A + A.swapaxes(0, 1)
    A[..., 0], A[..., 1] = np.eye(size), 0
    values, vectors = (np.asarray(part) for part in jax.jit(linalg.eigen)(jnp.asarray(A)))
    scale = np.abs(A).max(axis=(0, 1)) + 1e-300
    assert np.all(np.abs(np.einsum("ijn,jn,kjn->ikn", vectors, values, vectors) - A) < 1e-12 * scale)
    assert np.allclose(np.einsum("ijn,ikn->jkn", vectors, vectors), np.eye(size)[..., None], atol=1e-12)


def test_unit_factor_of_a_singular_matrix(double):
    A = np.array([[4.0, 2, 0], [2, 1, 0], [0, 0, 3]])
    L, d = (np.asarray(part) for part in linalg.unit_factor(jnp.asarray(A)))
    assert np.allclose(L @ np.diag(d) @ L.T, A) and np.array_equal(np.diag(L), np.ones(3)) and d[1] == 0
