"""The walk through traced programs, by rules that work out numbers: calls, loops, branches and solvers are taken for what they do."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax
from jax.custom_batching import custom_vmap, sequential_vmap
from jax.extend.core import jaxpr_as_fun

from motes.tracing import internals
from motes.tracing.affinity import dependence
from motes.tracing.program import walk

X, A = np.array([0.5, -1.0, 2.0], np.float32), np.array([[4.0, 1.0, 0.0], [1.0, 3.0, 1.0], [0.0, 1.0, 5.0]], np.float32)


class Numbers:
    """Rules that work out a program, and note the operations that call or steer others."""

    def __init__(self):
        self.met = set()

    def literal(self, atom):
        return jnp.asarray(atom.val, atom.aval.dtype)

    def constant(self, variable, value):
        return value

    def step(self, equation, operands):
        parts = internals.control(equation, operands)
        if internals.called(equation) is not None or parts is not None:
            self.met.add(equation.primitive.name)
        if internals.called(equation) is not None:
            return walk(internals.called(equation), operands, self)
        if isinstance(parts, internals.Branches):
            return walk(parts.programs[int(parts.index)], parts.operands, self)
        if isinstance(parts, internals.Scan):
            return self.scanned(parts)
        if isinstance(parts, internals.While):
            carry = list(parts.carry)
            while walk(parts.test, [*parts.tested, *carry], self)[0]:
                carry = walk(parts.body, [*parts.consts, *carry], self)
            return carry
        if isinstance(parts, internals.Solve):
            return walk(parts.program, parts.operands, self)
        return internals.worked_out(equation, operands)

    def scanned(self, scan):
        carry, made = list(scan.carry), []
        for i in range(scan.length)[:: -1 if scan.reverse else 1]:
            found = walk(scan.body, [*scan.consts, *carry, *(rows[i] for rows in scan.rows)], self)
            carry = found[: len(carry)]
            made.append(found[len(carry) :])
        made = made[:: -1 if scan.reverse else 1]
        return [*carry, *(jnp.stack(rows) for rows in zip(*made, strict=True))]


@jax.custom_jvp
def forward(x):
    return 2 * x


forward.defjvp(lambda primals, tangents: (forward(primals[0]), 2 * tangents[0]))


@jax.custom_vjp
def backward(x):
    return 2 * x


backward.defvjp(lambda x: (2 * x, None), lambda kept, slope: (2 * slope,))


@custom_vmap
def mapped(x):
    return 2 * x


mapped.def_vmap(lambda size, batched, x: (2 * x, batched[0]))
one_by_one = sequential_vmap(lambda x: 2 * x)
AFFINE = {
    "jit": lambda x: jax.jit(lambda z: 2 * z)(x),
    "program as function": lambda x: jaxpr_as_fun(jax.make_jaxpr(lambda z: 2 * z)(x))(x)[0],
    "remat": lambda x: jax.checkpoint(lambda z: 2 * z)(x),
    "custom_vmap": lambda x: mapped(x),
    "sequential_vmap": lambda x: one_by_one(x),
}
OWN_DERIVATIVE = {"custom_jvp": lambda x: forward(x), "custom_vjp": lambda x: backward(x)}
STEERED = {
    "cond": lambda x: lax.cond(x[0] > 0, lambda z: z + 1, lambda z: 2 * z, x),
    "switch": lambda x: lax.switch(2, [jnp.sin, jnp.cos, jnp.tanh], x),
    "scan": lambda x: lax.scan(lambda c, row: (A @ c + row[0], c.sum() * row[1]), x, (jnp.eye(3), jnp.arange(3.0)))[0],
    "rows": lambda x: lax.scan(lambda c, row: (0.5 * c + row, (c, row.sum())), x, A * x)[1][0],
    "backwards": lambda x: lax.scan(lambda c, row: (0.5 * c + row, c), x, A, reverse=True)[1],
    "fori_loop": lambda x: lax.fori_loop(0, 4, lambda i, z: A @ z / (1 + i), x),
    "while": lambda x: lax.while_loop(lambda z: z[0] < x[2], lambda z: z + 0.75 * x[0], x),
    "map": lambda x: lax.map(lambda z: jnp.sin(z) * x, x),
    "solve": lambda x: lax.custom_linear_solve(lambda v: A @ v, x, lambda matvec, b: jnp.linalg.inv(A) @ b),
    "linalg": lambda x: jnp.linalg.solve(A, x),
    "nested": lambda x: jax.jit(lambda z: lax.fori_loop(0, 2, lambda i, v: jax.checkpoint(mapped)(v) + forward(v), z))(x),
}
MET = {
    "jit": {"jit"}, "remat": {"remat2"}, "custom_vmap": {"custom_vmap_call"}, "sequential_vmap": {"custom_vmap_call"},
    "custom_jvp": {"custom_jvp_call"}, "custom_vjp": {"custom_vjp_call"}, "cond": {"cond"}, "switch": {"cond"}, "scan": {"scan"},
    "rows": {"scan"}, "backwards": {"scan"}, "while": {"while"}, "solve": {"custom_linear_solve"},
    "nested": {"remat2", "custom_vmap_call", "custom_jvp_call"},
}  # fmt: skip
"""Operations that must be known for what they are, on every version of JAX."""


@pytest.mark.parametrize(("name", "function"), (AFFINE | OWN_DERIVATIVE | STEERED).items(), ids=[*AFFINE, *OWN_DERIVATIVE, *STEERED])
def test_a_walk_works_out_what_the_program_does(name, function):
    rules = Numbers()
    (found,) = walk(jax.make_jaxpr(function)(X), [jnp.asarray(X)], rules)
    np.testing.assert_allclose(found, function(X), rtol=1e-6)
    assert rules.met >= MET.get(name, set())


@pytest.mark.parametrize("function", AFFINE.values(), ids=AFFINE)
def test_calls_are_what_they_call(function):
    found = dependence(function, [X], ["elements"])
    assert np.array_equal(found.uses, np.eye(3, dtype=bool)) and not found.pairs.any()


@pytest.mark.parametrize("function", OWN_DERIVATIVE.values(), ids=OWN_DERIVATIVE)
def test_a_derivative_of_its_own_is_not_taken_for_granted(function):
    assert dependence(function, [X], ["elements"]).pairs.any()
    assert not dependence(lambda x, c: function(c) * x, [X, X], ["elements", "fixed"]).pairs.any(), "where nothing is derived"


def test_whether_something_is_traced():
    seen = []
    assert internals.at_top()
    for transformed in (jax.jit, jax.grad, lambda f: lambda x: jax.vmap(f)(x[None])):
        transformed(lambda x: (seen.append(internals.at_top()), x)[1])(1.0 * jnp.ones(()))
    assert seen == [False] * 3 and internals.at_top()
