"""Functions of few numbers, compiled for a CPU as one function: XLA runs an operation at a time otherwise, which takes longer than it does.

A small function within a larger program is called as a whole where the compiler is told so (`xla_cpu_small_call`). What it calls is
compiled alone, so that its bits do not depend on what stands around it.
"""

from collections.abc import Callable, Sequence
from functools import reduce
from math import prod
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
from jax.core import eval_jaxpr
from jax.experimental.xla_metadata import set_xla_metadata

from motes.tracing.internals import called, has_own_derivative, has_own_mapping, without_constants, worked_out
from motes.tracing.program import walk

T = TypeVar("T")
MARKS = {"inlineable": "false", "xla_cpu_small_call": "true"}
FEW = 1024
"""Most elements of an array, beyond which operations are better shared out over threads."""
PRODUCTS = 4096
"""Most products in a product of matrices, beyond which libraries are quicker."""
KNOWN = frozenset("""
abs acos add add_any and argmax argmin asin atan atan2 bitcast_convert_type broadcast_in_dim cbrt ceil clamp concatenate
convert_element_type copy copy_p cos cosh div dot_general dynamic_slice dynamic_update_slice eq erf exp exp2 expand_dims expm1 floor
gather ge gt integer_pow iota is_finite le log log1p logistic lt max min mul ne neg nextafter not optimization_barrier or pad pow
reduce_and reduce_max reduce_min reduce_or reduce_prod reduce_sum rem reshape rev round rsqrt scatter select_n shift_left
shift_right_arithmetic shift_right_logical sign sin sinh slice split sqrt square squeeze stack stop_gradient sub tan tanh transpose xor
""".split())
"""Operations that can be part of a function called as a whole."""
REDUCED: dict[str, Callable[[jax.Array, jax.Array], jax.Array]] = {
    "reduce_sum": jnp.add, "reduce_max": jnp.maximum, "reduce_min": jnp.minimum, "reduce_prod": jnp.multiply,
    "reduce_and": jnp.bitwise_and, "reduce_or": jnp.bitwise_or,
}  # fmt: skip
LONG = 32
"""Most numbers that are brought down to one."""


def at_once(function: Callable[..., T], *args: Any) -> T:
    """Call a function of trees of arrays; as a whole, where it is small enough and all that it does is known. Pure.

    Args:
        function: of the arguments.
        args: trees of arrays.
    """
    if jax.default_backend() != "cpu":
        return function(*args)
    leaves, tree = jax.tree.flatten(args)
    program, shapes = jax.make_jaxpr(lambda leaves: function(*jax.tree.unflatten(tree, leaves)), return_shape=True)(leaves)
    asked = _Asked()
    walk(program, [None] * len(leaves), asked)
    if asked.small:
        # with one result more: compilers may share a lone one out over threads, for which they cannot call what is called here
        whole = jax.jit(lambda consts, leaves: [*_evaluated(program, consts, leaves), jnp.zeros(())], inline=False)
        with set_xla_metadata(**MARKS):
            *found, _ = jax.lax.optimization_barrier(whole(program.consts, leaves))
    else:
        found = eval_jaxpr(program.jaxpr, program.consts, *leaves)
    return jax.tree.unflatten(jax.tree.structure(shapes), found)


def _evaluated(program: Any, consts: Sequence[Any], leaves: Sequence[Any]) -> list[Any]:
    """Work a program out with other arrays in place of its constants."""
    inner, _ = without_constants(program)
    given = dict(zip(inner.constvars, consts, strict=True))
    return walk(program, leaves, _WithoutLibraries(given))


class _Asked:
    """Rules that look for what cannot be part of such a function."""

    small = True

    def literal(self, atom: Any) -> None:
        pass

    def constant(self, variable: Any, value: Any) -> None:
        self.small &= variable.aval.size <= FEW

    def step(self, equation: Any, operands: list[None]) -> list[None]:
        inside = called(equation)
        if inside is None:
            self.small &= equation.primitive.name in KNOWN and _products(equation) <= PRODUCTS and _reduced(equation) <= LONG
        else:
            own = _Asked()
            walk(inside, operands, own)
            self.small &= own.small and not has_own_mapping(equation)
        self.small &= all(variable.aval.size <= FEW for variable in equation.outvars)
        return [None] * len(equation.outvars)


class _WithoutLibraries:
    """Rules that work a program out as it is, but for products and sums, which compilers may hand over to libraries: written out."""

    def __init__(self, given: dict[Any, Any]):
        self._given = given

    def literal(self, atom: Any) -> Any:
        return atom.val

    def constant(self, variable: Any, value: Any) -> Any:
        return self._given.get(variable, value)

    def step(self, equation: Any, operands: list[Any]) -> list[Any]:
        if equation.primitive.name == "dot_general":
            return [_product(equation, *operands)]
        if equation.primitive.name in REDUCED:
            return [_brought_down(equation, operands[0])]
        if called(equation) is None or has_own_derivative(equation):
            return worked_out(equation, operands)
        return walk(called(equation), operands, self)


def _products(equation: Any) -> int:
    """Return how many products of numbers a product of matrices is; 0 of other operations."""
    if equation.primitive.name != "dot_general":
        return 0
    summed = equation.params["dimension_numbers"][0][0]
    return equation.outvars[0].aval.size * prod(equation.invars[0].aval.shape[axis] for axis in summed)


def _reduced(equation: Any) -> int:
    """Return how many numbers each of an operation's results is made of, by sums or the like."""
    if equation.primitive.name == "dot_general":
        axes = equation.params["dimension_numbers"][0][0]
    else:
        axes = equation.params["axes"] if equation.primitive.name in REDUCED else ()
    return prod(equation.invars[0].aval.shape[axis] for axis in axes)


def _brought_down(equation: Any, values: jax.Array) -> jax.Array:
    """Work out a sum, or the like, one term after the other."""
    axes, join = equation.params["axes"], REDUCED[equation.primitive.name]
    terms = jnp.moveaxis(values, axes, range(len(axes))).reshape(-1, *equation.outvars[0].aval.shape)
    return reduce(join, terms) if terms.shape[0] else worked_out(equation, [values])[0]


def _product(equation: Any, a: jax.Array, b: jax.Array) -> jax.Array:
    """Work out a product of matrices as products of numbers and their sums."""
    (summed_a, summed_b), (batch_a, batch_b) = equation.params["dimension_numbers"]
    free_a, free_b = ([axis for axis in range(x.ndim) if axis not in (*summed, *batch)]
                      for x, summed, batch in ((a, summed_a, batch_a), (b, summed_b, batch_b)))  # fmt: skip
    rows = jnp.transpose(a, (*summed_a, *batch_a, *free_a))
    columns = jnp.transpose(b, (*summed_b, *batch_b, *free_b))
    first, batch = len(summed_a), len(summed_a) + len(batch_a)
    rows = jnp.expand_dims(rows, tuple(range(rows.ndim, rows.ndim + len(free_b))))
    columns = jnp.expand_dims(columns, tuple(range(batch, batch + len(free_a))))
    shape = equation.outvars[0].aval.shape
    rows, columns = (x.reshape(-1, *x.shape[first:]) for x in (rows, columns))
    terms = [row * column for row, column in zip(rows, columns, strict=True)]
    return (reduce(jnp.add, terms) if terms else jnp.zeros(shape)).astype(equation.outvars[0].aval.dtype)
