"""Small functions that are compiled as one: the same numbers as step by step, wherever they stand, and left alone where they cannot be."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

import motes as mo
from motes.tracing.at_once import at_once

A = np.random.default_rng(0).normal(size=(3, 4)).astype(np.float32)
X = np.random.default_rng(1).normal(size=(4, 2)).astype(np.float32)
MARK = "xla_cpu_small_call"


SMALL = {
    "products": lambda a, x: a @ x + jnp.einsum("ij,ik->jk", a, a)[:3, :2],
    "batched product": lambda a, x: jnp.einsum("ki,kj->kij", a, a).sum(axis=0)[:2] + jnp.matmul(a[None], x[None])[0].sum(),
    "sums": lambda a, x: (a.sum(axis=0), a.max(), x.min(axis=1), jnp.all(a > -9, axis=0), jnp.any(x > 0), a.prod(axis=(0, 1)), a[:0].sum()),
    "derivatives of their own": lambda a, x: jnp.logaddexp(a[:, :2], x[:3]) + jax.nn.relu(a[:, 2:]),
    "a function within": lambda a, x: jax.jit(lambda x: x @ x.T)(x) * a.T[:, :1],
    "choices and places": lambda a, x: jnp.where(a > 0, a, -a).at[1].set(x[:, 0])[jnp.argmax(x[:, 1]) % 3],
}  # fmt: skip


@pytest.mark.parametrize("name", SMALL)
def test_the_same_numbers_as_step_by_step(name):
    """Alone, compiled, and many at once, where sums and products are long enough for libraries."""
    function = SMALL[name]

    def whole(a, x):
        return at_once(function, a, x)

    assert MARK in jax.jit(whole).lower(A, X).as_text()
    many = [np.stack([each + 0.01 * k for k in range(300)]) for each in (A, X)]
    for around, given in ((lambda f: f, (A, X)), (jax.jit, (A, X)), (lambda f: jax.jit(jax.vmap(f)), many)):
        wanted, found = around(function)(*given), around(whole)(*given)
        jax.tree.map(lambda one, other: assert_allclose(one, other, rtol=2e-5, atol=1e-5), wanted, found)


def test_derivatives():
    def f(x):
        return jnp.sum(jnp.logaddexp(A @ x, 0.0) ** 2)

    for derivative in (jax.grad, jax.hessian, lambda f: jax.jit(jax.jacfwd(f))):
        assert_allclose(derivative(lambda x: at_once(f, x))(X), derivative(f)(X), rtol=1e-5, atol=1e-5)
    # where a rule of its own has another derivative than its operations
    assert jax.grad(lambda x: at_once(lambda x: jax.nn.relu(x) + jnp.logaddexp(x, x), x))(0.0) == 1.0


@pytest.mark.parametrize("function", [
    lambda x: jnp.linalg.inv(x[:2] @ x[:2].T), lambda x: jnp.sort(x), lambda x: jnp.sum(jnp.tile(x, (300, 1)), axis=1)[:2],
    lambda x: jax.lax.fori_loop(0, 3, lambda i, x: x @ x.T @ x, x), lambda x: jnp.tile(x, (1, 20)) @ jnp.tile(x.T, (20, 1)),
    lambda x: jax.pure_callback(lambda x: np.asarray(x), jax.ShapeDtypeStruct(x.shape, x.dtype), x),
], ids=["solver", "sort", "large", "loop", "long sums", "callback"])  # fmt: skip
def test_what_cannot_be_one_function_is_left_alone(function):
    assert MARK not in jax.jit(lambda x: at_once(function, x)).lower(X).as_text()
    assert_allclose(jax.jit(lambda x: at_once(function, x))(X), function(X), rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("filter", [mo.KalmanFilter(), mo.UnscentedKalmanFilter(), mo.SquareRootKalmanFilter()],
                         ids=lambda filter: type(filter).__name__)  # fmt: skip
def test_steps_of_kalman_filters_are_such_functions(filter):
    model = mo.textbook.constant_velocity()
    ys = mo.simulate(0, model, 5)[1]
    text = jax.jit(lambda ys: mo.run(0, filter, model, ys).mean).lower(ys).as_text()
    assert text.count(MARK) >= 2
