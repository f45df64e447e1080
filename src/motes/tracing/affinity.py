"""Which inputs of a function enter it affinely: exact reasoning on the traced program, conservative when unsure.

Second derivatives do not answer this: they vanish almost everywhere for a floor, a look-up in a map, a comparison, an
absolute value. Here each element of each array of the program carries the variables that it uses and the pairs of
variables in which it is not jointly affine; `affinity_rules` says what each primitive does to them, and this file what
calls, loops and branches do. What has a derivative of its own (`custom_jvp`) counts as nonlinear, since
the matrices of a model are later taken by differentiation.
"""

from collections.abc import Callable, Sequence
from math import prod
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import ShapedArray

from motes.core import checks
from motes.tracing import internals
from motes.tracing.affinity_rules import apply
from motes.tracing.affinity_values import (
    KNOWN_LIMIT,
    Value,
    any_element,
    constant,
    decided,
    entangled,
    spread,
    summary,
    union,
)
from motes.tracing.known import worked_out
from motes.tracing.program import walk

KINDS = ("elements", "whole", "fixed")
UNROLL_LIMIT = 64  # steps; longer loops are summed up by a fixed point
LARGE = 10_000_000  # marks of pairs; arrays that would need more are treated as a whole


class Dependence(NamedTuple):
    """How each element of one array depends on the m variables.

    An element is affine in a set of variables, jointly and for every fixed value of the others, if `pairs` is False for
    all pairs of the set, each variable with itself included. The coefficient of an affine variable j depends on the
    variable i only if `pairs[..., j, i]`.
    """

    uses: np.ndarray  # bool (*shape, m): the variables that the element may depend on
    pairs: np.ndarray  # bool (*shape, m, m), symmetric: the pairs in which the element may not be jointly affine


def variables(args: Sequence[Any], kinds: Sequence[str]) -> list[range]:
    """Return the numbers of the variables that each argument of `dependence` stands for.

    Args:
        args: one pytree of arrays, or of their shapes and dtypes, per argument.
        kinds: one word per argument, as for `dependence`.
    """
    if len(args) != len(kinds):
        checks.refuse("kinds", f"{len(args)} words, one per argument", f"{len(kinds)}")
    ranges, start = [], 0
    for arg, kind in zip(args, kinds, strict=True):
        checks.option("kinds", kind, KINDS)
        count = {"elements": sum(np.size(leaf) for leaf in jax.tree.leaves(arg)), "whole": 1, "fixed": 0}[kind]
        ranges.append(range(start, start + count))
        start += count
    return ranges


def dependence(function: Callable[..., Any], args: Sequence[Any], kinds: Sequence[str]) -> Any:
    """Tell how the outputs of a function depend on the variables that its arguments hold.

    The function is traced once and never run. What it closes over is constant, and its numbers count if they are known
    now: a zero in a matrix cuts the dependence.

    Args:
        function: takes arrays and gives a pytree of arrays.
        args: one pytree of arrays, or of their shapes and dtypes, per argument of the function.
        kinds: one word per argument: "elements" (each element is a variable, numbered in order), "whole" (the argument
            is one variable, even if it has no array), "fixed" (constant, but not known now).

    Returns:
        A pytree like the output of the function, with a `Dependence` (itself a tuple of two arrays, which may be
        read-only) in the place of each array.
    """
    ranges = variables(args, kinds)
    count = sum(map(len, ranges))
    program, shapes = jax.make_jaxpr(function, return_shape=True)(*args)
    places = sum(map(_places, args, ranges, kinds), [])
    inputs = [_source(aval, place, count) for aval, place in zip(program.in_avals, places, strict=True)]
    outputs = [Dependence(value.uses, value.pairs) for value in walk(program, inputs, _Affinity(count))]
    return jax.tree.unflatten(jax.tree.structure(shapes), outputs)


