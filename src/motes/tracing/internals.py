"""What depends on how JAX is made inside: the one file to look at when a new version of JAX comes.

That is the classes of traced programs, the operations that hold programs of their own and where each keeps them, what JAX wraps around
functions of the user's, and whether something is being traced. Nothing else in the library imports `jax._src` or `jax.extend`. How plain
operations are called (`sin`, `dot_general`) is the vocabulary of traced programs, and stands in the rule sets that are about them.
"""

from collections.abc import Callable, Sequence
from pathlib import Path
from types import FunctionType
from typing import Any, NamedTuple

import jax
from jax._src import core  # jax.extend names the same things, and loads what takes a tenth of a start
from jax.interpreters import batching, mlir

Literal, Primitive = core.Literal, core.Primitive

PACKAGE = Path(__file__).parents[1]
PROGRAMS = (core.Jaxpr, getattr(core, "ClosedJaxpr", core.Jaxpr))
"""Classes of traced programs; from JAX 0.11 on they are one."""

JITTED: Any = type(jax.jit(lambda: None))
"""Class of jitted functions."""


def without_constants(program: Any) -> tuple[Any, Sequence[Any]]:
    """Return a traced program without its constants, and them."""
    return getattr(program, "jaxpr", program), getattr(program, "consts", ())


# ---- operations that call one program: they are what that program is ----

CALLS = {
    "jit": "jaxpr", "remat2": "jaxpr", "call": "call_jaxpr", "closed_call": "call_jaxpr", "eval_jaxpr": "call_jaxpr",
    "custom_jvp_call": "call_jaxpr", "custom_vjp_call": "call_jaxpr", "custom_vmap_call": "call",
}  # fmt: skip
"""Their names, and where each keeps its program."""


def called(equation: Any) -> Any:
    """Return the program that an equation calls, or None for other operations."""
    if equation.primitive.name == HIGH:
        return _expanded(equation)
    where = CALLS.get(equation.primitive.name)
    return None if where is None else equation.params[where]


HIGH = "call_hi_primitive"
"""Operations that JAX, from 0.12 on, keeps whole until it compiles (`searchsorted`, `einsum`); each says what it is in plain ones."""


def _expanded(equation: Any) -> Any:
    whole = equation.params["_prim"]
    shapes = (jax.ShapeDtypeStruct(value.aval.shape, value.aval.dtype) for value in equation.invars)
    return jax.make_jaxpr(lambda *args: whole.expand(*jax.tree.unflatten(whole.in_tree, args)))(*shapes)


def has_own_derivative(equation: Any) -> bool:
    """Tell whether the program that an equation calls comes with a rule of the user's for its derivative."""
    name = equation.primitive.name
    return name in ("custom_jvp_call", "custom_vjp_call") or (name == HIGH and type(equation.params["_prim"]).__name__.startswith("Custom"))


def has_own_mapping(equation: Any) -> bool:
    """Tell whether the program that an equation calls comes with a rule for doing it many times (`jax.custom_batching`)."""
    return equation.primitive.name == "custom_vmap_call"


def jitted_name(equation: Any) -> str:
    """Return the name of the jitted function that an equation calls, empty for other operations."""
    return equation.params["name"] if equation.primitive.name == "jit" else ""


# ---- operations that run programs as they see fit ----


class Branches(NamedTuple):
    """One of several programs."""

    index: Any  # which
    programs: Sequence[Any]
    operands: Sequence[Any]


class Scan(NamedTuple):
    """A program for each row of some arrays; it takes `[*consts, *carry, *row]` and gives `[*carry, *row]`."""

    body: Any
    length: int
    reverse: bool
    consts: Sequence[Any]
    carry: Sequence[Any]
    rows: Sequence[Any]


class While(NamedTuple):
    """A program as long as another one gives true; they take `[*consts, *carry]` and `[*tested, *carry]`."""

    body: Any
    test: Any
    consts: Sequence[Any]
    tested: Sequence[Any]
    carry: Sequence[Any]


class Solve(NamedTuple):
    """A program that solves a linear equation, and what its solution depends on beside the right-hand side."""

    program: Any
    operands: Sequence[Any]
    matrices: Sequence[Any]


def control(equation: Any, operands: Sequence[Any]) -> Branches | Scan | While | Solve | None:
    """Take an equation and its operands apart where it branches, loops or solves; None for other operations."""
    form = _CONTROL.get(equation.primitive.name)
    return None if form is None else form(equation.params, operands)


def _branches(params: dict[str, Any], operands: Sequence[Any]) -> Branches:
    return Branches(operands[0], params["branches"], operands[1:])


