"""What goes wrong in a function of the user's, told in one line: the function, its file and line, and the cure."""

import inspect
import linecache
import random
import re
from collections.abc import Callable
from types import TracebackType
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from motes.core.checks import MotesError, is_concrete

_LIBRARIES = ("jax", "jaxlib", "numpy", "scipy", "motes", "blackjax", "functools", "contextlib", "math")
LONGEST_LINE, LONGEST_FILE = 80, 100
TRIES = 8
"""Times that a function is traced to see whether it always is the same program: a coin falls equally 8 times in a row once in 128."""


def called(role: str, function: Callable[..., Any], *args: Any) -> Any:
    """Call a function of the user's.

    Args:
        role: what it is, with its arguments, such as "dynamics f(x, u, t)".
        function: the function.
        args: its arguments.

    Raises:
        MotesError: it fails, returns nothing, or draws random numbers, which would be drawn once and be constants from then on.
    """
    generators = _generators(function)
    before = _states(generators)
    try:
        found = function(*args)
        draws = _states(generators) != before and _is_another_each_time(function, args)
    except MotesError:
        raise
    except Exception as reason:
        raise MotesError(_message(role, function, args, reason)) from None
    if draws:
        raise MotesError(f"{role}: expected a function without random numbers of its own, got {_source_of(function)}, which draws some: "
                         "once, while it is traced, for all steps. Give noise as a law, or Custom(sample=...), which has a key.")
    if found is None:
        raise MotesError(f"{role}: expected a result, got None from {_source_of(function)}. Does it end in return?")
    return found


def _is_another_each_time(function: Callable[..., Any], args: tuple[Any, ...]) -> bool:
    """Tell whether a function is another program each time it is traced: other threads may have drawn from its generators meanwhile."""
    try:
        programs = [_program(function, args) for _ in range(TRIES)]
    except Exception:
        # it is called with what is known, and will be asked again once it is traced
        return False
    return any(program != programs[0] for program in programs)


def _program(function: Callable[..., Any], args: tuple[Any, ...]) -> tuple[str, list[bytes]]:
    """Return a function as a traced program, and the constants of that."""
    def numbers(*args: Any) -> list[Any]:
        return [leaf for leaf in jax.tree.leaves(function(*args)) if isinstance(leaf, (jax.Array, np.ndarray, np.generic, int, float))]

    program = jax.make_jaxpr(numbers)(*args)
    known = [one for one in getattr(program, "consts", ()) if is_concrete(one)]
    numeric = [np.asarray(one) for one in known if not jnp.issubdtype(one.dtype, jax.dtypes.prng_key)]
    return re.sub(" at 0x[0-9a-f]+", "", str(program)), [one.tobytes() for one in numeric]


def _generators(function: Any) -> list[Any]:
    """Return the generators of NumPy and of Python that a function names, beside those that all share."""
    try:
        read = inspect.getclosurevars(_innermost(function))
    except (TypeError, ValueError):
        return []
    kinds = (np.random.Generator, np.random.RandomState, random.Random)
    return [one for one in (*read.nonlocals.values(), *read.globals.values()) if isinstance(one, kinds)]


def _states(generators: list[Any]) -> list[str]:
    """Return the states of generators, and of those that all share."""
    everyones, shared = random.getstate(), np.random.get_state(legacy=False)  # noqa: NPY002 (is what a user may draw from)
    own = [one.bit_generator.state if isinstance(one, np.random.Generator) else
           one.getstate() if isinstance(one, random.Random) else one.get_state(legacy=False) for one in generators]  # fmt: skip
    return [repr(one) for one in (shared["state"]["pos"], shared["has_gauss"], everyones[1][-1], everyones[2], *own)]


def _message(role: str, function: Any, args: tuple[Any, ...], reason: Exception) -> str:
    given = _does_not_take(function, args)
    if given:
        hint = "It must take all of them; those that it does not need may stay unused."
        return f"{role}: expected a function of {len(args)} arguments, got {given} at {_source_of(function)}. {hint}"
    where, source = _frame(reason.__traceback__) or (_source_of(function), "")
    first = (str(reason).strip().splitlines() or [""])[0]
    shown = f' ("{source[:LONGEST_LINE]}")' if source else ""
    message = f"{role}: expected a function that JAX can trace, got {type(reason).__name__} at {where}{shown}: {first[:120]}"
    cure = _cure(reason, source, args)
    return f"{message.rstrip('.')}. {cure}" if cure else message


def _does_not_take(function: Any, args: tuple[Any, ...]) -> str:
    """Return name and arguments of a function that cannot be called with so many."""
    try:
        signature = inspect.signature(function)
        signature.bind(*args)
    except ValueError:
        return ""
    except TypeError:
        return f"{getattr(function, '__name__', type(function).__name__)}{signature}"  # type: ignore[possibly-undefined]
    return ""


def _frame(trace: TracebackType | None) -> tuple[str, str] | None:
    """Return where the last line of the user's was, and that line."""
    found = None
    while trace is not None:
        frame = trace.tb_frame
        module = str(frame.f_globals.get("__name__", ""))
        if module.partition(".")[0] not in _LIBRARIES or module.startswith("motes.applications"):
            name, code, line = frame.f_code.co_name, frame.f_code, trace.tb_lineno
            found = f"{name}, {_file(code.co_filename)}, line {line}", linecache.getline(code.co_filename, line, frame.f_globals).strip()
        trace = trace.tb_next
    return found


def _source_of(function: Any) -> str:
    """Return where a function is written."""
    function = _innermost(function)
    code = getattr(function, "__code__", None) or getattr(vars(type(function)).get("__call__"), "__code__", None)
    name = getattr(function, "__name__", type(function).__name__)
    return name if code is None else f"{name}, {_file(code.co_filename)}, line {code.co_firstlineno}"


def _innermost(function: Any) -> Any:
    """Return what was written, without what was put around it."""
    while hasattr(function, "func") or hasattr(function, "__wrapped__"):
        function = function.func if hasattr(function, "func") else function.__wrapped__
    return function


def _file(name: str) -> str:
    return name if len(name) <= LONGEST_FILE else "..." + name[3 - LONGEST_FILE :]


def _cure(reason: Exception, source: str, args: tuple[Any, ...]) -> str:
    """Return what to write instead, as far as it is known."""
    errors = jax.errors
    foreign = re.search(r"\b(?:math|np|numpy|cmath)\.((?:linalg\.)?\w+)", source)
    if isinstance(reason, errors.TracerBoolConversionError):
        return "States are not known while it is traced: write jnp.where(condition, a, b) for `if`, jnp.minimum for min, & for `and`."
    if isinstance(reason, (errors.TracerArrayConversionError, errors.ConcretizationTypeError)) and foreign:
        return f"Write jnp.{foreign[1]} for {foreign[0]}."
    if isinstance(reason, errors.TracerIntegerConversionError):
        return "Write jnp.asarray(table)[i] where i comes from states, inputs or t."
    if isinstance(reason, errors.NonConcreteBooleanIndexError):
        return "Write jnp.where(mask, a, b) for an index by a mask."
    if isinstance(reason, (errors.TracerArrayConversionError, errors.ConcretizationTypeError)):
        return "States are not known while a function is traced: write jnp functions for those of math and NumPy, and no float() or int()."
    if "NoneType" in str(reason) and any(arg is None for arg in args):
        return "It reads inputs, and there are none: give inputs=."
    if isinstance(reason, TypeError) and "immutable" in str(reason):
        return "Write x = x.at[i].set(value) for x[i] = value."
    return ""
