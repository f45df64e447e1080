"""What all particles share: JAX works it out, as part of the program that is being traced or at once, and hands it to the kernel."""

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer

from motes.native.zeros import SMALL, Live, live_after, live_in
from motes.tracing import known
from motes.tracing.internals import worked_out


class LeftToJax:
    """Has JAX work equations out, each once: what is the same has one name in the kernel, and a table is handed over once."""

    def __init__(self) -> None:
        """Start with nothing."""
        self._done: dict[Any, Sequence[Any]] = {}
        self._lives: dict[int, Live] = {}
        self._kept: list[Any] = []

    def __call__(self, eqn: Any, operands: list[Any]) -> Sequence[Any]:
        """Return the results of an equation."""
        alike = _alike(eqn, operands)
        if alike in self._done:
            return self._done[alike]
        results = by_jax(eqn, operands)
        self._kept += [*operands, *results]  # an id is only good as long as its object lives
        if any(isinstance(result, Tracer) for result in results):
            lives = live_after(eqn, operands, [self.live(value) for value in operands])
            self._lives |= {id(result): live for result, live in zip(results, lives, strict=True)}
        if alike is not None:
            self._done[alike] = results
        return results

    def live(self, value: Any) -> Live:
        """Tell which elements of a value can be other than zero."""
        return self._lives.get(id(value)) if isinstance(value, Tracer) else live_in(value)


def _alike(eqn: Any, operands: Sequence[Any]) -> Any:
    """Return what two equations have in common that give the same; None where that cannot be told."""
    small = [isinstance(value, np.ndarray) and value.size <= SMALL for value in operands]
    values = [(value.dtype, value.shape, value.tobytes()) if few else id(value) for value, few in zip(operands, small, strict=True)]
    alike = (eqn.primitive, *eqn.params.items(), *values)
    try:
        hash(alike)
    except TypeError:
        return None
    return None if eqn.effects else alike


def by_jax(eqn: Any, operands: list[Any]) -> Sequence[Any]:
    """Let JAX work out an operation: at once where all is known, else as part of the program that is being traced."""
    if any(isinstance(value, Tracer) for value in operands):
        return worked_out(eqn, operands)
    return [plain(value) for value in known.worked_out(eqn, operands)]


def plain(value: Any) -> Any:
    """Make a known array a NumPy one (keys stay as they are)."""
    if isinstance(value, Tracer) or jnp.issubdtype(value.dtype, jax.dtypes.extended):
        return value
    return np.asarray(value)
