"""What is in force in the thread that asks, and must be in the one that works."""

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from typing import Any

import jax

from motes.core import devices, engine

Settings = tuple[tuple[str, Any], ...]
JAX = ("enable_x64", "default_matmul_precision", "numpy_dtype_promotion", "numpy_rank_promotion", "default_prng_impl", "debug_nans",
       "debug_infs", "disable_jit", "default_device")  # fmt: skip
"""Settings of JAX that a `with` block can change for its thread; each is a context manager of the module."""

OURS = {"engine": engine.using, "devices": devices.devices}
"""Settings of ours."""


def in_force() -> Settings:
    """Return the settings of this thread."""
    return (("engine", engine.chosen()), ("devices", devices.chosen()), *((name, getattr(jax.config, f"jax_{name}")) for name in JAX))


def for_another_process(settings: Settings) -> Settings:
    """Return the settings that can travel: all but the devices, which are this process's."""
    return tuple((name, value) for name, value in settings if name not in ("default_device", "devices"))


@contextmanager
def enforced(settings: Settings) -> Iterator[None]:
    """Have settings in force in a `with` block."""
    with ExitStack() as stack:
        here = dict(in_force())
        for name, value in settings:
            # a setting that is entered anew is another to JAX's caches
            if value != here[name]:
                stack.enter_context(OURS[name](value) if name in OURS else getattr(jax, name)(value))
        yield
