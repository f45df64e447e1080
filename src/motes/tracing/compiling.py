"""How what is jitted here is compiled: by JAX alone where a native kernel could not be, and so that XLA does not stop for good.

Options make it rare that decompositions in a user's functions stop it.

Why they can is told in `lapack.py`, through which ours go. Operations are run at the same time where many of a loop's body are ready at
once, which the scheduler that orders them for concurrency sees to; the other one, which orders them for little memory, leaves few. Programs
of few numbers are kept to one thread, since to hand an operation over takes longer than to do it.
"""

import functools
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any

import jax

from motes.core import checks, engine
from motes.core.lapack import MENDED
from motes.tracing.internals import at_top

OPTIONS: dict[str, Any] = {"xla_cpu_enable_concurrency_optimized_scheduler": False}
ONE_THREAD: dict[str, Any] = {"xla_cpu_multi_thread_eigen": False}


def jitted(function: Callable[..., Any], few: Callable[..., bool] = lambda *arguments: False, **static: Any) -> Any:
    """Do as `jax.jit` does, compiled with care where nobody else compiles it.

    Options are for whole programs: inside another's `jit`, `vmap` or `grad` they are refused, and those of the outer program hold.

    Args:
        function: what to jit.
        few: tells of arguments whether they make a program of few numbers.
        static: static arguments, as `jax.jit` takes them.
    """
    return _Jitted(function, few, static)


class _Jitted:
    def __init__(self, function: Callable[..., Any], few: Callable[..., bool], static: dict[str, Any]):
        self._few, self._within = few, jax.jit(function, **static)
        self._alone, self._of_few = (jax.jit(function, **static, compiler_options=options) for options in (OPTIONS, OPTIONS | ONE_THREAD))
        functools.update_wrapper(self, function)

    def __call__(self, *arguments: Any, **named: Any) -> Any:
        if not at_top():
            return self._within(*arguments, **named)
        jitted = (self._of_few if self._few(*arguments, **named) else self._alone) if _are_needed() else self._within
        try:
            return jitted(*arguments, **named)
        except engine.CompileError as reason:
            checks.warn(f"a native kernel could not be compiled, and JAX does the work: {reason}.")
            with engine.using("jax"):
                return jitted(*arguments, **named)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._alone if _are_needed() else self._within, name)


_shared: ContextVar[dict[Any, Any] | None] = ContextVar("shared", default=None)


@contextmanager
def sharing_traces() -> Iterator[None]:
    """Trace functions under `traced_once` once for all places of a program that is traced inside a `with` block."""
    token = _shared.set({})
    try:
        yield
    finally:
        _shared.reset(token)


def traced_once(function: Callable[..., Any]) -> Callable[..., Any]:
    """Return a function of trees of arrays that is traced once for arguments of equal shapes, inside of `sharing_traces`.

    What it does while it is traced, such as leaving notes, it does once, too.
    """
    there = _shared.get()
    if there is None:
        return function
    if function not in there:
        # a function of its own: what JAX keeps of it goes when the program is whole
        there[function] = jax.jit(lambda *arguments: function(*arguments), inline=True)
    return there[function]


@functools.cache
def _are_needed() -> bool:
    """Tell whether it is XLA for CPUs that compiles, one that stops and knows the options."""
    if jax.default_backend() != "cpu" or jax.__version_info__ >= MENDED:
        return False
    try:
        jax.jit(lambda: 0, compiler_options=OPTIONS)()
    except RuntimeError:
        return False
    return True
