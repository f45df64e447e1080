"""What each primitive of a traced program does to the dependence of arrays on the variables.

A primitive that is missing from the tables makes its outputs nonlinear in everything that its inputs use.

`stop_gradient` is the identity as a function but not for derivatives, from which the matrices of a model are taken
later. It leaves an equation of that name in the traced program and counts as nonlinear, as `optimization_barrier` does.
"""

from collections.abc import Callable, Sequence
from math import prod
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from motes.tracing.affinity_values import (
    Value,
    any_element,
    decided,
    divide,
    make,
    masked,
    multiply,
    nonlinear,
    nothing,
    spread,
    summary,
    union,
)

Rule = Callable[[Any, Sequence[Value]], Value]  # of an equation of the program and its operands

# ---- rules, element by element: operands have one shape, or the shape () ----


def _nonlinear(equation: Any, values: Sequence[Value]) -> Value:
    return nonlinear(values)


def _union(equation: Any, values: Sequence[Value]) -> Value:
    return union(values)


def _product(equation: Any, values: Sequence[Value]) -> Value:
    return multiply(*values)


def _cast(equation: Any, values: Sequence[Value]) -> Value:
    (value,) = values
    dtypes = equation.invars[0].aval.dtype, equation.params["new_dtype"]
    inexact = all(jnp.issubdtype(dtype, jnp.inexact) for dtype in dtypes)
    return union(values) if inexact else nonlinear(values)._replace(live=value.live)


def _integer_power(equation: Any, values: Sequence[Value]) -> Value:
    return union(values) if equation.params["y"] == 1 else nonlinear(values)


def _select(equation: Any, values: Sequence[Value]) -> Value:
    which, *cases = values
    if which.known is None:
        return decided(union(cases), which.uses)
    chosen = np.asarray(which.known)
    return union([masked(case, chosen == number) for number, case in enumerate(cases)])


_NONLINEAR = """
    abs acos acosh and asin asinh atan atan2 atanh bessel_i0e bessel_i1e cbrt ceil clamp cos cosh digamma eq eq_to erf
    erf_inv erfc exp exp2 expm1 floor ge gt igamma igammac is_finite le le_to lgamma log log1p logistic lt lt_to max min
    ne nextafter not or polygamma pow reduce_precision rem round rsqrt shift_left shift_right_arithmetic
    shift_right_logical sign sin sinh sqrt square stop_gradient tan tanh xor
""".split()
_SUMS = (
    "add add_any complex conj copy imag layout_constraint name neg pvary real reshard sharding_constraint sub".split()
)

_ELEMENTWISE: dict[str, Rule] = {
    **dict.fromkeys(_NONLINEAR, _nonlinear),
    **dict.fromkeys(_SUMS, _union),
    "mul": _product,
    "div": lambda equation, values: divide(*values),
    "convert_element_type": _cast,
    "integer_pow": _integer_power,
    "select_n": _select,
}


# ---- rules that move elements: what is moved is the number of each element ----


def _numbered(values: Sequence[Value]) -> list[np.ndarray]:
    """Number the elements of several arrays in one sequence."""
    starts = np.cumsum([0, *(value.live.size for value in values[:-1])])
    return [
        np.arange(start, start + value.live.size, dtype=np.int32).reshape(value.live.shape)
        for start, value in zip(starts, values, strict=True)
    ]


def _rearranged(values: Sequence[Value], source: np.ndarray) -> Value:
    """Return the array whose elements are those with the numbers `source`; negative numbers are unknown constants."""
    count = values[0].uses.shape[-1]

    def flat(name: str, last: tuple[int, ...], outside: bool) -> np.ndarray:
        parts = [getattr(value, name).reshape(value.live.size, *last) for value in values]
        return np.concatenate([*parts, np.full((1, *last), outside)])

    live = flat("live", (), True)
    source = np.where(source < 0, len(live) - 1, source)
    uses = flat("uses", (count,), False)[source]
    if not any(any_element(value.pairs, 2).any() for value in values):
        return Value(live[source], uses, nothing((*uses.shape, count)))
    return make(live[source], uses, flat("pairs", (count, count), False)[source])


