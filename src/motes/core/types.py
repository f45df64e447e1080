"""Shape words used everywhere: `n` particles, `x` state, `y` measurement, `t` time steps, `k` Kalman part, `p` particle part.

Arrays of particles have the particle axis last. A trailing `*n` means: one for all, or one per particle.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, Protocol

import jax
from jax.typing import ArrayLike

KeyLike = jax.Array | int
"""A JAX key, or an integer seed."""
Inputs = Any
"""What the user gives per step: any tree of arrays with the time axis first, or None."""


class Numbers(Protocol):
    """A table or series of another library, which NumPy can make an array of."""

    def __array__(self) -> Any:
        """Return it as an array."""


Measurements = ArrayLike | Sequence[Any] | Mapping[Any, Any] | Iterator[Any] | Numbers
"""Measurements of a run `(t, y)`: an array, a masked one, nested sequences in which None and NA stand for what is missing, a table or
series, those of several sensors by name, or an iterator of them."""

UserFunction = Callable[..., Any]
"""`f(x, u, t)`: one state `(x,)`, the inputs of the step, the step index; never batched. Of a model that modes share the mode, too."""

MatrixLike = ArrayLike | Sequence[Sequence[Any]] | UserFunction
"""A matrix, or a user function that returns one."""