def _places(arg: Any, numbers: range, kind: str) -> list[np.ndarray]:
    """Return, per array of an argument, the numbers of the variables of its elements, if it has any."""
    leaves = jax.tree.leaves(arg)
    if kind == "whole":
        return [np.full(np.size(leaf), numbers.start) for leaf in leaves]
    if kind == "fixed":
        return [np.zeros(0, int) for _ in leaves]
    ends = numbers.start + np.cumsum([np.size(leaf) for leaf in leaves], dtype=int)
    return [np.arange(end - np.size(leaf), end) for leaf, end in zip(leaves, ends, strict=True)]


def _source(aval: Any, numbers: np.ndarray, count: int) -> Value:
    """Return an input of the program, the elements of which are the variables with the given numbers."""
    value = constant(aval.shape, count)
    if not numbers.size:
        return value
    marks = np.zeros((numbers.size, count), bool)
    marks[np.arange(numbers.size), numbers] = True
    smooth = jnp.issubdtype(aval.dtype, jnp.inexact)
    if _is_large(aval.shape, count):
        marks = np.broadcast_to(marks.any(0), marks.shape)
    value = value._replace(uses=marks.reshape(*aval.shape, count))
    return value if smooth else entangled(aval.shape, any_element(marks, 1))


def _is_large(shape: tuple[int, ...], count: int) -> bool:
    return prod(shape) * count * count > LARGE


# ---- the rules ----


class _Affinity:
    """Rules by which a `Value` stands for each array of the program; `count` is the number of variables."""

    def __init__(self, count: int):
        self.count = count

    def literal(self, atom: Any) -> Value:
        return constant(atom.aval.shape, self.count, np.asarray(atom.val, atom.aval.dtype))

    def constant(self, variable: Any, value: Any) -> Value:
        # not known now if an outer trace holds it or if it can be written to
        known = checks.is_concrete(value) and isinstance(variable.aval, ShapedArray)
        return constant(variable.aval.shape, self.count, value if known else None)

    def step(self, equation: Any, operands: list[Value]) -> list[Value]:
        count, call = self.count, internals.called(equation)
        own = internals.has_own_derivative(equation)
        if call is not None and not own:
            return walk(call, operands, self)
        if _is_opaque(equation):
            return [entangled(getattr(v.aval, "shape", ()), np.ones(count, bool)) for v in equation.outvars]
        shapes = [variable.aval.shape for variable in equation.outvars]
        known = _computed(equation, operands)
        if known is not None:
            return [constant(shape, count, number) for shape, number in zip(shapes, known, strict=True)]
        if own and not any(any_element(value.uses, 1).any() for value in operands):
            return walk(call, operands, self)
        control = internals.control(equation, operands)
        if control is not None:
            return _CONTROL[type(control)](control, self)
        if not operands:
            return [constant(shape, count) for shape in shapes]
        large = any(_is_large(shape, count) for shape in (*shapes, *(value.live.shape for value in operands)))
        return apply(equation, operands, large)


def _is_opaque(equation: Any) -> bool:
    """Tell whether an equation may read or write something else than its operands and outputs."""
    atoms = (*equation.invars, *equation.outvars)
    return bool(equation.effects) or not all(isinstance(atom.aval, ShapedArray) for atom in atoms)


def _computed(equation: Any, operands: Sequence[Value]) -> list[Any] | None:
    """Return the outputs of an equation as numbers, if all its operands are known."""
    if any(value.known is None for value in operands):
        return None
    if any(prod(variable.aval.shape) > KNOWN_LIMIT for variable in equation.outvars):
        return None
    try:
        return worked_out(equation, [value.known for value in operands])
    except Exception:  # whatever stops it (an axis name, a debugging switch), the numbers are merely not known
        return None


# ---- loops, branches and solvers ----


def _branches(cond: internals.Branches, rules: _Affinity) -> list[Value]:
    if cond.index.known is not None:
        return walk(cond.programs[int(cond.index.known)], cond.operands, rules)
    results = [walk(branch, cond.operands, rules) for branch in cond.programs]
    return [_join(outcomes, cond.index.uses) for outcomes in zip(*results, strict=True)]