def _broadcast(params: dict[str, Any], array: np.ndarray) -> np.ndarray:
    axes = [1] * len(params["shape"])
    for axis, size in zip(params["broadcast_dimensions"], array.shape, strict=True):
        axes[axis] = size
    return np.broadcast_to(array.reshape(axes), params["shape"])


def _reshape(params: dict[str, Any], array: np.ndarray) -> np.ndarray:
    order = params["dimensions"]
    return (array if order is None else array.transpose(order)).reshape(params["new_sizes"])


def _slice(params: dict[str, Any], array: np.ndarray) -> np.ndarray:
    strides = params["strides"] or (1,) * array.ndim
    return array[tuple(map(slice, params["start_indices"], params["limit_indices"], strides))]


def _pad(params: dict[str, Any], array: np.ndarray, padding: np.ndarray) -> np.ndarray:
    for axis, (low, high, interior) in enumerate(params["padding_config"]):
        size = array.shape[axis]
        length = low + high + size + max(size - 1, 0) * interior
        at = low + np.arange(size) * (interior + 1)
        inside = (at >= 0) & (at < length)
        wider = np.full((*array.shape[:axis], length, *array.shape[axis + 1 :]), padding)
        wider[(slice(None),) * axis + (at[inside],)] = np.compress(inside, array, axis)
        array = wider
    return array


_MOVES: dict[str, Callable[..., np.ndarray]] = {
    "broadcast_in_dim": _broadcast,
    "broadcast_to": lambda params, array: np.broadcast_to(array, params["shape"]),
    "concatenate": lambda params, *arrays: np.concatenate(arrays, params["dimension"]),
    "pad": _pad,
    "reshape": _reshape,
    "rev": lambda params, array: np.flip(array, params["dimensions"]),
    "slice": _slice,
    "stack": lambda params, *arrays: np.stack(arrays, params["axis"]),
    "squeeze": lambda params, array: np.squeeze(array, tuple(params["dimensions"])),
    "tile": lambda params, array: np.tile(array, params["reps"]),
    "transpose": lambda params, array: array.transpose(params["permutation"]),
}


def _move(equation: Any, values: Sequence[Value]) -> Value:
    return _rearranged(values, _MOVES[equation.primitive.name](equation.params, *_numbered(values)))


def _split(equation: Any, values: Sequence[Value]) -> list[Value]:
    (numbers,) = _numbered(values)
    parts = np.split(numbers, np.cumsum(equation.params["sizes"])[:-1], equation.params["axis"])
    return [_rearranged(values, part) for part in parts]


def _unstack(equation: Any, values: Sequence[Value]) -> list[Value]:
    (numbers,) = _numbered(values)
    return [_rearranged(values, part) for part in np.moveaxis(numbers, equation.params["axis"], 0)]


# ---- rules with an index, which may be known now, constant but unknown, or dependent ----


def _window(starts: Sequence[Value], shape: tuple[int, ...], sizes: tuple[int, ...]) -> tuple[slice, ...] | None:
    """Return the known window of a dynamic slice, moved inside as JAX does; None if it is not known."""
    if any(start.known is None for start in starts):
        return None
    first = [min(max(int(s.known), 0), full - size) for s, full, size in zip(starts, shape, sizes, strict=True)]
    return tuple(slice(start, start + size) for start, size in zip(first, sizes, strict=True))


def _used(index: Sequence[Value]) -> np.ndarray:
    """Return the variables that an index uses, `(m,)`."""
    return any_element(union([summary(part) for part in index]).uses, 1)


