"""The public choice of the engine."""

from contextlib import AbstractContextManager

from motes.core.engine import using
from motes.native import blocks as blocks  # its kernels offer themselves


def engine(name: str) -> AbstractContextManager[None]:
    """Choose the engine for the calls inside a `with` block: `with mo.engine("native"): mo.run(...)`.

    Results of the two engines agree up to rounding; random numbers are the same. What the native engine cannot do (no compiler, a function
    that it cannot translate, float64, an accelerator) is done by JAX; `mo.explain` says what runs and why. The environment variable
    MOTES_ENGINE chooses for a whole process.

    Args:
        name: "jax" (the default) or "native": C++ kernels, compiled for the model and the processor.

    Raises:
        MotesError: there is no such engine.
    """
    return using(name)
