"""Operations on arrays that are known while a program is traced: by NumPy where it gives the same bits; XLA would compile each one."""

from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from motes.tracing import internals


def worked_out(equation: Any, operands: Sequence[Any]) -> list[Any]:
    """Work out an equation for operands that are known, outside of what is being traced."""
    rule = _RULES.get(equation.primitive.name)
    if rule is not None and all(_is_plain(value) for value in operands):
        try:
            with np.errstate(all="ignore"):
                results = rule(equation.params, *map(np.asarray, operands))
        except _Otherwise:
            pass
        else:
            return results if isinstance(results, list) else [results]
    with jax.ensure_compile_time_eval():
        return internals.worked_out(equation, operands)


class _Otherwise(Exception):
    """NumPy would not give the same."""


def _is_plain(value: Any) -> bool:
    return not jnp.issubdtype(value.dtype, jax.dtypes.extended)


def _elementwise(function: Callable[..., Any]) -> Callable[..., Any]:
    return lambda params, *operands: np.asarray(function(*operands))


def _arithmetic(function: Callable[..., Any]) -> Callable[..., Any]:
    """Arithmetic that is rounded once, in the precision of its operands; half precision is worked out in another one by some."""

    def rule(params: dict[str, Any], *operands: np.ndarray) -> np.ndarray:
        if operands[0].dtype.kind not in "fiu" or operands[0].dtype.itemsize < 4:
            raise _Otherwise
        return np.asarray(function(*operands), operands[0].dtype)

    return rule


def _converted(params: dict[str, Any], value: np.ndarray) -> np.ndarray:
    """Numbers that have no whole counterpart become what each library likes."""
    to = np.dtype(params["new_dtype"])
    if value.dtype.kind == "f" and to.kind not in "fb":
        raise _Otherwise
    return value != 0 if to.kind == "b" else value.astype(to)


def _broadcast(params: dict[str, Any], value: np.ndarray) -> np.ndarray:
    shape = [1] * len(params["shape"])
    for size, axis in zip(value.shape, params["broadcast_dimensions"], strict=True):
        shape[axis] = size
    return np.broadcast_to(value.reshape(shape), params["shape"])


def _slice(params: dict[str, Any], value: np.ndarray) -> np.ndarray:
    steps = params["strides"] or [1] * value.ndim
    return value[tuple(map(slice, params["start_indices"], params["limit_indices"], steps))]


def _dynamic_slice(params: dict[str, Any], value: np.ndarray, *starts: np.ndarray) -> np.ndarray:
    """What would begin too late, or too early, is moved."""
    sizes = params["slice_sizes"]
    begins = [min(max(int(start), 0), whole - size) for start, whole, size in zip(starts, value.shape, sizes, strict=True)]
    return value[tuple(slice(begin, begin + size) for begin, size in zip(begins, sizes, strict=True))]


def _iota(params: dict[str, Any]) -> np.ndarray:
    shape, axis = params["shape"], params["dimension"]
    row = np.arange(shape[axis]).astype(params["dtype"])
    return np.broadcast_to(row.reshape([-1 if i == axis else 1 for i in range(len(shape))]), shape)


def _select(params: dict[str, Any], which: np.ndarray, *cases: np.ndarray) -> np.ndarray:
    if len(cases) != 2 or which.dtype != bool:
        raise _Otherwise
    return np.where(which, cases[1], cases[0])


_RULES: dict[str, Callable[..., Any]] = {
    **{name: _elementwise(getattr(np, function)) for name, function in {
        "eq": "equal", "ne": "not_equal", "lt": "less", "le": "less_equal", "gt": "greater", "ge": "greater_equal"}.items()},
    **{name: _arithmetic(getattr(np, function)) for name, function in {
        "add": "add", "sub": "subtract", "mul": "multiply", "neg": "negative"}.items()},
    "copy": lambda params, value: value,
    "convert_element_type": _converted,
    "broadcast_in_dim": _broadcast,
    "reshape": lambda params, value: value.reshape(params["new_sizes"]),
    "squeeze": lambda params, value: np.squeeze(value, tuple(params["dimensions"])),
    "transpose": lambda params, value: value.transpose(params["permutation"]),
    "rev": lambda params, value: np.flip(value, tuple(params["dimensions"])),
    "concatenate": lambda params, *values: np.concatenate(values, params["dimension"]),
    "stack": lambda params, *values: np.stack(values, params["axis"]),
    "slice": _slice,
    "dynamic_slice": _dynamic_slice,
    "iota": _iota,
    "select_n": _select,
}  # fmt: skip
