"""Shape words used everywhere: `n` particles, `x` state, `y` measurement, `t` time steps, `k` Kalman part, `p` particle part.

Arrays of particles have the particle axis last. A trailing `*n` means: one for all, or one per particle.
"""

from collections.abc import Callable, Sequence
from typing import Any

import jax
from jax.typing import ArrayLike

KeyLike = jax.Array | int
"""A JAX key, or an integer seed."""
Inputs = Any
"""What the user gives per step: any tree of arrays with the time axis first, or None."""

Measurements = ArrayLike | Sequence[Any]
"""Measurements of a run `(t, y)`: an array, a masked one, or nested sequences in which None and NA stand for what is missing."""

UserFunction = Callable[..., Any]
"""`f(x, u, t)`: one state `(x,)`, the inputs of the step, the step index; never batched. Of a model that modes share the mode, too."""

MatrixLike = ArrayLike | UserFunction
"""A matrix, or a user function that returns one."""
