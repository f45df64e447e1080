"""Gaussians through conditionals, by slopes at the mean: exact where the conditional is linear, extended-Kalman elsewhere."""

from typing import Any

import jax
import jax.numpy as jnp

from motes.core import linalg
from motes.laws.conditional import AdditiveGaussian, Conditional, LinearGaussian, matrix
from motes.laws.gaussian import Correction, Gaussian


def affine(part: Conditional, x: jax.Array, u: Any, t: Any) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Return the value at x `(z,)`, the slope `(z, x)` and the noise covariance `(z, z)`; exact where the conditional is linear."""
    if isinstance(part, LinearGaussian) and not callable(part.A):  # a function may depend on x, and then has a slope of its own
        slope = matrix(part.A, x, u, t)
        return slope @ x, slope, part.cov(x, u, t)
    return part.mean(x, u, t), jax.jacfwd(lambda x: part.mean(x, u, t))(x), part.cov(x, u, t)


def moved(dynamics: Conditional, law: Gaussian, u: Any, t: Any) -> Gaussian:
    """Move a Gaussian to time t: the mean through the dynamics, the covariance through their slope at the mean, plus noise."""
    center, slope, noise = affine(dynamics, law.center, u, t)
    return Gaussian(center, linalg.sandwich(slope, law.covariance) + noise)


def measured(sensor: Conditional, law: Gaussian, y: jax.Array, u: Any, t: Any) -> Correction:
    """Condition a Gaussian on a measurement `(y,)` through the sensor's slope at the mean; NaN means not measured."""
    prediction, slope, noise = affine(sensor, law.center, u, t)
    return law.corrected(sensor.residual(y, prediction), slope, noise, ~jnp.isnan(y))


def has_moments(part: Conditional) -> bool:
    """Tell whether a conditional has a mean function and a covariance."""
    return isinstance(part, AdditiveGaussian) or hasattr(part, "law")
