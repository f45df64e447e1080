"""Noises with independent components that are not Gaussian; missing components are left out of their densities."""

from abc import abstractmethod

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike

from motes.core import checks, random
from motes.core.record import record
from motes.laws.law import Law


class IndependentNoise(Law):
    """A zero-centered or box-shaped law whose x components are independent; subclasses give one component at a time."""

    independent = True

    @abstractmethod
    def variances(self) -> jax.Array:
        """Variance of each component, `(x,)`."""

    @abstractmethod
    def log_prob_each(self, value: jax.Array) -> jax.Array:
        """Log density of each component at `(x, *n)`, same shape; each row belongs to one component."""

    def mean(self) -> jax.Array:
        """Mean, `(x,)`."""
        return jnp.zeros_like(self.variances())

    def cov(self) -> jax.Array:
        """Covariance, `(x, x)`, diagonal."""
        return jnp.diag(self.variances())

    def log_prob(self, value: jax.Array) -> jax.Array:
        """Log density at `(x,)` or `(x, n)`; NaN components are left out."""
        checks.shape(f"value given to {type(self).__name__}", value, (self.variances().shape[0], *value.shape[1:]))
        missing = jnp.isnan(value)
        each = self.log_prob_each(jnp.where(missing, 0, value))
        return jnp.sum(jnp.where(missing, 0, each), axis=0)


def _scales(argument: str, scale: ArrayLike) -> jax.Array:
    value = jnp.atleast_1d(checks.as_float(argument, scale))
    if checks.is_concrete(value) and not bool((value > 0).all()):
        checks.refuse(argument, "positive scales, one per component", np.asarray(value).tolist())
    return value


def _per_component(row: jax.Array, like: jax.Array) -> jax.Array:
    return row.reshape(-1, *([1] * (like.ndim - 1)))


@record
class StudentT(IndependentNoise):
    """Student's t noise.

    Attributes:
        scale: scale of each component, `(x,)`, in the units of the component.
        df: degrees of freedom, a number; the variance is finite above 2.
    """

    scale: jax.Array
    df: jax.Array

    def __init__(self, scale: ArrayLike, df: float):
        """Check that scales and degrees of freedom are positive."""
        object.__setattr__(self, "scale", _scales("StudentT scale", scale))
        freedom = _scales("StudentT df", jnp.asarray(df, self.scale.dtype))
        checks.shape("StudentT df", freedom, (1,), "(one number for all components)")
        object.__setattr__(self, "df", freedom[0])

    def variances(self) -> jax.Array:
        """Variance of each component; infinite for 2 degrees of freedom or fewer."""
        return jnp.where(self.df > 2, self.scale**2 * self.df / jnp.where(self.df > 2, self.df - 2, 1), jnp.inf)

    def sample(self, key: jax.Array, n: int) -> jax.Array:
        """Draw n points, `(x, n)`: a normal number over the root of a gamma number."""
        noise = random.normal(random.child(key, 0), (self.scale.shape[0], n), self.scale.dtype)
        gamma = jax.random.gamma(random.child(key, 1), self.df / 2, (self.scale.shape[0], n), self.scale.dtype)
        return self.scale[:, None] * noise * jnp.sqrt(self.df / 2 / gamma)

    def log_prob_each(self, value: jax.Array) -> jax.Array:
        """Log density of each component."""
        scale = _per_component(self.scale, value)
        half = (self.df + 1) / 2
        norm = jax.lax.lgamma(half) - jax.lax.lgamma(self.df / 2) - 0.5 * jnp.log(self.df * jnp.pi)
        return norm - jnp.log(scale) - half * jnp.log1p((value / scale) ** 2 / self.df)


@record
class Laplace(IndependentNoise):
    """Laplace noise.

    Attributes:
        scale: mean absolute value of each component, `(x,)`.
    """

    scale: jax.Array

    def __init__(self, scale: ArrayLike):
        """Check that scales are positive."""
        object.__setattr__(self, "scale", _scales("Laplace scale", scale))

    def variances(self) -> jax.Array:
        """Variance of each component."""
        return 2 * self.scale**2

    def sample(self, key: jax.Array, n: int) -> jax.Array:
        """Draw n points, `(x, n)`, by inversion."""
        u = random.uniform(key, (self.scale.shape[0], n), self.scale.dtype) - 0.5
        return -self.scale[:, None] * jnp.sign(u) * jnp.log1p(-2 * jnp.abs(u))

    def log_prob_each(self, value: jax.Array) -> jax.Array:
        """Log density of each component."""
        scale = _per_component(self.scale, value)
        return -jnp.abs(value) / scale - jnp.log(2 * scale)


@record
class Uniform(IndependentNoise):
    """Uniform noise on a box.

    Attributes:
        low: lower ends, `(x,)`.
        high: upper ends, `(x,)`.
    """

    low: jax.Array
    high: jax.Array

    def __init__(self, low: ArrayLike, high: ArrayLike):
        """Check that the box has a volume."""
        lower, upper = (jnp.atleast_1d(checks.as_float(f"Uniform {word}", v)) for word, v in (("low", low), ("high", high)))
        checks.shape("Uniform high", upper, lower.shape, "(as low)")
        _scales("Uniform high - low", upper - lower)
        object.__setattr__(self, "low", lower)
        object.__setattr__(self, "high", upper)

    def mean(self) -> jax.Array:
        """Middle of the box, `(x,)`."""
        return (self.low + self.high) / 2

    def variances(self) -> jax.Array:
        """Variance of each component."""
        return (self.high - self.low) ** 2 / 12

    def sample(self, key: jax.Array, n: int) -> jax.Array:
        """Draw n points, `(x, n)`."""
        u = random.uniform(key, (self.low.shape[0], n), self.low.dtype)
        return self.low[:, None] + (self.high - self.low)[:, None] * u

    def log_prob_each(self, value: jax.Array) -> jax.Array:
        """Log density of each component; minus infinity outside."""
        low, high = _per_component(self.low, value), _per_component(self.high, value)
        return jnp.where((value >= low) & (value <= high), -jnp.log(high - low), -jnp.inf)