def _dynamic_slice(equation: Any, values: Sequence[Value]) -> Value:
    operand, *starts = values
    window = _window(starts, operand.live.shape, equation.params["slice_sizes"])
    if window is None:
        return decided(spread(summary(operand), equation.outvars[0].aval.shape), _used(starts))
    return _rearranged([operand], _numbered([operand])[0][window])


def _dynamic_update_slice(equation: Any, values: Sequence[Value]) -> Value:
    operand, update, *starts = values
    window = _window(starts, operand.live.shape, update.live.shape)
    if window is None:
        return decided(union([operand, spread(summary(update), operand.live.shape)]), _used(starts))
    numbers, new = _numbered([operand, update])
    numbers[window] = new
    return _rearranged([operand, update], numbers)


def _gather(equation: Any, values: Sequence[Value]) -> Value:
    operand, index = values
    params = equation.params
    if index.known is None:
        return decided(spread(summary(operand), equation.outvars[0].aval.shape), _used([index]))
    (numbers,) = _numbered([operand])
    with jax.ensure_compile_time_eval():
        dimensions, sizes, mode = params["dimension_numbers"], params["slice_sizes"], params["mode"]
        source = lax.gather(numbers, index.known, dimensions, sizes, mode=mode, fill_value=-1)
        return _rearranged([operand], np.asarray(source))


def _scatter(equation: Any, values: Sequence[Value]) -> Value:
    operand, index, updates = values
    shape, params, name = operand.live.shape, equation.params, equation.primitive.name
    if name == "scatter" and params["update_jaxpr"] is not None:  # the old elements pass through a function of the user
        return spread(nonlinear([summary(value) for value in values]), shape)
    if index.known is None:
        product = nonlinear([summary(updates)])  # of any number of updates
        landed = spread(product if name == "scatter-mul" else summary(updates), shape)
        return decided(multiply(operand, landed) if name == "scatter-mul" else union([operand, landed]), _used([index]))
    (numbers,) = _numbered([updates])
    with jax.ensure_compile_time_eval():
        dimensions, mode = params["dimension_numbers"], params["mode"]
        source = lax.scatter(np.full(shape, -1, np.int32), index.known, numbers, dimensions, mode=mode)
        hits = lax.scatter_add(np.zeros(shape, np.int32), index.known, np.ones_like(numbers), dimensions, mode=mode)
        source, hits = np.asarray(source), np.asarray(hits)
    if (hits > 1).any():
        landed = spread(nonlinear([summary(updates)]) if name == "scatter-mul" else summary(updates), shape)
    else:
        landed = _rearranged([updates], source)
    landed = masked(landed, hits > 0)
    if name == "scatter-mul":
        return multiply(operand, landed._replace(live=landed.live | (hits == 0)))
    return union([masked(operand, hits == 0) if name == "scatter" else operand, landed])


# ---- sums of many elements ----


def _reduce_sum(equation: Any, values: Sequence[Value]) -> Value:
    (value,) = values
    axes = tuple(equation.params["axes"])
    return make(*(np.asarray(field.any(axes)) for field in value[:3]))


def _reduce(equation: Any, values: Sequence[Value]) -> Value:
    return nonlinear([_reduce_sum(equation, values)])


def _cumulative_sum(equation: Any, values: Sequence[Value]) -> Value:
    (value,) = values
    axis, order = equation.params["axis"], slice(None, None, -1 if equation.params["reverse"] else 1)
    along = (slice(None),) * axis + (order,)
    return make(*(np.logical_or.accumulate(field[along], axis)[along] for field in value[:3]))