def _scan(scan: internals.Scan, rules: _Affinity) -> list[Value]:
    body, length, carry = scan.body, scan.length, list(scan.carry)
    made = [(length, *aval.shape) for aval in body.out_avals[len(carry) :]]
    if not 0 < length <= UNROLL_LIMIT or any(_is_large(shape, rules.count) for shape in (*(v.live.shape for v in carry), *made)):
        any_rows = [_any_row(value) for value in scan.rows]
        carry, outputs = _fixed_point(lambda now: walk(body, [*scan.consts, *now, *any_rows], rules), carry, rules.count)
        return carry + [_repeat(value, length) for value in outputs]
    outputs = [[] for _ in made]
    order = slice(None, None, -1 if scan.reverse else 1)
    for step in range(length)[order]:
        results = walk(body, [*scan.consts, *carry, *(_row(value, step) for value in scan.rows)], rules)
        carry = results[: len(carry)]
        for rows_so_far, row in zip(outputs, results[len(carry) :], strict=True):
            rows_so_far.append(row)
    return carry + [_stack(found[order]) for found in outputs]


def _while(loop: internals.While, rules: _Affinity) -> list[Value]:
    carry, _ = _fixed_point(lambda now: walk(loop.body, [*loop.consts, *now], rules), list(loop.carry), rules.count)
    (test,) = walk(loop.test, [*loop.tested, *carry], rules)
    return [_join([value], test.uses) for value in carry]


def _solve(solve: internals.Solve, rules: _Affinity) -> list[Value]:
    # the solver itself is walked through, since that is what runs; that it has no constant term is its contract in JAX
    results = walk(solve.program, solve.operands, rules)
    used = [any_element(value.uses, 1) for value in solve.matrices]
    by = np.logical_or.reduce([np.zeros(rules.count, bool), *used])
    return [_join([value], by) for value in results]


_CONTROL: dict[type, Callable[[Any, _Affinity], list[Value]]] = {
    internals.Branches: _branches,
    internals.Scan: _scan,
    internals.While: _while,
    internals.Solve: _solve,
}


def _join(values: Sequence[Value], by: np.ndarray) -> Value:
    """Return what holds for whichever of the values, where the choice depends on the variables `by`, `(m,)`."""
    shape, count = values[0].live.shape, by.shape[-1]
    if not _is_large(shape, count):
        return decided(union(values), by)
    return spread(decided(union([summary(value) for value in values]), by), shape)


def _fixed_point(
    body: Callable[[list[Value]], list[Value]], carry: list[Value], count: int
) -> tuple[list[Value], list[Value]]:
    """Return what holds for the carry of a loop at any step, and for its other outputs."""
    never = np.zeros(count, bool)
    carry = [_join([value], never) for value in carry]
    for _ in range(UNROLL_LIMIT):
        results = body(carry)
        wider = [_join([old, new], never) for old, new in zip(carry, results[: len(carry)], strict=True)]
        if all(_same(old, new) for old, new in zip(carry, wider, strict=True)):
            return carry, results[len(carry) :]
        carry = wider
    carry = [entangled(value.live.shape, ~never) for value in carry]
    return carry, body(carry)[len(carry) :]


def _same(left: Value, right: Value) -> bool:
    return all(np.array_equal(*fields) for fields in zip(left[:3], right[:3], strict=True))


def _any_row(value: Value) -> Value:
    """Return what holds for every row of an array."""
    return Value(*(np.asarray((field[:1] if field.strides[0] == 0 else field).any(0)) for field in value[:3]))


def _repeat(value: Value, length: int) -> Value:
    """Return the array of `length` rows for each of which the value holds."""
    return Value(*(np.broadcast_to(field, (length, *field.shape)) for field in value[:3]))


def _row(value: Value, step: int) -> Value:
    """Return one row of an array."""
    numeric = value.known is not None and not jnp.issubdtype(value.known.dtype, jax.dtypes.extended)
    known = np.asarray(value.known)[step] if numeric else None
    return Value(value.live[step], value.uses[step], value.pairs[step], known)


def _stack(rows: Sequence[Value]) -> Value:
    """Return the array with the given rows."""
    return Value(*(np.stack(fields) for fields in zip(*(row[:3] for row in rows), strict=True)))
