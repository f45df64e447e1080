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
        kind: a type of `KINDS`.
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


KINDS = {
    np.dtype(np.float32): "float", np.dtype(np.float64): "double", np.dtype(np.int32): "int32_t", np.dtype(np.uint32): "uint32_t",
    np.dtype(np.int64): "int64_t", np.dtype(np.uint64): "uint64_t", np.dtype(bool): "bool",
}  # fmt: skip
REALS = {"float": np.float32, "double": np.float64}
"""What particles can be made of."""
_WIDTHS = {KINDS[dtype]: 8 * dtype.itemsize for dtype in KINDS}
LONG = {kind for kind, width in _WIDTHS.items() if width == 64}
"""Types of two words."""


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
    if kind not in REALS:
        return f"({kind}){int(value)}{'ull' if kind.startswith('u') else 'll'}"
    number = REALS[kind](value)
    if np.isnan(number):
        return "NOT_A_NUMBER"
    if np.isinf(number):
        return "INF" if number > 0 else "(-INF)"
    return f"({float(number).hex()}{'f' if kind == 'float' else ''})"


def _of_c(name: str, kind: str) -> str:
    """Return a function of the C library."""
    return f"__builtin_{name}{'f' if kind == 'float' else ''}"


OURS = (
    "exp", "expm1", "log", "log1p", "sin", "cos", "tan", "asin", "acos", "atan", "atan2", "sinh", "cosh", "tanh", "logistic", "sqrt",
    "rsqrt", "erf_inv",
)  # fmt: skip
"""Functions of `cpp/math.hpp` (float), `cpp/math_double.hpp` and `cpp/math_both.hpp`."""

OF_C = ("cbrt", "erf", "erfc", "exp2", "log2", "lgamma", "pow", "asinh", "acosh", "atanh")
"""Functions of the C library: they keep a loop from being vectorized, but are right."""

FORMULAS = {
    "add": "{0} + {1}", "add_any": "{0} + {1}", "sub": "{0} - {1}", "mul": "{0} * {1}", "neg": "-{0}", "square": "{0} * {0}",
    "max": "(({0} > {1}) | ({0} != {0})) ? {0} : {1}", "min": "(({0} < {1}) | ({0} != {0})) ? {0} : {1}",
    "eq": "{0} == {1}", "ne": "{0} != {1}", "lt": "{0} < {1}", "le": "{0} <= {1}", "gt": "{0} > {1}", "ge": "{0} >= {1}",
    "and": "{0} & {1}", "or": "{0} | {1}", "xor": "{0} ^ {1}", "copy": "{0}", "stop_gradient": "{0}",
    "clamp": "{1} < {0} ? {0} : ({1} > {2} ? {2} : {1})",
}  # fmt: skip
_REAL_FORMULAS = {
    "div": "{0} / {1}", "abs": "motes::absolute({0})", "floor": "motes::floor({0})", "ceil": "motes::ceil({0})",
    "sign": "{0} != {0} ? {0} : (KIND)(({0} > 0) - ({0} < 0))", "is_finite": "motes::absolute({0}) < INF",
    "one_minus_square": "(1 + {0}) * (1 - {0})", "rem": "motes::remainder({0}, {1})",
    "lt_to": "motes::rank({0}) < motes::rank({1})", "le_to": "motes::rank({0}) <= motes::rank({1})",
}  # fmt: skip
UNSIGNED_FORMULAS = {
    "not": "~{0}", "div": "motes::quotient({0}, {1})", "rem": "motes::left_over({0}, {1})",
    "shift_left": "(uint64_t){1} < WIDTH ? {0} << {1} : 0", "shift_right_logical": "(uint64_t){1} < WIDTH ? (uWIDTH_t){0} >> {1} : 0",
}  # fmt: skip
SIGNED_FORMULAS = {
    **UNSIGNED_FORMULAS, "abs": "{0} < 0 ? -{0} : {0}", "sign": "({0} > 0) - ({0} < 0)",
    "shift_right_arithmetic": "{0} >> ((uint64_t){1} < WIDTH ? {1} : WIDTH - 1)",
}  # fmt: skip
_OURS_ALONE = {"logistic", "rsqrt", "erf_inv"}  # not in the standard library
_TESTS = {"eq", "ne", "lt", "le", "gt", "ge", "is_finite", "lt_to", "le_to"}
_OF_KIND = {
    "float": _REAL_FORMULAS, "double": _REAL_FORMULAS, "int32_t": SIGNED_FORMULAS, "int64_t": SIGNED_FORMULAS,
    "uint32_t": UNSIGNED_FORMULAS, "uint64_t": UNSIGNED_FORMULAS, "bool": {"not": "!{0}"},
}  # fmt: skip
ROUNDINGS = {0: "motes::round_away({0})", 1: "motes::round_even({0})"}


