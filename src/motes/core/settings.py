"""What is in force in the thread that asks, and must be in the one that works."""

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from typing import Any

import jax

from motes.core import engine

Settings = tuple[tuple[str, Any], ...]
JAX = ("enable_x64", "default_matmul_precision", "numpy_dtype_promotion", "numpy_rank_promotion", "default_prng_impl", "debug_nans",
       "debug_infs", "disable_jit", "default_device")  # fmt: skip
"""Settings of JAX that a `with` block can change for its thread; each is a context manager of the module."""


def in_force() -> Settings:
    """Return the settings of this thread."""
    return (("engine", engine.chosen()), *((name, getattr(jax.config, f"jax_{name}")) for name in JAX))


def for_another_process(settings: Settings) -> Settings:
    """Return the settings that can travel: all but the device, which is this process's."""
    return tuple((name, value) for name, value in settings if name != "default_device")


@contextmanager
def enforced(settings: Settings) -> Iterator[None]:
    """Have settings in force in a `with` block."""
    with ExitStack() as stack:
        here = dict(in_force())
        for name, value in settings:
            # a setting that is entered anew is another to JAX's caches
            if value != here[name]:
                stack.enter_context(engine.using(value) if name == "engine" else getattr(jax, name)(value))
        yield
