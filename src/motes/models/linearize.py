"""Affine approximations of conditionals at a state."""

from typing import Any

import jax

from motes.laws.conditional import AdditiveGaussian, Conditional, LinearGaussian, matrix


def affine(part: Conditional, x: jax.Array, u: Any, t: Any) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Return the value at x `(z,)`, the slope `(z, x)` and the noise covariance `(z, z)`; exact where the conditional is linear."""
    if isinstance(part, LinearGaussian):
        slope = matrix(part.A, x, u, t)
        return slope @ x, slope, part.cov(x, u, t)
    return part.mean(x, u, t), jax.jacfwd(lambda x: part.mean(x, u, t))(x), part.cov(x, u, t)


def has_moments(part: Conditional) -> bool:
    """Tell whether a conditional has a mean function and a covariance."""
    return isinstance(part, AdditiveGaussian) or hasattr(part, "law")