def formula(name: str, kinds: list[str], params: dict[str, Any]) -> tuple[str, str] | None:
    """Return the C++ formula of an elementwise operation and the type of its value, or None when it is not known."""
    first = kinds[0] if kinds else ""
    result = "bool" if name in _TESTS else first
    if name in FORMULAS and not (first == "bool" and name in ("add", "sub", "mul", "neg", "max", "min", "square", "add_any")):
        return FORMULAS[name], result
    if name in _OF_KIND.get(first, {}):
        text = _OF_KIND[first][name].replace("KIND", first).replace("uWIDTH", f"uint{_WIDTHS[first]}")
        return text.replace("WIDTH", str(_WIDTHS[first])), result
    if name in ("convert_element_type", "bitcast_convert_type"):
        return (_conversion if name == "convert_element_type" else _same_bits)(first, kind_of(params["new_dtype"]))
    if name == "select_n":
        last = f"{{{len(kinds) - 1}}}"
        return "".join(f"{{0}} <= {i} ? {{{i + 1}}} : " for i in range(len(kinds) - 2)) + last, kinds[1]
    if name == "integer_pow" and first in REALS:
        return _whole_power(params["y"]), first
    if name == "polynomial" and first in REALS:
        return _horner(len(kinds) - 1), first
    if name == "round" and first in REALS:
        return ROUNDINGS[int(params["rounding_method"])], first
    function = _function(name, first, params.get("accuracy")) if first in REALS and set(kinds) == {first} else None
    return (f"{function}({', '.join(f'{{{i}}}' for i in range(len(kinds)))})", first) if function else None


def _function(name: str, kind: str, accuracy: Any) -> str | None:
    """Return the C++ function of an operation, for the accuracy that was asked for, or None."""
    if accuracy is None and name in OURS:
        return f"motes::{name}"
    known = name in OF_C or (name in OURS and name not in _OURS_ALONE)
    return _of_c(name, kind) if known and accuracy in (None, jax.lax.AccuracyMode.HIGHEST) else None


def _conversion(before: str, after: str) -> tuple[str, str]:
    if before in REALS and after.startswith("uint"):
        raise Untranslatable(f"a {before} made an unsigned whole number")
    if before in REALS and after.startswith("int"):
        return f"motes::to_whole<{after}>({{0}})", after
    if before == "bool" and after != "bool":  # g++ does not vectorize the conversion of a truth that was worked out
        return f"{{0}} ? ({after})1 : ({after})0", after
    return ("{0} != 0" if after == "bool" else f"({after}){{0}}"), after


def _same_bits(before: str, after: str) -> tuple[str, str]:
    if "bool" in (before, after):
        raise Untranslatable("the bits of a truth value")
    if _WIDTHS[before] != _WIDTHS[after]:
        raise Untranslatable(f"the bits of a {before} as those of several numbers, or of several as one")
    return f"motes::bits<{after}>({{0}})", after


def _horner(count: int) -> str:
    """Write a polynomial in the first operand, whose coefficients follow from the lowest power up."""
    text = f"{{{count}}}"
    for i in range(count - 1, 0, -1):
        text = f"motes::fma({text}, {{0}}, {{{i}}})"
    return text


def _whole_power(power: int) -> str:
    if power == 0:
        return "1"
    product = " * ".join(["{0}"] * abs(power))
    return product if power > 0 else f"1 / ({product})"


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
