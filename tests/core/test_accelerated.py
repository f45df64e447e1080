"""What is computed in another way on an accelerator gives the numbers that it gives here."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from motes.core import engine, linalg, sums


@pytest.fixture
def accelerated(monkeypatch):
    """Let the library believe that it is on an accelerator."""
    monkeypatch.setattr(engine, "accelerated", lambda: True)


def thin_products():
    draw = np.random.default_rng(1).standard_normal
    for rows, columns in ((6, 6), (2, 6), (1, 1), (15, 15), (17, 16), (3, 0)):
        yield jnp.asarray(draw((rows, columns)), jnp.float32), jnp.asarray(draw((columns, 40)), jnp.float32)


def products_agree():
    return all(np.allclose(linalg.times_vector(a, v), np.asarray(a) @ np.asarray(v), rtol=1e-5, atol=1e-5) for a, v in thin_products())


def test_thin_products(accelerated, monkeypatch):
    assert products_agree()
    rows = linalg._by_rows
    monkeypatch.setattr(linalg, "_by_rows", lambda a, v: rows(a[::-1], v))
    assert not products_agree()  # the check sees rows in another order


def test_thin_products_can_be_mapped_and_differentiated(accelerated):
    (a, v), *_ = thin_products()
    slope = jax.jit(jax.grad(lambda a, v: jnp.sum(linalg.times_vector(a, v) ** 2)))(a, v)
    assert np.allclose(slope, 2 * (a @ v) @ v.T, rtol=1e-4, atol=1e-4)
    assert np.allclose(jax.vmap(linalg.times_vector, (None, 0))(a, jnp.stack([v, 2 * v]))[1], 2 * (a @ v), rtol=1e-4, atol=1e-4)


def test_long_sums(accelerated):
    values = np.random.default_rng(2).standard_normal((3, 3 * sums.BLOCK))
    weights = np.full(values.shape[1], 1 / values.shape[1])
    found = sums.weighted_sum(jnp.asarray(values, jnp.float32), jnp.asarray(weights, jnp.float32))
    assert np.allclose(found, values @ weights, atol=1e-5)
