"""The random stream: known answers, moments, independence, invariance."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.stats import kstest

import motes as mo
from motes.core import random


def test_threefry_known_answer():
    """Known-answer vectors of Threefry-2x32-20 (Random123)."""
    zero = jnp.uint32(0)
    assert [int(w) for w in random._threefry(zero, zero, zero, zero)] == [0x6B200159, 0x99BA4EFE]
    ones = jnp.uint32(0xFFFFFFFF)
    assert [int(w) for w in random._threefry(ones, ones, ones, ones)] == [0x1CB996FC, 0xBB002BE7]


@pytest.mark.parametrize("rows", [1, 2, 5])
def test_normal_moments_and_law(rows, precision):
    z = np.asarray(random.normal(jax.random.key(3), (rows, 200_000), jnp.dtype(precision)), np.float64)
    assert z.dtype == np.float64
    for row in z:
        # exact standard errors of the first four moments; six of them is a level of 2e-9 each
        for power, mean, variance in ((1, 0, 1), (2, 1, 2), (3, 0, 15), (4, 3, 96)):
            assert abs((row**power).mean() - mean) < 6 * np.sqrt(variance / row.size)
        assert kstest(row, "norm").pvalue > 1e-6
    assert np.abs(np.corrcoef(z) - np.eye(rows)).max() < 6 / np.sqrt(200_000)


def test_uniform_range_and_law(precision):
    u = np.asarray(random.uniform(jax.random.key(1), (200_000,), jnp.dtype(precision)))
    assert u.min() >= 0 and u.max() < 1
    assert kstest(u, "uniform").pvalue > 1e-6


def test_numbers_do_not_depend_on_how_many_there_are():
    few, many = (np.asarray(random.normal(jax.random.key(0), (4, n), jnp.float32)) for n in (100, 5000))
    assert np.array_equal(few, many[:, :100])
    assert np.array_equal(few[:2], np.asarray(random.normal(jax.random.key(0), (2, 100), jnp.float32)))


def test_keys_of_steps_and_purposes_are_apart():
    key = random.as_key(7)
    streams = {}
    for step in range(20):
        at_step = random.step_key(key, step)
        for purpose in range(8):
            first = random.child(at_step, purpose)
            for second in range(8):
                streams[(step, purpose, second)] = np.asarray(random.normal(random.child(first, second), (400,), jnp.float32))
            streams[(step, purpose)] = np.asarray(random.normal(first, (400,), jnp.float32))
    block = np.stack(list(streams.values()))
    correlation = np.corrcoef(block) - np.eye(len(block))
    # largest of about a million correlations of 400 pairs: 1/20 each, six standard errors
    assert np.abs(correlation).max() < 6.5 / 20


def test_keys_are_checked():
    assert random.as_key(3) == jax.random.key(3)
    assert random.as_key(jax.random.PRNGKey(3)) == jax.random.key(3)
    with pytest.raises(mo.MotesError, match="key: expected a JAX key or an integer seed, got 'float'"):
        random.as_key(0.5)
    with pytest.raises(mo.MotesError, match="threefry2x32 key"):
        random.as_key(jax.random.key(0, impl="rbg"))
