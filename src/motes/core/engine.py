"""Which engine works the numbers out: XLA alone, or native kernels where they can, or where they can and it pays.

An operation is defined where it belongs, in JAX, and marked `replaceable`. The native room, higher up, offers faster implementations of
the marked operations; they are used unless JAX is chosen, and return None for what they cannot do, or where it does not pay.
"""

import os
from collections.abc import Callable
from contextlib import AbstractContextManager
from functools import wraps
from typing import Any, TypeVar, cast

import jax

from motes.core import checks

ENGINES = ("auto", "jax", "native")
VARIABLE = "MOTES_ENGINE"

# part of the key of everything that JAX compiles: functions that a user jitted are traced anew under another engine
_context = jax.make_user_context(None)
_faster: dict[str, Callable[..., Any]] = {}

_of_elements = jax.make_user_context(False)

F = TypeVar("F", bound=Callable[..., Any])


class CompileError(checks.MotesError):
    """The compiler of native kernels is missing, or it failed; the text says which."""


def chosen() -> str:
    """Return the engine in force: that of the nearest `using`, else of the environment variable MOTES_ENGINE, else "auto".

    Raises:
        MotesError: the variable names no engine.
    """
    if _context.value is not None:
        return _context.value
    name = os.environ.get(VARIABLE) or "auto"
    checks.option(VARIABLE, name, ENGINES)
    return name


def accelerated() -> bool:
    """Tell whether JAX works on an accelerator, whose libraries are slow over thin products, and whose sums run in trees."""
    return jax.default_backend() != "cpu"


def using(name: str) -> AbstractContextManager[None]:
    """Choose an engine for what is called inside a `with` block.

    Raises:
        MotesError: there is no such engine.
    """
    checks.option("engine", name, ENGINES)
    return _context(name)


def of_elements() -> bool:
    """Tell whether what is traced is worked out for all elements of a cloud at once (see `laws/elements.py`)."""
    return _of_elements.value


def for_elements() -> AbstractContextManager[None]:
    """Trace what is inside a `with` block for all elements of a cloud at once."""
    return _of_elements(True)


def replaceable(operation: F) -> F:
    """Mark an operation that an engine may offer a faster implementation of."""

    @wraps(operation)
    def call(*args: Any) -> Any:
        faster = _faster.get(operation.__name__) if chosen() != "jax" else None
        result = None if faster is None else faster(*args)
        return operation(*args) if result is None else result

    return cast(F, call)


def offer(name: str, implementation: Callable[..., Any]) -> None:
    """Offer a faster implementation of a replaceable operation; it returns None for arguments that it cannot take."""
    _faster[name] = implementation


def original(operation: F) -> F:
    """Return the operation in JAX, whatever engine is chosen."""
    return operation.__wrapped__  # type: ignore[attr-defined]
