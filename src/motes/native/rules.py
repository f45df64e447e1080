"""What each traced operation is in C++, for one particle: elementwise ones are a formula, data movement is found by moving numbers."""

from collections.abc import Callable
from functools import wraps
from typing import Any, NamedTuple, TypeVar, cast

import jax
import numpy as np

from motes.tracing.internals import written_at


class Scalar(NamedTuple):
    """A number of one particle (or a parameter shared by all) in the C++ program.

    Attributes:
        text: a name or a literal.
        kind: "float", "int32_t", "uint32_t" or "bool".
    """

    text: str
    kind: str


Scalars = Any
"""Array of `Scalar`, of which type checkers do not know what an element is."""

Named = Callable[[str, str], Scalar]
"""Gives an expression of a type a name: `named("float", "x0 + x1")`."""


class Untranslatable(Exception):
    """A traced program has no native form; the text says what stands in the way, and where the user wrote it.

    Attributes:
        equation: the innermost one that cannot be translated.
    """

    equation: Any = None

    def __str__(self) -> str:
        """Say what and where."""
        place = "" if self.equation is None else written_at(self.equation)
        return super().__str__() + (f" ({place})" if place else "")


S = TypeVar("S", bound=Callable[..., Any])


def located(step: S) -> S:
    """Have a rule for equations tell which one it could not take."""

    @wraps(step)
    def told(rules: Any, equation: Any, operands: list[Any]) -> Any:
        try:
            return step(rules, equation, operands)
        except Untranslatable as reason:
            if reason.equation is None:
                reason.equation = equation
            raise

    return cast(S, told)


KINDS = {np.dtype(np.float32): "float", np.dtype(np.int32): "int32_t", np.dtype(np.uint32): "uint32_t", np.dtype(bool): "bool"}


def kind_of(dtype: Any) -> str:
    """Return the C++ type of an array's elements."""
    try:
        return KINDS[np.dtype(dtype)]
    except (KeyError, TypeError):
        raise Untranslatable(f"numbers of type {dtype}") from None


def literal(value: Any, kind: str) -> str:
    """Write a known number as C++."""
    if kind == "bool":
        return "true" if value else "false"
    if kind != "float":
        return f"({kind}){int(value)}{'u' if kind == 'uint32_t' else 'll'}"
    number = np.float32(value)
    if np.isnan(number):
        return "NOT_A_NUMBER"
    if np.isinf(number):
        return "INF" if number > 0 else "(-INF)"
    return f"({float(number).hex()}f)"


def _of_c(name: str) -> str:
    """Return a function of the C library, for float32."""
    return f"__builtin_{name}f"


FUNCTIONS = {
    **{name: f"motes::{name}" for name in (
        "exp", "expm1", "log", "log1p", "sin", "cos", "tan", "asin", "acos", "atan", "atan2", "sinh", "cosh", "tanh", "logistic", "sqrt",
        "rsqrt", "erf_inv")},
    # these keep a loop from being vectorized, but are right
    **{name: _of_c(name) for name in ("cbrt", "erf", "erfc", "exp2", "log2", "lgamma", "pow", "asinh", "acosh", "atanh")},
}  # fmt: skip
"""Functions of float32 alone; those of the namespace motes are in `cpp/math.hpp`."""

FORMULAS = {
    "add": "{0} + {1}", "add_any": "{0} + {1}", "sub": "{0} - {1}", "mul": "{0} * {1}", "neg": "-{0}", "square": "{0} * {0}",
    "max": "(({0} > {1}) | ({0} != {0})) ? {0} : {1}", "min": "(({0} < {1}) | ({0} != {0})) ? {0} : {1}",
    "eq": "{0} == {1}", "ne": "{0} != {1}", "lt": "{0} < {1}", "le": "{0} <= {1}", "gt": "{0} > {1}", "ge": "{0} >= {1}",
    "and": "{0} & {1}", "or": "{0} | {1}", "xor": "{0} ^ {1}", "copy": "{0}", "stop_gradient": "{0}",
    "clamp": "{1} < {0} ? {0} : ({1} > {2} ? {2} : {1})",
}  # fmt: skip
FLOAT_FORMULAS = {
    "div": "{0} / {1}", "abs": "__builtin_fabsf({0})", "floor": "__builtin_floorf({0})", "ceil": "__builtin_ceilf({0})",
    "sign": "{0} != {0} ? {0} : (float)(({0} > 0.f) - ({0} < 0.f))", "is_finite": "__builtin_fabsf({0}) < INF",
    "one_minus_square": "(1.f + {0}) * (1.f - {0})", "rem": "motes::remainder({0}, {1})",
    "lt_to": "motes::rank({0}) < motes::rank({1})", "le_to": "motes::rank({0}) <= motes::rank({1})",
}  # fmt: skip
UNSIGNED_FORMULAS = {
    "not": "~{0}", "div": "motes::quotient({0}, {1})", "rem": "motes::left_over({0}, {1})",
    "shift_left": "(uint32_t){1} < 32u ? {0} << {1} : 0", "shift_right_logical": "(uint32_t){1} < 32u ? (uint32_t){0} >> {1} : 0u",
}  # fmt: skip
SIGNED_FORMULAS = {
    **UNSIGNED_FORMULAS, "abs": "{0} < 0 ? -{0} : {0}", "sign": "({0} > 0) - ({0} < 0)",
    "shift_right_arithmetic": "{0} >> ((uint32_t){1} < 32u ? {1} : 31)",
}  # fmt: skip
_OURS_ALONE = {"logistic", "rsqrt", "erf_inv"}  # not in the standard library
_TESTS = {"eq", "ne", "lt", "le", "gt", "ge", "is_finite", "lt_to", "le_to"}
_OF_KIND = {"float": FLOAT_FORMULAS, "int32_t": SIGNED_FORMULAS, "uint32_t": UNSIGNED_FORMULAS, "bool": {"not": "!{0}"}}
ROUNDINGS = {0: "__builtin_roundf({0})", 1: "motes::round_even({0})"}


