"""Traced programs as native kernels: the same numbers as JAX, or a refusal, never something else."""

import subprocess

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.custom_batching import custom_vmap, sequential_vmap
from native_tools import by_jax, natively, needs_compiler

from motes.core import random
from motes.native import compile, stage
from motes.native.rules import Untranslatable
from tiers import but_one_in, each

X = np.random.default_rng(1).normal(size=(3, 777)).astype(np.float32)
A = np.random.default_rng(2).normal(size=(3, 3)).astype(np.float32)


def over(function):
    """A function of one state, over the cloud."""
    return lambda X: [jax.vmap(function, in_axes=-1, out_axes=-1)(X)]


def turned(x):
    angle = 0.3 * jnp.tanh(x[0])
    rotation = jnp.array([[jnp.cos(angle), -jnp.sin(angle)], [jnp.sin(angle), jnp.cos(angle)]])
    return x.at[1:].set(rotation @ x[1:])


@jax.custom_jvp
def squared(x):
    return x * x


squared.defjvp(lambda primals, tangents: (primals[0] ** 2, 2 * primals[0] * tangents[0]))

HEIGHTS = jnp.asarray(np.random.default_rng(3).normal(size=(19, 43)), jnp.float32)


def whole(x):
    return jnp.floor(x).astype(jnp.int32)


def runge_kutta(x, h=0.05):
    def slope(x):
        return jnp.stack([x[1], -jnp.sin(x[0]) + 0.1 * x[2], -x[2]])

    a = slope(x)
    b = slope(x + h / 2 * a)
    c = slope(x + h / 2 * b)
    return x + h / 6 * (a + 2 * b + 2 * c + slope(x + h * c))


asked = []


@custom_vmap
def doubled(x):
    """A function with a rule of its own for doing it many times."""
    return 2 * x


@doubled.def_vmap
def _(size, batched, x):
    asked.append(size)
    return 2 * x, batched[0]


def mixed(x):
    """A matrix that changes with the state."""
    return jnp.outer(x, x) / 4 + jnp.eye(3) + 0.1 * A @ A.T


KEY = jax.random.key(7)


def each_key(function):
    """A program over a cloud that draws with a key of each particle's own, as a user's sampler does."""
    return lambda X: [jax.vmap(function, (0, -1), -1)(jax.random.split(KEY, X.shape[1]), X)]


def drawn(key, x):
    first, second, third = jax.random.split(key, 3)
    late = jax.random.exponential(first, (3,)) * jax.random.bernoulli(jax.random.fold_in(second, 7), 0.5)
    return x + late + jax.random.randint(second, (), -3, 90) + jax.random.categorical(third, x) + jax.random.gumbel(third)


SMOOTH = (jnp.exp, jnp.expm1, jnp.log1p, jnp.sin, jnp.cos, jnp.tan, jnp.arcsin, jnp.arccos, jnp.arctan, jnp.sinh, jnp.cosh, jnp.tanh,
          jnp.arcsinh, jnp.arctanh, jnp.exp2, jnp.cbrt, jax.nn.sigmoid, jax.nn.softplus, jax.scipy.special.erf)  # fmt: skip
"""What JAX makes of their derivatives changes from version to version."""

