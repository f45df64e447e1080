"""What the analysis says of functions whose answer is known by hand: the traps, and what it must not miss."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax

from motes.core.checks import MotesError
from motes.tracing.affinity import Dependence, dependence, variables

X = np.zeros(3, np.float32)
TERRAIN = np.random.default_rng(0).normal(size=(1201, 1201)).astype(np.float32)
HALF_EMPTY = np.array([[1.0, 0.0, 2.0], [0.0, 0.0, 0.0]], np.float32)


@jax.custom_jvp
def hidden(value):
    """The identity, with a derivative that is not its own."""
    return value


hidden.defjvp(lambda primals, tangents: (primals[0], 0 * tangents[0]))


@jax.custom_vjp
def backwards(value):
    """The identity, with a derivative of its own in reverse only."""
    return value


backwards.defvjp(lambda value: (value, None), lambda residual, slope: (slope,))


def terrain(position):
    """The height below a position, from the cell that it lies in."""
    row, column = jnp.floor(position).astype(int)
    return jnp.asarray(TERRAIN)[row, column]


def written(x):
    """A sum through a mutable array."""
    store = jax.new_ref(x[0])
    store[...] += x[1]
    return store[...]


def marks(found: Dependence) -> tuple[str, str]:
    """Write the variables that any element uses, and the pairs in which any is not affine, as words."""
    uses, pairs = (field.any(axis=tuple(range(field.ndim - keep))) for field, keep in zip(found, (1, 2), strict=True))
    words = [f"{i}{j}" for i, j in np.argwhere(np.triu(pairs))]
    return "".join(map(str, np.flatnonzero(uses))), " ".join(words)


ALL = "00 01 02 11 12 22"
EXPECTED = {
    # name: (function of three variables, the variables used, the pairs in which it is not affine)
    "terrain look-up": (lambda x: terrain(x[:2]) + x[2], "012", "00 01 11"),
    "scaled terrain": (lambda x: x[2] * terrain(x[:2]), "012", "00 01 02 11 12"),
    "interp": (lambda x: jnp.interp(x[0], jnp.arange(4.0), jnp.arange(4.0) ** 2) + x[1], "01", "00"),
    "where on itself": (lambda x: jnp.where(x[0] > 0, x[0], 2 * x[0]), "0", "00"),
    "where on another": (lambda x: jnp.where(x[0] > 0, x[1], -x[1]), "01", "00 01"),
    "where on a sum": (lambda x: jnp.where(x[0] + x[2] > 0, x[1], 1.0), "012", "00 01 02 12 22"),
    "abs": (lambda x: jnp.abs(x[0]) + x[1], "01", "00"),
    "clip": (lambda x: jnp.clip(x[0], -1, 1) + x[1], "01", "00"),
    "maximum": (lambda x: jnp.maximum(x[0], x[1]) + x[2], "012", "00 01 11"),
    "minimum": (lambda x: jnp.minimum(x[0], 0.0), "0", "00"),
    "max": (lambda x: x.max(), "012", ALL),
    "sort": (lambda x: jnp.sort(x[:2]), "01", "00 01 11"),
    "argmin": (lambda x: x[2] + jnp.argmin(x[:2]), "012", "00 01 11"),
    "median": (lambda x: jnp.median(x), "012", ALL),
    "round": (lambda x: jnp.round(x[0]) + x[1], "01", "00"),
    "floor": (lambda x: jnp.floor(x), "012", "00 11 22"),
    "remainder": (lambda x: jnp.mod(x[0] + x[1], 2 * jnp.pi), "01", "00 01 11"),
    "cast to integers": (lambda x: x.astype(int) + x[2], "012", "00 11 22"),
    "cast to integers and back": (lambda x: x[:2].astype(int).astype(float), "01", "00 11"),
    "comparison times state": (lambda x: (x[0] > 0) * x[1], "01", "00 01"),
    "sign": (lambda x: jnp.sign(x[0]) * x[1], "01", "00 01"),
    "cond": (lambda x: lax.cond(x[0] > 0, lambda: x[1], lambda: 2 * x[1] + x[2]), "012", "00 01 02"),
    "switch": (lambda x: lax.switch(x[0].astype(int), [lambda: x[1], lambda: x[2]]), "012", "00 01 02"),
    "cond on a constant": (lambda x: lax.cond(TERRAIN[0, 0] > 9, jnp.sin, jnp.negative, x[0]), "0", ""),
    "fori_loop": (lambda x: lax.fori_loop(0, 3, lambda i, s: s + i * x[i], 0.0), "12", ""),
    "fori_loop, products": (lambda x: lax.fori_loop(0, 3, lambda i, s: s * x[0], x[1]), "01", "00 01"),
    "long loop": (lambda x: lax.fori_loop(0, 1000, lambda i, s: s + x[i % 2], 0.0), "012", ""),
    "long loop, products": (lambda x: lax.fori_loop(0, 1000, lambda i, s: s * x[0] + x[2], x[1]), "012", "00 01 02"),
    "slowly spreading loop": (lambda x: lax.fori_loop(0, 99, lambda i, s: jnp.roll(s, 1), jnp.r_[x, TERRAIN[0, :96]]),
                              "012", ALL),
    "while on a state": (lambda x: lax.while_loop(lambda s: s[0] < 3, lambda s: (s[0] + x[0], s[1] + x[1]), (0.0, 0.0)),
                         "01", "00 01"),
    "while on constants": (lambda x: x[0] * lax.while_loop(lambda s: s < 3, lambda s: s + 1, 0.0), "0", ""),
    "scan": (lambda x: lax.scan(lambda s, v: (s + v, s * 2), 0.0, x), "012", ""),
    "scan, backwards": (lambda x: lax.scan(lambda s, v: (v, s), x[0], jnp.r_[x[1:], 1.0], reverse=True)[1][2], "0", ""),
    "scan, products": (lambda x: lax.scan(lambda s, v: (s * v, None), 1.0, x)[0], "012", "01 02 12"),
    "jit": (lambda x: jax.jit(lambda v: v * x[0])(x[1]), "01", "01"),
    "vmap": (lambda x: jax.vmap(lambda v: jnp.where(v > 0, v, 0.0))(x[:2]), "01", "00 11"),
    "vmap of an index": (lambda x: jax.vmap(lambda i: x[i])(jnp.array([0, 2])), "02", ""),
    "checkpoint": (jax.checkpoint(lambda x: x[0] * jnp.sin(x[1])), "01", "01 11"),
    "custom_jvp": (lambda x: hidden(x[0]) + x[1], "01", "00"),
    "custom_jvp of a constant": (lambda x: hidden(jnp.array([0.0, 1.0])) * x[:2], "1", ""),
    "custom_vjp": (lambda x: backwards(x[0]) + x[1], "01", "00"),
    "relu": (lambda x: jax.nn.relu(x[0]), "0", "00"),
    "stop_gradient": (lambda x: lax.stop_gradient(x[0]) + x[1], "01", "00"),
    "optimization_barrier": (lambda x: lax.optimization_barrier(x[0]) + x[1], "01", "00"),
    "derivative inside": (lambda x: jax.grad(lambda v: v**2 * x[1])(x[0]), "01", "01"),
    "mutable array": (written, "012", ALL),
    "callback": (lambda x: jax.pure_callback(lambda v: v, jax.ShapeDtypeStruct((), x.dtype), x[0]), "0", "00"),
    "norm": (lambda x: jnp.linalg.norm(x[:2]), "01", "00 01 11"),
    "solve for a constant": (lambda x: jnp.linalg.solve(jnp.eye(2) * x[0] + 1, jnp.ones(2)), "0", "00"),
    "solve for states": (lambda x: jnp.linalg.solve(jnp.eye(2) + 1, x[:2]), "01", ""),
    "solve with both": (lambda x: jnp.linalg.solve(jnp.eye(2) * jnp.abs(x[0]) + 1, x[1:]), "012", "00 01 02"),
    "inv": (lambda x: jnp.linalg.inv(jnp.eye(2) + x[0]), "0", "00"),
    "cholesky": (lambda x: jnp.linalg.cholesky(jnp.eye(2) + x[0]), "0", "00"),
    "sqrt": (lambda x: jnp.sqrt(x[0]) + x[1], "01", "00"),
    "arctan2": (lambda x: jnp.arctan2(x[1], x[0]) + x[2], "012", "00 01 11"),
    "matrix with zeros": (lambda x: HALF_EMPTY @ x, "02", ""),
    "zero times sine": (lambda x: 0.0 * jnp.sin(x[0]) + x[1], "1", ""),
    "zeros among states": (lambda x: jnp.array([[1.0, jnp.sin(x[0])], [0.0, 1.0]])[1] * jnp.exp(x[:2]), "1", "11"),
    "bilinear": (lambda x: x[0] * x[1] + x[2], "012", "01"),
    "sum times state": (lambda x: (x[0] + x[1]) * x[2], "012", "02 12"),
    "power": (lambda x: x[0] ** 2, "0", "00"),
    "square": (lambda x: jnp.square(x[0]), "0", "00"),
    "first power": (lambda x: lax.integer_pow(x[0], 1), "0", ""),
    "real power": (lambda x: x[0] ** x[1], "01", "00 01 11"),
    "dot with itself": (lambda x: jnp.dot(x, x), "012", "00 11 22"),
    "division by state": (lambda x: x[0] / x[1], "01", "01 11"),
    "state in an index": (lambda x: x[x[0].astype(int)], "012", "00 01 02"),
    "states in indices": (lambda x: x[x[:2].astype(int)], "012", "00 01 02 11 12"),
    "state in a window": (lambda x: lax.dynamic_slice(x, (x[0].astype(int),), (2,)), "012", "00 01 02"),
    "state in a written index": (lambda x: x.at[x[0].astype(int)].set(5.0)[1], "01", "00 01"),
    "state in a written window": (lambda x: lax.dynamic_update_slice(x, X[:1], (x[0].astype(int),))[1], "01", "00 01"),
    "set": (lambda x: x.at[1].set(x[0]), "02", ""),
    "set twice": (lambda x: jnp.zeros(2).at[jnp.array([0, 0])].set(x[:2]), "01", ""),
    "set outside": (lambda x: x.at[jnp.array([7])].set(jnp.sin(x[:1])), "012", ""),
    "add": (lambda x: x.at[1].add(x[0] * x[2])[1], "012", "02"),
    "multiply": (lambda x: x.at[1].multiply(x[0]), "012", "01"),
    "apply": (lambda x: x[:1].at[0].apply(jnp.abs), "0", "00"),
    "maximum in place": (lambda x: x[:1].at[0].max(0.0), "0", "00"),
    "get or fill": (lambda x: x.at[jnp.array([0, 9])].get(mode="fill", fill_value=2.0), "0", ""),
    "reduced precision": (lambda x: lax.reduce_precision(x[0], 5, 2), "0", "00"),
    "Fourier transform": (lambda x: jnp.fft.rfft(x).real, "012", ""),
    "running sum": (lambda x: jnp.cumsum(x)[1], "01", ""),
    "running sum, backwards": (lambda x: lax.cumsum(x, reverse=True)[1], "12", ""),
    "batched products": (lambda x: (x.reshape(3, 1, 1) @ x.reshape(3, 1, 1))[1], "1", "11"),
    "random constant": (lambda x: x[0] * jax.random.normal(jax.random.key(0)), "0", ""),
    "large picture": (lambda x: (x[0] * jnp.asarray(TERRAIN)).sum() + x[1] * jnp.abs(x[2]), "012", "12 22"),
}  # fmt: skip


@pytest.mark.parametrize("name", EXPECTED)
def test_the_answer_is_the_one_known_by_hand(name):
    function, uses, pairs = EXPECTED[name]
    found = jax.tree.leaves(
        dependence(function, (X,), ("elements",)), is_leaf=lambda leaf: isinstance(leaf, Dependence)
    )
    for one in found:
        assert np.array_equal(one.pairs, one.pairs.swapaxes(-1, -2))
    words = [marks(one) for one in found]
    assert "".join(sorted(set("".join(word[0] for word in words)))) == uses
    assert " ".join(sorted({pair for word in words for pair in word[1].split()})) == pairs


def coordinated_turn(x):
    """(x, y, vx, vy, rate) after one second."""
    sine, cosine = jnp.sin(x[4]), jnp.cos(x[4])
    along, across = jnp.where(x[4] == 0, 1.0, sine / x[4]), jnp.where(x[4] == 0, 0.0, (1 - cosine) / x[4])
    zero, one = jnp.zeros(()), jnp.ones(())
    turn = jnp.array(
        [
            [one, zero, along, -across],
            [zero, one, across, along],
            [zero, zero, cosine, -sine],
            [zero, zero, sine, cosine],
        ]
    )
    return jnp.concatenate([turn @ x[:4], x[4:]])


def inertial(x):
    """Error of an inertial system: attitude (3), velocity (3), position (3), biases (3 + 3), about a known force."""
    attitude, velocity, position, gyroscope, accelerometer = jnp.split(x, 5)
    force, rate = jnp.array([0.1, -0.2, -9.8]), jnp.array([0.0, 7e-5, 1e-5])
    slopes = [
        -jnp.cross(rate, attitude) - gyroscope,
        jnp.cross(force, attitude) - 2 * jnp.cross(rate, velocity) + accelerometer,
        jnp.stack([velocity[0] / 6.4e6, velocity[1] / 6.4e6, -velocity[2]]),
        -gyroscope / 100.0,
        jnp.zeros(3).at[:2].set(-accelerometer[:2]) / 100.0,
    ]
    return x + 0.1 * jnp.concatenate(slopes)


WIDE = np.arange(6.0, dtype=np.float32)
AFFINE = {
    # name: (function, number of states, states that must be found affine, jointly)
    "constant velocity": (lambda x: x.at[:2].add(0.1 * x[2:]), 4, range(4)),
    "constant velocity, Kronecker": (lambda x: jnp.kron(jnp.array([[1, 0.1], [0, 1]]), jnp.eye(2)) @ x, 4, range(4)),
    "coordinated turn": (coordinated_turn, 5, range(4)),
    "inertial errors": (inertial, 15, range(15)),
    "range with scale error": (lambda x: (1 + x[2]) * jnp.hypot(x[0], x[1]) + x[3], 4, [2, 3]),
    "range with velocity": (lambda x: jnp.hypot(x[0], x[1]), 4, [2, 3]),
    "bearing with bias": (lambda x: jnp.arctan2(x[1], x[0]) + x[2], 3, [2]),
    "terrain with bias": (lambda x: x[2] - terrain(x[:2] + 0.5) + x[3], 4, [2, 3]),
    "terrain, bilinear": (lambda x: lax.cond(x[0] > 3, lambda: x[2], lambda: x[2] * terrain(x[:2])), 3, [2]),
    "reshape and product": (lambda x: x.reshape(2, 3) @ WIDE.reshape(3, 2), 6, range(6)),
    "dot": (lambda x: jnp.dot(WIDE, x), 6, range(6)),
    "tensordot": (lambda x: jnp.tensordot(x.reshape(2, 3), WIDE.reshape(3, 2), 1), 6, range(6)),
    "einsum": (lambda x: jnp.einsum("ij,kj->ik", x.reshape(2, 3), WIDE.reshape(2, 3)), 6, range(6)),
    "outer": (lambda x: jnp.outer(x, WIDE), 6, range(6)),
    "roll, flip and stack": (lambda x: jnp.stack([jnp.roll(x, 2), jnp.flip(x), x[::-1]], axis=1), 6, range(6)),
    "sums": (lambda x: jnp.cumsum(x) + x.mean() + jnp.trapezoid(x), 6, range(6)),
    "diff, pad and tile": (lambda x: jnp.tile(jnp.pad(jnp.diff(x), (2, 1)), 2), 6, range(6)),
    "convolution": (lambda x: jnp.convolve(x, WIDE), 6, range(6)),
    "vmap of a product": (lambda x: jax.vmap(lambda row: row @ WIDE[:2])(x.reshape(3, 2)), 6, range(6)),
    "map of a product": (lambda x: lax.map(lambda row: row @ WIDE[:2], x.reshape(3, 2)), 6, range(6)),
    "Horner's rule in time": (lambda x: lax.fori_loop(0, 3, lambda i, s: s * 0.1 + x[i], 0.0), 6, range(6)),
    "unpacked": (lambda x: jnp.array([x[0] + x[1], *x[1:]]), 3, range(3)),
    "index array": (lambda x: x[jnp.array([0, 2])] - x[np.array([True, False, True])], 3, range(3)),
    "mask": (lambda x: jnp.where(np.arange(3) < 2, x, -x) * (np.arange(3) > 0), 3, range(3)),
    "norm of a part": (lambda x: x[2:] / jnp.linalg.norm(x[:2]), 4, [2, 3]),
    "drag by speed": (lambda x: x[:2] - 0.1 * x[2] * jnp.abs(x[:2]) * x[:2], 3, [2]),
}  # fmt: skip


@pytest.mark.parametrize("name", AFFINE)
def test_what_a_user_would_write_is_found_affine(name):
    function, count, states = AFFINE[name]
    found = dependence(function, (np.zeros(count, np.float32),), ("elements",))
    assert found.uses.any()
    chosen = np.ix_(states, states)
    assert not found.pairs.reshape(-1, count, count)[:, chosen[0], chosen[1]].any()


def test_the_affine_states_of_a_turn_have_coefficients_of_the_rate():
    found = dependence(coordinated_turn, (np.zeros(5, np.float32),), ("elements",))
    assert found.pairs[0, 2, 4] and not found.pairs[0, 0, 4] and not found.pairs[4].any()


def test_zeros_and_elements_are_kept_apart():
    found = dependence(lambda x: (HALF_EMPTY @ x, jnp.sin(x)), (X,), ("elements",))
    assert found[0].uses.tolist() == [[True, False, True], [False] * 3]
    assert np.array_equal(found[1].uses, np.eye(3, dtype=bool))
    assert np.array_equal(found[1].pairs, np.einsum("ij,ik->ijk", np.eye(3), np.eye(3)).astype(bool))


def test_kinds_of_arguments():
    inputs = {"a": np.float32(0), "b": X}
    args = (X[:2], inputs, None, jax.ShapeDtypeStruct((2, 2), "float32"), np.int32(0))
    kinds = ("elements", "whole", "whole", "fixed", "whole")
    assert variables(args, kinds) == [range(0, 2), range(2, 3), range(3, 4), range(4, 4), range(4, 5)]

    def function(x, u, nothing, matrix, t):
        return {"f": matrix @ x + u["a"], "g": u["b"].sum() * u["a"] + t, "h": jnp.where(t > 3, x[0], u["a"])}

    found = dependence(function, args, kinds)
    assert marks(found["f"]) == ("012", "")
    assert marks(found["g"]) == ("24", "22 44")
    assert marks(found["h"]) == ("024", "04 24 44")
    with pytest.raises(MotesError, match="kinds"):
        dependence(function, args, kinds[:-1])
    with pytest.raises(MotesError, match="kinds"):
        dependence(function, args, ("some", *kinds[1:]))


def test_elements_of_pytrees_are_numbered_in_order():
    args = ((), {"a": jax.ShapeDtypeStruct((2,), "float32"), "b": X[:0], "c": X[:1]}, X)
    assert variables(args, ("elements",) * 3) == [range(0), range(3), range(3, 6)]
    found = dependence(lambda empty, u, x: u["a"][1] * u["c"] + x[2], args, ("elements",) * 3)
    assert marks(found) == ("125", "12")


def test_integers_are_never_affine():
    assert marks(dependence(lambda x: 2 * x.mean(), (np.zeros(2, int),), ("elements",)))[1] == "00 01 11"


def test_unknown_constants():
    def function(x, matrix, t):
        turned = lax.cond(t > 3, lambda: matrix @ x, lambda: 2 * x)
        window = lax.dynamic_slice(x, (t,), (1,)) + x[t] + lax.fori_loop(0, t, lambda i, s: s + x[i], 0.0)
        return turned + window + jnp.where(t > 2, x, 0.0).at[t].set(1.0)

    found = dependence(function, (X, jax.ShapeDtypeStruct((3, 3), "float32"), 0), ("elements", "fixed", "fixed"))
    assert marks(found) == ("012", "")


def test_tracers_that_the_function_closes_over_are_constants():
    def outer(matrix, t):
        found = dependence(lambda x: jnp.where(t > 0, matrix @ x, HALF_EMPTY[0] * x), (X,), ("elements",))
        assert marks(found) == ("012", "")
        zeros = dependence(lambda x: HALF_EMPTY @ x * t, (X,), ("elements",))
        assert marks(zeros) == ("02", "")
        return matrix.sum() * t

    jax.jit(outer)(jnp.ones((3, 3)), 1.0)
    jax.vmap(outer)(jnp.ones((2, 3, 3)), jnp.ones(2))
    jax.grad(outer)(jnp.ones((3, 3)), 1.0)


def test_many_variables_are_lumped_but_still_found_affine():
    matrix = np.ones((300, 300), np.float32)
    found = dependence(lambda x: (matrix @ x, x[:1] * x[1:2]), (np.zeros(300, np.float32),), ("elements",))
    assert not found[0].pairs.any() and found[1].pairs[0, 0, 1]