def formula(name: str, kinds: list[str], params: dict[str, Any]) -> tuple[str, str] | None:
    """Return the C++ formula of an elementwise operation and the type of its value, or None when it is not known."""
    first = kinds[0] if kinds else ""
    result = "bool" if name in _TESTS else first
    if name in FORMULAS and not (first == "bool" and name in ("add", "sub", "mul", "neg", "max", "min", "square", "add_any")):
        return FORMULAS[name], result
    if name in _OF_KIND.get(first, {}):
        return _OF_KIND[first][name], result
    if name in ("convert_element_type", "bitcast_convert_type"):
        return (_conversion if name == "convert_element_type" else _same_bits)(first, kind_of(params["new_dtype"]))
    if name == "select_n":
        last = f"{{{len(kinds) - 1}}}"
        return "".join(f"{{0}} <= {i} ? {{{i + 1}}} : " for i in range(len(kinds) - 2)) + last, kinds[1]
    if name == "integer_pow" and first == "float":
        return _whole_power(params["y"]), first
    if name == "polynomial" and first == "float":
        return _horner(len(kinds) - 1), first
    if name == "round" and first == "float":
        return ROUNDINGS[int(params["rounding_method"])], first
    function = _function(name, params.get("accuracy")) if all(kind == "float" for kind in kinds) else None
    return (f"{function}({', '.join(f'{{{i}}}' for i in range(len(kinds)))})", first) if function else None


def _function(name: str, accuracy: Any) -> str | None:
    """Return the C++ function of an operation, for the accuracy that was asked for, or None."""
    if accuracy is None:
        return FUNCTIONS.get(name)
    highest = accuracy is jax.lax.AccuracyMode.HIGHEST and name in FUNCTIONS and name not in _OURS_ALONE
    return _of_c(name) if highest else None


def _conversion(before: str, after: str) -> tuple[str, str]:
    if before == "float" and after == "int32_t":
        return "motes::to_int({0})", after
    if before == "float" and after == "uint32_t":
        raise Untranslatable("a float32 made an unsigned whole number")
    if before == "bool" and after != "bool":  # g++ does not vectorize the conversion of a truth that was worked out
        return f"{{0}} ? ({after})1 : ({after})0", after
    return ("{0} != 0" if after == "bool" else f"({after}){{0}}"), after


def _same_bits(before: str, after: str) -> tuple[str, str]:
    if "bool" in (before, after):
        raise Untranslatable("the bits of a truth value")
    return f"motes::bits<{after}>({{0}})", after


def _horner(count: int) -> str:
    """Write a polynomial in the first operand, whose coefficients follow from the lowest power up."""
    text = f"{{{count}}}"
    for i in range(count - 1, 0, -1):
        text = f"motes::fma({text}, {{0}}, {{{i}}})"
    return text


def _whole_power(power: int) -> str:
    if power == 0:
        return "1.f"
    product = " * ".join(["{0}"] * abs(power))
    return product if power > 0 else f"1.f / ({product})"


MOVES: dict[str, Callable[[int], bool]] = {
    **dict.fromkeys(("reshape", "broadcast_in_dim", "squeeze", "transpose", "rev", "slice", "concatenate", "stack",
                     "unstack", "pad", "split"), lambda i: False),
    "gather": lambda i: i == 1,
    "scatter": lambda i: i == 1,
    "dynamic_slice": lambda i: i >= 1,
    "dynamic_update_slice": lambda i: i >= 2,
}  # fmt: skip
"""Operations that move elements about without working on them, and which of their operands say where to."""

REDUCTIONS = {
    "reduce_sum": "add", "reduce_prod": "mul", "reduce_max": "max", "reduce_min": "min", "reduce_and": "and", "reduce_or": "or",
}  # fmt: skip
"""Operations that join the elements along axes by another one."""
