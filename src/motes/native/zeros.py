"""Which elements of what JAX works out for all particles are zero whatever its numbers are: kernels leave out what they are factors of.

Derivatives are full of such zeros, and so are matrices of dynamics. An array of truths stands for an array of numbers: which of its
elements can be other than zero. As everywhere in algebra, zero times anything is zero: infinities are not looked for.
"""

from collections.abc import Callable, Sequence
from math import prod
from typing import Any

import numpy as np
from jax.core import Tracer

from motes.native.rules import MOVES, REALS, Scalar, literal
from motes.tracing import known

SMALL = 4096
"""Elements of arrays that are looked at."""

Live = np.ndarray | None
"""Which elements can be other than zero; None where nothing is known."""


def live_in(value: Any) -> Live:
    """Look at numbers that are known."""
    if not isinstance(value, np.ndarray) or value.size > SMALL or value.dtype.kind not in "fiub":
        return None
    return value != 0


def live_after(eqn: Any, operands: Sequence[Any], lives: Sequence[Live]) -> list[Live]:
    """Tell which elements of the results of an equation can be other than zero, from what is known of its operands."""
    name = eqn.primitive.name
    nothing: list[Live] = [None] * len(eqn.outvars)
    if name == "optimization_barrier":
        return list(lives)
    if all(live is None for live in lives) or any(prod(variable.aval.shape) > SMALL for variable in eqn.outvars):
        return nothing
    if name in _ALONE or name in _BOTH or name == "select_n":
        full = [np.ones(np.shape(value), bool) if live is None else live for value, live in zip(operands, lives, strict=True)]
        found = _selected(operands[0], full[1:]) if name == "select_n" else full[0] if name in _ALONE else _BOTH[name](*full)
        return [np.broadcast_to(found, eqn.outvars[0].aval.shape)]
    if name in MOVES or name in _SUMS:
        where = MOVES.get(name, lambda i: False)
        if any(isinstance(value, Tracer) for i, value in enumerate(operands) if where(i)):
            return nothing
        numbers = [value if where(i) else _stand_in(value, live) for i, (value, live) in enumerate(zip(operands, lives, strict=True))]
        return [np.asarray(result) != 0 for result in known.worked_out(eqn, numbers)]
    return nothing


def _stand_in(value: Any, live: Live) -> np.ndarray:
    return np.ones(np.shape(value), value.dtype) if live is None else live.astype(value.dtype)


def _selected(which: Any, lives: Sequence[np.ndarray]) -> np.ndarray:
    if isinstance(which, np.ndarray) and which.dtype == bool and len(lives) == 2:
        return np.where(which, lives[1], lives[0])
    return np.logical_or.reduce(lives)


_ALONE = {"neg", "convert_element_type", "copy", "abs", "sign", "sqrt", "square", "div", "stop_gradient"}
"""Operations whose result is zero where their first operand is."""
_BOTH: dict[str, Callable[..., np.ndarray]] = {
    "mul": np.logical_and, "add": np.logical_or, "sub": np.logical_or, "add_any": np.logical_or, "max": np.logical_or,
    "min": np.logical_or,
}  # fmt: skip
_SUMS = {"dot_general", "reduce_sum"}

_ZEROS = {literal(zero, kind) for zero in (0.0, -0.0) for kind in REALS}
_TRUTHS = {"true": 1, "false": 0}


def is_zero(scalar: Scalar) -> bool:
    """Tell whether a scalar is a known zero."""
    return scalar.text in _ZEROS


def simpler(name: str, operands: Sequence[Scalar]) -> Scalar | str | None:
    """Return what an operation comes to where an operand is a known zero, or a choice is made: a scalar, or an expression.

    As XLA does, no difference is made between zeros of both signs.
    """
    if name == "select_n":
        which, *cases = operands
        if which.text in _TRUTHS and len(cases) == 2:
            return cases[_TRUTHS[which.text]]
        return cases[0] if all(case == cases[0] for case in cases) else None
    zero = [is_zero(scalar) for scalar in operands]
    if not any(zero):
        return None
    if name == "mul":
        return operands[zero.index(True)]
    if name in ("add", "add_any"):
        return operands[1] if zero[0] else operands[0]
    if name == "sub":
        return operands[0] if zero[1] else f"-{operands[1].text}"
    return operands[0] if zero[0] and name in _ALONE and name != "convert_element_type" else None