PROGRAMS = {
    "growth": over(lambda x: x / 2 + 25 * x / (1 + x**2) + 8 * jnp.cos(1.2 * 3)),
    "matrix": over(lambda x: A @ x),
    "turned": over(turned),
    "where": over(lambda x: jnp.where(x[0] > 0, x * x[1], -x)),
    "cond": over(lambda x: jax.lax.cond(x[0] > 0, lambda x: x + 1, lambda x: x * 2, x)),
    "switch": over(lambda x: jax.lax.switch(jnp.int32(jnp.floor(x[0])), [lambda x: x, lambda x: x * 2, lambda x: x * 3], x)),
    "reduce": over(lambda x: x - jnp.max(x) + jnp.sum(x) * jnp.prod(x) - jnp.min(x) + jnp.any(x > 1)),
    "norm": over(lambda x: x / jnp.linalg.norm(x)),
    "outer": over(lambda x: (jnp.outer(x, x) @ x)[::-1]),
    "einsum": over(lambda x: jnp.einsum("ij,j,k->i", A, x, x)),
    "concatenated": over(lambda x: jnp.concatenate([x[1:], jnp.atleast_1d(jnp.arctan2(x[0], x[1]))])),
    "stacked": over(lambda x: jnp.stack([x[2], x[0], 0.0 * x[1] + 4])),
    "wrapped": over(lambda x: jnp.mod(x + jnp.pi, 2 * jnp.pi) - jnp.pi),
    "clipped": over(lambda x: jnp.clip(x, -0.5, 0.25) + jnp.sign(x) * jnp.abs(x) ** 1.5),
    "powers": over(lambda x: x**3 + (1 + x**2) ** -2 + jnp.square(x) + jnp.power(jnp.abs(x), 0.3)),
    "logical": over(lambda x: jnp.where((x > 0) & ~(x > 1) | (x < -1), x, 0.0)),
    "picked": over(lambda x: x[jnp.array([2, 0, 0])] + jax.lax.dynamic_slice(x, (1,), (1,))),
    "custom derivative": over(lambda x: squared(x)),
    "jitted inside": over(jax.jit(lambda x: jnp.sort(A, axis=0) @ jnp.sin(x))),
    "gradient inside": over(lambda x: jax.grad(lambda z: jnp.sum(jnp.sin(z) ** 2 * z[0]))(x)),
    "gradients of functions": over(lambda x: jax.grad(lambda z: sum(jnp.sum(function(0.3 * jnp.sin(z))) for function in SMOOTH))(x)),
    "distances": over(lambda x: jax.grad(lambda z: jnp.hypot(z[0], z[1]) + jnp.arctan2(z[1], z[2]) + jnp.logaddexp(z[0], z[2]))(x)),
    "error functions": over(lambda x: jax.scipy.special.erfc(x) + jax.scipy.special.ndtr(x) + jnp.log2(1 + x**2)),
    "bits": over(lambda x: jax.lax.bitcast_convert_type(jax.lax.bitcast_convert_type(x, jnp.int32) & -4096, jnp.float32)),
    "softplus": over(lambda x: jax.nn.softplus(x) + jax.nn.relu(x) + jax.nn.sigmoid(x)),
    "nan": over(lambda x: jnp.where(x > 0, jnp.log(x), jnp.nan)),
    "whole cloud": lambda X: [jnp.roll(X, 1, axis=0) * jnp.float32(2) + jnp.zeros((3, 1))],
    "whole cloud, rule for many": lambda X: [doubled(X) * doubled(jnp.float32(0.25)) + jax.checkpoint(jnp.sin)(X)],
    "flipped": over(lambda x: jnp.flip(x) + jnp.cumsum(jnp.ones(3))),
    "table": over(lambda x: HEIGHTS[whole(3 * x[0]), whole(4 * x[1])] + x),
    "table, nothing beyond": over(lambda x: x + HEIGHTS.at[whole(9 * x[0]), whole(9 * x[1])].get(mode="fill")),
    "table, another value beyond": over(lambda x: x + HEIGHTS.at[whole(9 * x[0])].get(mode="fill", fill_value=7.0)[:3]),
    "table, edge beyond": over(lambda x: x + HEIGHTS.at[whole(9 * x), whole(9 * x[::-1])].get(mode="clip")),
    "table, windows": over(lambda x: jax.lax.dynamic_slice(HEIGHTS, (whole(9 * x[0]), whole(9 * x[1])), (3, 1))[:, 0] * x),
    "whole numbers": over(lambda x: x + whole(9 * x) // 4 * 0.5 + whole(9 * x) % 4 + jax.lax.rem(whole(9 * x), 1 - whole(x))),
    "tables of whole numbers and truths": over(
        lambda x: jnp.where(jnp.array([True, False] * 9)[whole(9 * x[0])], x, jnp.arange(18)[whole(x[1])])
    ),
    "table worked out": over(lambda x: jnp.cumsum(HEIGHTS, axis=1)[whole(x[0]), whole(x[1])] * x),
    "interpolated": over(lambda x: jnp.interp(x, jnp.linspace(-2, 2, 41), HEIGHTS[1, :41])),
    "Cholesky factor": over(lambda x: jnp.linalg.cholesky(mixed(x)) @ x),
    "no Cholesky factor": over(lambda x: jnp.linalg.cholesky(mixed(x) - 1.2 * jnp.eye(3)) @ x),
    "triangular": over(lambda x: jax.scipy.linalg.solve_triangular(A, x, lower=True, unit_diagonal=True)
                       + jax.scipy.linalg.solve_triangular(mixed(x), A, trans=1)[0]),
    "solved": over(lambda x: jnp.linalg.solve(mixed(x)[jnp.array([1, 2, 0])], x)),
    "inverse": over(lambda x: jnp.linalg.inv(mixed(x)[::-1]) @ x),
    "Cholesky solved": over(lambda x: jax.scipy.linalg.cho_solve(jax.scipy.linalg.cho_factor(mixed(x)), x)),
    "determinant": over(lambda x: x * jnp.linalg.det(jnp.kron(mixed(x), jnp.eye(2)) + A[0, 0])),
    "exponential": over(lambda x: jax.scipy.linalg.expm(0.7 * mixed(x)) @ x),
    "sorted": over(lambda x: A @ jnp.sort(jnp.concatenate([x, -x, jnp.array([0.0, -0.0, jnp.nan])]))[2:5]),
    "order": over(lambda x: jnp.argsort(jnp.round(jnp.concatenate([x, -x, x / 2])))[2:5] + x[0]),
    "sorted down, along columns": over(lambda x: jnp.sort(jnp.outer(x, A[0]), axis=0, descending=True)[:, 1]),
    "median": over(lambda x: x + jnp.median(x)),
    "running": over(lambda x: jnp.cumsum(x) + jnp.cumprod(x)[::-1] + jax.lax.cummax(x, reverse=True) + jax.lax.cummin(x)),
    "largest": over(lambda x: x[jnp.argmax(x)] + jnp.argmin(jnp.outer(x, x), axis=0)),
    "largest, none a number": over(lambda x: jnp.argmax(jnp.where(x > 0.5, jnp.nan, x)) + x),
    "own array": over(lambda x: jnp.outer(x, x)[whole(2 * x[0]), whole(2 * x[1])] + x[whole(x)] + x.at[whole(9 * x)].get(mode="fill")),
    "keys": each_key(lambda key, x: x + jax.random.normal(key, (3,)) @ A),
    "keys split": each_key(drawn),
    "keys chosen": each_key(lambda key, x: jax.random.uniform(jnp.where(x[0] > 0, *jax.random.split(key)), (3,), minval=x, maxval=2.0)),
    "shifts": over(lambda x: x + (whole(9 * x) << 3) + (whole(9 * x) >> 1) + jax.lax.shift_right_logical(whole(9 * x), whole(x)) % 7),
    "Runge and Kutta": over(lambda x: jax.lax.fori_loop(0, 10, lambda i, z: runge_kutta(z), x)),
    "loop with rows": over(lambda x: jax.lax.scan(lambda z, row: (jnp.tanh(A @ z + row), z[0]), x, HEIGHTS[:5, :3])[0]),
    "loop that gives rows": over(lambda x: jax.lax.scan(lambda z, row: (z * row, z + row), x, A, reverse=True)[1][1]),
}


@needs_compiler
@pytest.mark.parametrize("name", each(list(PROGRAMS), but_one_in(PROGRAMS, 2)))
def test_same_numbers_as_jax(name):
    ours, wanted = natively(PROGRAMS[name], X)[0], by_jax(PROGRAMS[name], X)[0]
    assert ours.shape == wanted.shape and np.array_equal(np.isnan(ours), np.isnan(wanted))
    # differences of numbers that lie close together, and products one after the other
    tolerance = 3e-5 if name in ("exponential", "interpolated") else 2e-6
    assert np.allclose(ours, wanted, rtol=tolerance, atol=tolerance, equal_nan=True)


SCALAR = {
    "clipped", "powers", "gradients of functions", "error functions", "exponential",  # functions of the C library
    "whole numbers", "keys split",  # processors divide whole numbers one at a time
}  # fmt: skip
BY_DAY = {"where", "reduce", "table", "own array", "solved", "keys chosen"}


@pytest.mark.skipif(not compile.compiler() or "g++" not in compile.compiler()[0], reason="asks g++ what it did")
@pytest.mark.parametrize("name", each(list(PROGRAMS), set(PROGRAMS) - BY_DAY))
def test_loops_over_particles_are_vectorized(name, monkeypatch, tmp_path):
    sources = []
    monkeypatch.setattr(stage, "begun", sources.append)
    stage.movement(lambda *lanes: list(PROGRAMS[name](*lanes)), [jnp.asarray(X, float)])
    path = tmp_path / "kernel.cpp"
    path.write_text(sources[0])
    words = [*compile.compiler(), *compile.FLAGS, *compile._special(), f"-I{compile.HEADERS}", f"-I{jax.ffi.include_dir()}"]
    trial = [*words, "-fopt-info-vec", "-o", str(tmp_path / "kernel.so"), str(path)]
    done = subprocess.run(trial, capture_output=True, text=True, check=True)
    told = {int(line.split(":")[1]) for line in done.stderr.splitlines() if line.startswith(f"{path}:") and "loop vectorized" in line}
    lines = sources[0].splitlines()
    loops = [range(begin, lines.index("    }", begin) + 2) for begin, line in enumerate(lines, 1) if line == "#pragma omp simd"]
    assert all(told & set(loop) for loop in loops) == (name not in SCALAR)


@needs_compiler
def test_parameters_are_taken_from_the_outside():
    """What JAX works out around the kernel, under jit and vmap, reaches it; the same kernel serves all values."""

    def moved(scale, shift, flag):
        def function(X):
            return [jnp.where(flag, X * jnp.exp(scale), X + shift[:, None])]

        return natively_traced(function, X)

    jitted = jax.jit(jax.vmap(moved))
    scale, shift, flag = np.array([0.1, 0.7], np.float32), np.arange(6, dtype=np.float32).reshape(2, 3), np.array([True, False])
    ours = np.asarray(jitted(scale, shift, flag))
    assert np.allclose(ours[0], X * np.exp(scale[0]), rtol=1e-6) and np.allclose(ours[1], X + shift[1][:, None], rtol=1e-6)


def natively_traced(function, X):
    from motes.native.stage import call_move, movement

    stage = movement(function, [jnp.asarray(X)])
    return call_move(stage, stage.shared, jnp.arange(X.shape[1], dtype=jnp.int32), [jnp.asarray(X)])[0]


@needs_compiler
def test_what_no_particle_enters_keeps_its_rule_for_many():
    asked.clear()
    ours = jax.vmap(lambda scale: natively_traced(lambda X: [doubled(scale) * X], X))(np.array([0.5, 2.0], np.float32))
    assert set(asked) == {2} and np.allclose(ours, [X, 4 * X])


@needs_compiler
def test_tables_of_many_runs():
    """Under vmap each run may have a table of its own."""
    places = np.clip(np.abs(X * 9).astype(np.int32), 0, 18)
    tables = jnp.stack([HEIGHTS[:, 0], 2 * HEIGHTS[:, 1]])

    def looked_up(table):
        return natively_traced(lambda X: [X + table[jnp.clip(jnp.abs(X * 9).astype(jnp.int32), 0, 18)]], X)

    assert np.allclose(jax.jit(jax.vmap(looked_up))(tables), X + np.asarray(tables)[:, places], rtol=1e-6)


ACROSS = {
    "mean over particles": lambda X: [X - X.mean(axis=1, keepdims=True)],
    "neighbors": lambda X: [jnp.roll(X, 1, axis=1)],
    "reversed": lambda X: [X[:, ::-1]],
    "sorted": lambda X: [jnp.sort(X, axis=1)],
    "running sum": lambda X: [jnp.cumsum(X, axis=1)],
    "reshaped": lambda X: [X.reshape(-1, 3).T],
    "first particle": lambda X: [X - X[:, :1]],
    "numbered": lambda X: [X + jnp.arange(X.shape[1])],
    "loop from particle to particle": lambda X: [jax.lax.scan(lambda z, x: (z + x, z), jnp.zeros(3), X.T)[1].T],
    "particles as a table": lambda X: [X[:, jnp.clip(X[0].astype(jnp.int32), 0, 5)]],
    "permuted": lambda X: [X[:, jnp.arange(X.shape[1])[::-1]]],
    "one particle set": lambda X: [X.at[:, 0].set(0.0)],
    "one particle updated": lambda X: [jax.lax.dynamic_update_slice(X, jnp.zeros((3, 1)), (0, 0))],
    "shifted by padding": lambda X: [jax.lax.pad(X, jnp.float32(0), ((0, 0, 0), (1, -1, 0)))],
    "matrix of particles": lambda X: [(X @ X.T) @ X],
    "own numbers of each": lambda X: [X + jax.random.normal(jax.random.key(0), X.shape)],
    "keys of others": lambda X: [X + jax.vmap(jax.random.uniform)(jax.random.split(KEY, X.shape[1])[::-1])],
    "one key of all": lambda X: [X + jax.vmap(jax.random.uniform)(jax.random.split(KEY, 1))],
    "the largest": lambda X: [X[:, jnp.argmax(X[0])][:, None] + X],
    "factor over particles": lambda X: [X @ jnp.linalg.cholesky(X.T @ X)],
    "our numbers, rule for many": lambda X: [X + sequential_vmap(lambda key: random.normal(key, X.shape, jnp.float32))(jax.random.key(0))],
    "our numbers, sums over particles": lambda X: [X + random.normal(jax.random.key(0), X.shape, jnp.float32).sum(axis=1)[:, None]],
}


@pytest.mark.parametrize("name", ACROSS)
def test_programs_in_which_particles_meet_are_refused(name):
    with pytest.raises(Untranslatable):
        natively(ACROSS[name], X)


@pytest.mark.parametrize("program", [
    over(lambda x: jax.lax.while_loop(lambda z: z[0] < 3, lambda z: z + 1, x)),
    over(lambda x: jnp.linalg.inv(jnp.eye(41) + x[0])[0, :3]),
    over(lambda x: jnp.sort(jnp.tile(x, 14))[:3]),
    over(lambda x: x + jax.pure_callback(lambda z: np.asarray(z), jax.ShapeDtypeStruct((3,), jnp.float32), x, vmap_method="expand_dims")),
    over(lambda x: x + jnp.tile(x, 22)[jnp.int32(x[0])]),
    lambda X: [X + jax.vmap(lambda key, x: x * jax.random.bits(key, (3,), jnp.uint8), (0, -1), -1)(jax.random.split(KEY, X.shape[1]), X)],
    lambda X: [X + jax.vmap(lambda key, x: jax.random.normal(key, (3,)), (0, -1), -1)(jax.random.split(KEY, (1, X.shape[1]))[0], X)],
    over(lambda x: jax.lax.scan(lambda z, row: (z + 1, z), x, jnp.zeros((0, 3)))[0] + x),
    over(lambda x: jax.lax.fori_loop(0, 1_000_000, lambda i, z: z[::-1], x)),
    over(lambda x: x.at[:2].add(x[:2])),
])  # fmt: skip
def test_unknown_operations_are_refused(program):
    with pytest.raises(Untranslatable):
        natively(program, X)


def long(x):
    """More operations than one part of a kernel has; a truth and a whole number go from part to part."""
    large, cell = x[0] > 0, whole(3 * x[1])
    for k in range(150):
        x = jnp.stack([0.9 * x[0] + jnp.sin(x[1] + 0.01 * k), 0.9 * x[1] - 0.1 * x[2] ** 2, 0.5 * x[2] + 0.1 * x[0]])
    return jnp.stack([jnp.where(large, x[0], x[1]), x[1] + cell, x[2] + HEIGHTS[jnp.clip(cell + 9, 0, 18), 7]])


@needs_compiler
def test_a_long_program_in_parts_gives_the_same():
    # operation by operation: XLA may take minutes over all of them at once
    wanted, found = over(long)(jnp.asarray(X))[0], natively(over(long), X)[0]
    assert np.allclose(found, wanted, rtol=1e-4, atol=1e-4)
    assert stage.movement(over(long), [jnp.asarray(X)]).source.count("noinline") > 2


@needs_compiler
def test_what_is_zero_whatever_the_numbers_are_costs_nothing():
    triangle = np.tri(3, dtype=bool)

    def size(mask):
        def traced(matrix):
            return jnp.zeros(stage.movement(over(lambda x: jnp.where(mask, matrix, 0).T @ x), [jnp.asarray(X)]).size)

        return jax.eval_shape(traced, jnp.asarray(A)).size

    assert size(triangle) == 6
    assert size(np.ones((3, 3), bool)) == 9


@needs_compiler
def test_the_same_is_worked_out_once_and_a_sum_with_a_product_rounded_once():
    found = stage.movement(over(lambda x: x * jnp.exp(x[0]) + jnp.exp(x[0])), [jnp.asarray(X)])
    assert found.source.count("motes::exp") == 1
    assert found.source.count("motes::fma") == 3
