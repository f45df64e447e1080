"""The public choice of the engine."""

from contextlib import AbstractContextManager

from motes.core.engine import using
from motes.native import blocks as blocks  # its kernels offer themselves


def engine(name: str) -> AbstractContextManager[None]:
    """Choose the engine for the calls inside a `with` block: `with mo.engine("jax"): mo.run(...)`.

    Nothing need be chosen. Results of JAX and of the native kernels agree up to rounding; random numbers are the same. What native kernels
    cannot do (no compiler, a function that cannot be translated, an accelerator) is done by JAX; `mo.explain` says what runs and why. The
    environment variable MOTES_ENGINE chooses for a whole process.

    Args:
        name: "auto" (the default): C++ kernels, compiled for the model and the processor, where they can do the work and there are so
            many particles that it pays, else JAX; "jax": JAX alone; "native": kernels for few particles too, with a warning where they
            cannot do the work.

    Raises:
        MotesError: there is no such engine.
    """
    return using(name)
