"""Which engine works the numbers out: XLA alone, or native kernels where they can.

An operation is defined where it belongs, in JAX, and marked `replaceable`. The native room, higher up, offers faster implementations of
the marked operations; they are used while the native engine is chosen and return None for what they cannot do.
"""

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from functools import wraps
from typing import Any, TypeVar, cast

from motes.core import checks

ENGINES = ("jax", "native")
VARIABLE = "MOTES_ENGINE"

_chosen: ContextVar[str | None] = ContextVar("engine", default=None)
_faster: dict[str, Callable[..., Any]] = {}

F = TypeVar("F", bound=Callable[..., Any])


def chosen() -> str:
    """Return the engine in force: that of the nearest `with engine(...)`, else of the environment variable MOTES_ENGINE, else "jax".

    Raises:
        MotesError: the variable names no engine.
    """
    name = _chosen.get()
    if name is None:
        name = os.environ.get(VARIABLE) or "jax"
        checks.option(VARIABLE, name, ENGINES)
    return name


@contextmanager
def engine(name: str) -> Iterator[None]:
    """Choose the engine for the calls inside a `with` block: `with mo.engine("native"): mo.run(...)`.

    Results of the two engines agree up to rounding; random numbers are the same. What the native engine cannot do (no compiler, a function
    it cannot translate, float64, an accelerator) is done by JAX; `mo.explain` says what runs and why. A function that was jitted outside
    keeps the engine it was traced with.

    Args:
        name: "jax" or "native".

    Raises:
        MotesError: there is no such engine.
    """
    checks.option("engine", name, ENGINES)
    token = _chosen.set(name)
    try:
        yield
    finally:
        _chosen.reset(token)


def replaceable(operation: F) -> F:
    """Mark an operation that an engine may offer a faster implementation of."""

    @wraps(operation)
    def call(*args: Any) -> Any:
        faster = _faster.get(operation.__name__) if chosen() == "native" else None
        result = None if faster is None else faster(*args)
        return operation(*args) if result is None else result

    return cast(F, call)


def offer(name: str, implementation: Callable[..., Any]) -> None:
    """Offer a faster implementation of a replaceable operation; it returns None for arguments that it cannot take."""
    _faster[name] = implementation


def original(operation: F) -> F:
    """Return the operation in JAX, whatever engine is chosen."""
    return operation.__wrapped__  # type: ignore[attr-defined]
