"""Shape words used everywhere: `n` particles, `x` state, `y` measurement, `t` time steps, `k` Kalman part, `p` particle part.

Arrays of particles have the particle axis last. A trailing `*n` means: one for all, or one per particle.
"""

from collections.abc import Callable
from typing import Any

import jax
from jaxtyping import Array, Float, Key

KeyLike = Key[Array, ""] | int
LogWeights = Float[Array, " n"]
Scalar = Float[Array, ""]
Inputs = Any
"""What the user gives per step: any tree of arrays with the time axis first, or None."""

UserFunction = Callable[[jax.Array, Any, Any], Any]
"""`f(x, u, t)`: one state `(x,)`, the inputs of the step, the step index; never batched."""

MatrixLike = jax.Array | UserFunction
"""A matrix, or a user function that returns one."""
