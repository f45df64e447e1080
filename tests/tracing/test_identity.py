"""Functions built anew compare equal where their traced programs are; those that differ in anything do not."""

import gc
import weakref

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.custom_batching import custom_vmap

from motes.tracing.identity import Program, canonical_function

X, T = jax.ShapeDtypeStruct((2,), jnp.float32), jax.ShapeDtypeStruct((), jnp.int32)


def known(f, u=None):
    return canonical_function(f, (X, u, T))


BASE, LARGER, WHOLE = np.array([1.0, 2.0], np.float32), np.array([1.0, 3.0], np.float32), np.array([1, 2], np.int32)


@jax.custom_jvp
def _steep(x):
    return 2 * x


_steep.defjvp(lambda primals, tangents: (_steep(primals[0]), 7 * tangents[0]))


@jax.custom_jvp
def _flat(x):
    return 2 * x


_flat.defjvp(lambda primals, tangents: (_flat(primals[0]), 0 * tangents[0]))


def _mapped(function, rule):
    made = custom_vmap(function)
    made.def_vmap(rule)
    return made


def _together(size, batched, x):
    return 2 * x, batched[0]


def _apart(size, batched, x):
    return jax.lax.map(lambda z: 2 * z, x), batched[0]


_doubled, _doubled_apart, _tripled = (_mapped(*pair) for pair in (
    (lambda x: 2 * x, _together), (lambda x: 2 * x, _apart), (lambda x: 3 * x, _together)))  # fmt: skip

PAIRS = {
    "constant": (lambda x, u, t: 2.0 * x, lambda x, u, t: 2.0000002 * x),
    "sign of zero": (lambda x, u, t: 1 / (0.0 * x), lambda x, u, t: 1 / (-0.0 * x)),
    "closed-over numbers": (lambda x, u, t, a=BASE: a + x, lambda x, u, t, a=LARGER: a + x),
    "type of numbers": (lambda x, u, t, a=BASE: a + x, lambda x, u, t, a=WHOLE: a + x),
    "order of operands": (lambda x, u, t: x - 3, lambda x, u, t: 3 - x),
    "which component": (lambda x, u, t: x.at[0].set(x[1]), lambda x, u, t: x.at[1].set(x[0])),
    "time": (lambda x, u, t: x + t, lambda x, u, t: x + 0 * t),
    "nested function": (lambda x, u, t: jax.jit(jnp.sin)(x), lambda x, u, t: jax.jit(jnp.cos)(x)),
    "branch": (lambda x, u, t: jax.lax.cond(t > 1, jnp.sin, jnp.cos, x), lambda x, u, t: jax.lax.cond(t > 1, jnp.cos, jnp.sin, x)),
    "loop": (
        lambda x, u, t: jax.lax.fori_loop(0, 3, lambda i, v: v * 2, x),
        lambda x, u, t: jax.lax.fori_loop(0, 4, lambda i, v: v * 2, x),
    ),
    "derivative rule": (lambda x, u, t: _steep(x), lambda x, u, t: _flat(x)),
    "derivative rule, jitted": (lambda x, u, t: jax.jit(lambda z: _steep(z))(x), lambda x, u, t: jax.jit(lambda z: _flat(z))(x)),
    "rule for many": (lambda x, u, t: _doubled(x), lambda x, u, t: _doubled_apart(x)),
    "function with a rule for many": (lambda x, u, t: _doubled(x), lambda x, u, t: _tripled(x)),
    "kind of result": (lambda x, u, t: x, lambda x, u, t: [x[0], x[1]]),
}


@pytest.mark.parametrize(("one", "other"), PAIRS.values(), ids=PAIRS.keys())
def test_functions_that_differ_are_told_apart(one, other):
    def again(f):
        # the same code and closed-over values under a new identity, as a rebuilt model has
        return type(f)(f.__code__, f.__globals__, f.__name__, f.__defaults__, f.__closure__)

    assert isinstance(known(one), Program)
    assert known(one) == known(again(one)) and hash(known(one)) == hash(known(again(one)))
    assert known(other) == known(again(other))
    assert known(one) != known(other)


def test_arguments_of_other_shapes_are_other_programs():
    def f(x, u, t):
        return x if u is None else x + jnp.sum(u)

    def g(x, u, t):
        return x if u is None else x - jnp.sum(u)

    assert known(f) == known(g)
    assert known(f, jnp.ones(3)) != known(g, jnp.ones(3))
    assert known(f) != known(f, jnp.ones(3)) != known(f, jnp.ones(2))
    with jax.enable_x64(True):
        wide = known(f)
    assert wide != known(f)


def test_what_cannot_be_compared_is_compared_by_identity():
    calls = []

    def calls_back(x, u, t):
        return jax.pure_callback(lambda v: v, X, x)

    def prints(x, u, t):
        jax.debug.callback(calls.append, x)
        return x

    class Unhashable:
        __hash__ = None

        def __call__(self, x, u, t):
            return x

    for f in (calls_back, prints):
        again = type(f)(f.__code__, f.__globals__, f.__name__, f.__defaults__, f.__closure__)
        assert known(f) == known(f) != known(again)
    assert known(Unhashable()) == known(Unhashable())

    def closes_over_a_tracer(scale):
        f = lambda x, u, t: scale * x  # noqa: E731
        nested = lambda x, u, t: jax.jit(lambda v: scale * v)(x)  # noqa: E731
        assert known(f) != known(f) and known(nested) != known(nested)
        return scale

    jax.jit(closes_over_a_tracer)(1.0)
    jax.grad(closes_over_a_tracer)(1.0)
    jax.vmap(closes_over_a_tracer)(jnp.ones(3))


def test_nothing_is_kept_alive():
    array = np.zeros(100_000, np.float32)

    def build():
        big = array.copy()
        f = lambda x, u, t: x + jnp.asarray(big)[:2]  # noqa: E731
        known(f)
        return weakref.ref(f)

    gone = build()
    jax.clear_caches()
    gc.collect()
    assert gone() is None


def test_a_known_function_is_not_traced_again():
    traced = []

    def f(x, u, t):
        traced.append(1)
        return x

    for _ in range(3):
        known(f)
    assert len(traced) == 1


def test_large_arrays_are_compared_by_all_their_bytes():
    array = np.arange(100, dtype=np.float32)
    other = array.copy()
    other[-1] += 1

    def closing(a):
        return known(lambda x, u, t: x + a.sum() + jnp.asarray(a)[t])

    assert closing(array) == closing(array.copy())
    assert closing(array) != closing(other)
