"""Claims about random programs, against finite differences: a claim of independence or affinity must never be false."""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from jax import lax

from motes.tracing.affinity import dependence

TABLE = np.random.default_rng(1).normal(size=(5, 3))
HOLES = np.array([[1.0, 0.0, 2.0], [0.0, 0.0, 0.0], [0.0, -1.0, 1.0]])
MASK = np.array([True, False, True])
BASES = 8


def cell(value):
    """An index that depends on a state."""
    return jnp.floor(value).astype(int) % 3


def looped(a, b):
    return lax.fori_loop(0, 2, lambda i, s: s * b + a[i], a)


def long_loop(a, b):
    return lax.scan(lambda s, row: (jnp.roll(s, 1) * 0.5 + row * b[0], s[0]), a, jnp.ones((70, 3)))[0]


def until(a, b):
    return lax.while_loop(lambda s: (s[0] < 3) & (s[1][2] < 9), lambda s: (s[0] + 1, s[1] + b), (0, a))[1]


def scanned(a, b):
    return lax.scan(lambda s, v: (s + v[0] * b[1], s * v[1]), a[0], jnp.stack([a, b], axis=1))[1]


STEPS = [
    lambda a, b: a + b,
    lambda a, b: a - b,
    lambda a, b: a * b,
    lambda a, b: a / (b * b + 1),
    lambda a, b: a @ b + a,
    lambda a, b: HOLES @ a + b[0],
    lambda a, b: jnp.cross(a, b),
    lambda a, b: jnp.roll(a, 1) - 2.0,
    lambda a, b: jnp.cumsum(a) * 0.5,
    lambda a, b: jnp.concatenate([b[2:], a[:2]]),
    lambda a, b: jnp.stack([b.sum(), a[0], 1.0]),
    lambda a, b: jnp.outer(a, b)[1],
    lambda a, b: jnp.sin(a),
    lambda a, b: jnp.abs(a) + b,
    lambda a, b: jnp.floor(a) * b,
    lambda a, b: jnp.round(a).astype(int) + b,
    lambda a, b: jnp.clip(a, -1, 1),
    lambda a, b: jnp.maximum(a, b),
    lambda a, b: a.min() + b,
    lambda a, b: jnp.sort(a),
    lambda a, b: a**2,
    lambda a, b: jnp.where(a > 0, b, 2 * b),
    lambda a, b: jnp.where(a[1] > b, 1.0, a),
    lambda a, b: jnp.where(MASK, a, b),
    lambda a, b: (a > 0) * b,
    lambda a, b: jnp.asarray(TABLE)[cell(a)[0]] * b,
    lambda a, b: a[cell(b)],
    lambda a, b: a[jnp.array([2, 0, 0])],
    lambda a, b: a.at[1].set(b[0]),
    lambda a, b: a.at[cell(b[0])].set(1.5),
    lambda a, b: a.at[jnp.array([1, 1])].add(b[:2]),
    lambda a, b: a.at[cell(b[1])].multiply(b[2]),
    lambda a, b: lax.dynamic_update_slice(a, b[:2], (cell(b[2]),)),
    lambda a, b: lax.dynamic_slice(jnp.concatenate([a, b]), (cell(a[0]),), (3,)),
    lambda a, b: jnp.interp(a, TABLE[:, 0].cumsum(), TABLE[:, 1]) + b,
    lambda a, b: lax.cond(a[0] > 0, lambda: b, lambda: b[::-1]),
    lambda a, b: jax.vmap(lambda u, v: lax.cond(u > 0, lambda: v, lambda: 2 * v))(a, b),
    lambda a, b: jax.jit(lambda v: v * a[0])(b),
    lambda a, b: jnp.linalg.solve(jnp.eye(3) * (1 + a[0] ** 2), b),
    lambda a, b: jnp.einsum("i,j,ij->j", a, b, HOLES),
    looped,
    long_loop,
    until,
    scanned,
]


def assemble(program):
    """Make a function of three variables: each step makes a new result of two earlier ones; the last one counts."""

    def function(x):
        results = [x, x[0] * jnp.array([1.0, 0.0, 0.0]), jnp.array([0.5, -1.0, 0.0]) + x[2]]
        for step, first, second in program:
            results.append(STEPS[step](results[first % len(results)], results[second % len(results)]))
        return results[-1]

    return function


def corners(first, second, bases, moves):
    """The corners of parallelograms along two axes, (4, bases, 3)."""
    one, two = np.eye(3)[first] * moves[:, :1], np.eye(3)[second] * moves[:, 1:]
    return np.stack([bases, bases + one, bases + two, bases + one + two])


def check(program, seed):
    """Compare what is claimed of a program with differences between the corners of random parallelograms."""
    generator = np.random.default_rng(seed)
    bases, moves = generator.normal(scale=2, size=(BASES, 3)), generator.normal(scale=3, size=(BASES, 2))
    pairs = list(itertools.combinations_with_replacement(range(3), 2))
    points = np.stack([corners(first, second, bases, moves) for first, second in pairs])
    function = assemble(program)
    with jax.enable_x64(True):
        found = dependence(function, (bases[0],), ("elements",))
        values = np.asarray(jax.vmap(function)(points.reshape(-1, 3))).reshape(*points.shape)
    scale = 1e-7 * (1 + np.abs(values).max(axis=1))
    for (first, second), (base, one, two, both), allowed in zip(pairs, values, scale, strict=True):
        apart = ~found.pairs[:, first, second]
        assert (np.abs(both - one - two + base) <= allowed)[:, apart].all()
        assert (np.abs(one - base) <= allowed)[:, ~found.uses[:, first]].all()
        assert (np.abs(two - base) <= allowed)[:, ~found.uses[:, second]].all()


@pytest.mark.parametrize("step", range(len(STEPS)))
def test_no_claim_about_one_step_is_false(step):
    for operands in ((0, 2), (2, 0)):
        check([(step, *operands)], seed=step)


STEP = st.tuples(st.integers(0, len(STEPS) - 1), st.integers(0, 6), st.integers(0, 6))


@settings(max_examples=60, deadline=None)
@given(program=st.lists(STEP, min_size=2, max_size=5), seed=st.integers(0, 99))
def test_no_claim_about_a_program_is_false(program, seed):
    check(program, seed)