def _contract(left: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Tell where two marks meet in a sum of products.

    Args:
        left: marks `(batch, rows, inner, a)` of the elements of a stack of matrices.
        right: marks `(batch, inner, columns, b)` of those of another.

    Returns:
        The marks that meet in the elements of the product of the matrices, `(batch, rows, columns, a, b)`.
    """
    batch, rows, inner, first = left.shape
    columns, second = right.shape[2:]
    left = left.swapaxes(2, 3).reshape(batch, rows * first, inner)
    right = right.reshape(batch, inner, columns * second)
    met = left.astype(np.float32) @ right.astype(np.float32) > 0
    return met.reshape(batch, rows, first, columns, second).swapaxes(2, 3)


def _as_matrices(value: Value, batch: Sequence[int], inner: Sequence[int], inner_last: bool) -> list[np.ndarray]:
    """Return the marks of an operand of `dot_general` as those of a stack of matrices: live, uses, pairs."""
    sizes, count = value.live.shape, value.uses.shape[-1]
    free = [axis for axis in range(len(sizes)) if axis not in (*inner, *batch)]
    groups = (batch, free, inner) if inner_last else (batch, inner, free)
    order = [axis for group in groups for axis in group]
    lengths = [prod(sizes[axis] for axis in group) for group in groups]
    fields = (value.live, 1), (value.uses, count), (value.pairs, count * count)
    return [f.reshape(*sizes, last).transpose(*order, len(sizes)).reshape(*lengths, last) for f, last in fields]


def _dot_general(equation: Any, values: Sequence[Value]) -> Value:
    inner, batch = equation.params["dimension_numbers"]
    shape, count = equation.outvars[0].aval.shape, values[0].uses.shape[-1]
    left_live, left_uses, left_pairs = _as_matrices(values[0], batch[0], inner[0], inner_last=True)
    right_live, right_uses, right_pairs = _as_matrices(values[1], batch[1], inner[1], inner_last=False)
    live = _contract(left_live, right_live)
    uses = _contract(left_uses, right_live)[..., 0] | _contract(left_live, right_uses)[..., 0, :]
    alone = _contract(left_pairs, right_live)[..., 0] | _contract(left_live, right_pairs)[..., 0, :]
    met = _contract(left_uses, right_uses)
    pairs = alone.reshape(met.shape) | met | met.swapaxes(-1, -2)
    return make(live.reshape(shape), uses.reshape(*shape, count), pairs.reshape(*shape, count, count))


# ---- the tables ----

_PRECISE: dict[str, Rule] = {
    **_ELEMENTWISE,
    **dict.fromkeys(_MOVES, _move),
    **dict.fromkeys(("reduce_and", "reduce_max", "reduce_min", "reduce_or", "reduce_prod"), _reduce),
    **dict.fromkeys(("scatter", "scatter-add", "scatter-mul", "scatter-sub"), _scatter),
    "cumsum": _cumulative_sum,
    "dot_general": _dot_general,
    "dynamic_slice": _dynamic_slice,
    "dynamic_update_slice": _dynamic_update_slice,
    "gather": _gather,
    "reduce_sum": _reduce_sum,
}
_SEVERAL = {"device_put": lambda equation, values: list(values), "split": _split, "unstack": _unstack}
# without a precise rule, or with large arrays: what holds for all elements of all outputs, from summaries of operands
_COARSE: dict[str, Rule] = {
    **_ELEMENTWISE,
    **dict.fromkeys((*_MOVES, *_SEVERAL, "cumsum", "fft", "reduce_sum", "reduce_window_sum"), _union),
    **dict.fromkeys(("conv_general_dilated", "dot_general"), _product),
    "triangular_solve": lambda equation, values: divide(values[1], values[0]),
}


def apply(equation: Any, values: Sequence[Value], large: bool) -> list[Value]:
    """Return the outputs of one equation; `large` ones are treated as a whole, not element by element."""
    name = equation.primitive.name
    if name in _SEVERAL and not large:
        return _SEVERAL[name](equation, values)
    if name in _PRECISE and not large:
        return [_PRECISE[name](equation, values)]
    rule = _COARSE.get(name, _nonlinear)
    whole = rule(equation, [summary(value) for value in values])
    return [spread(whole, variable.aval.shape) for variable in equation.outvars]