def _scan(params: dict[str, Any], operands: Sequence[Any]) -> Scan:
    if "ft_in" in params:  # from JAX 0.11 on
        fixed, carried = (len(part) for part in params["ft_in"].unpack()[:2])
    else:
        fixed, carried = params["num_consts"], params["num_carry"]
    parts = operands[:fixed], operands[fixed : fixed + carried], operands[fixed + carried :]
    return Scan(params["jaxpr"], params["length"], params["reverse"], *parts)


def _while(params: dict[str, Any], operands: Sequence[Any]) -> While:
    first = params["cond_nconsts"]
    middle = first + params["body_nconsts"]
    return While(params["body_jaxpr"], params["cond_jaxpr"], operands[first:middle], operands[:first], operands[middle:])


def _solve(params: dict[str, Any], operands: Sequence[Any]) -> Solve:
    lengths = params["const_lengths"]
    start, matrices = lengths.matvec + lengths.vecmat, sum(lengths)
    return Solve(params["jaxprs"].solve, [*operands[start : start + lengths.solve], *operands[matrices:]], operands[:matrices])


_CONTROL = {"cond": _branches, "scan": _scan, "while": _while, "custom_linear_solve": _solve}


def keeps_traces(equation: Any) -> bool:
    """Tell whether JAX keeps the trace of a function of the user's that an equation runs, jitted ones aside."""
    name = equation.primitive.name
    return name in _CONTROL or (name in CALLS and name != "jit")


# ---- what equations hold ----


def worked_out(equation: Any, operands: Sequence[Any]) -> list[Any]:
    """Let JAX work out an equation for given operands."""
    results = equation.primitive.bind(*operands, **equation.primitive.get_bind_params(equation.params))
    return list(results) if equation.primitive.multiple_results else [results]


def parameters(equation: Any) -> dict[str, Any] | None:
    """Return the parameters of an equation, with the user's functions in place of what JAX wraps around them, new at each tracing.

    None where the user's functions cannot be had so: rules of derivatives in reverse, calls back into Python.
    """
    name, params = equation.primitive.name, dict(equation.params)
    if name == "custom_vjp_call" or name.endswith("callback") or (name == HIGH and has_own_derivative(equation)):
        return None
    if name == "custom_jvp_call":
        params["jvp_jaxpr_fun"] = _innermost(params["jvp_jaxpr_fun"])
        return None if params["jvp_jaxpr_fun"] is None else params
    if name == "custom_vmap_call":
        params["rule"] = params["rule"].rule
    return params


def _innermost(wrapped: Any) -> Any:
    """Return the user's function inside a wrapped one, whose closures hold another wrapped one; None where more than that is done to it.

    More than flattening of its arguments is done under `vmap`, or where some of them are no arrays.
    """
    functions, found = [wrapped.f], []
    for function in functions:
        held = [cell.cell_contents for cell in function.__closure__ or ()]
        functions += [value for value in held if isinstance(value, FunctionType) and value not in functions]
        found += [value for value in held if isinstance(value, type(wrapped))]
    return found[0].f if len(found) == 1 and len(found[0].transforms) == 1 else None


def written_at(equation: Any) -> str:
    """Return the file and line of the user's where an equation comes from; empty where it is none of the user's."""
    from jax._src import source_info_util

    innermost = next(iter(source_info_util.user_frames(equation.source_info.traceback)), None)
    if innermost is None or Path(innermost.file_name).is_relative_to(PACKAGE):
        return ""
    return f"{Path(innermost.file_name).name}, line {innermost.start_line}"


def before_compiling(value: Any, action: Callable[..., None], *arguments: Any) -> Any:
    """Return a value of a program, and have something done whenever the program is about to be compiled.

    Args:
        value: array.
        action: what to do; once is enough, and it may raise.
        arguments: what it is called with.
    """
    return _BEFORE.bind(value, action=action, arguments=arguments)


def _lowered(_: Any, value: Any, *, action: Callable[..., None], arguments: Any) -> list[Any]:
    action(*arguments)
    return [value]


def _at_once(value: Any, *, action: Callable[..., None], arguments: Any) -> Any:
    action(*arguments)
    return value


_BEFORE = Primitive("before_compiling")
_BEFORE.def_impl(_at_once)
_BEFORE.def_abstract_eval(lambda value, **_: value)
mlir.register_lowering(_BEFORE, _lowered)
batching.primitive_batchers[_BEFORE] = lambda values, axes, **params: (_BEFORE.bind(*values, **params), *axes)


def at_top() -> bool:
    """Tell whether nothing is being traced."""
    return core.trace_state_clean()
