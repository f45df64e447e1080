"""What every law answers, and what a foreign distribution is turned into."""

from abc import ABC, abstractmethod
from typing import Any, Self

import jax
import jax.numpy as jnp

from motes.core.checks import refuse
from motes.core.record import record, static


class Law(ABC):
    """A probability law of a vector of x components."""

    independent: bool = False
    """Whether the components are independent, so that missing ones can be left out."""

    @abstractmethod
    def mean(self) -> jax.Array:
        """Mean, `(x,)`."""

    @abstractmethod
    def cov(self) -> jax.Array:
        """Covariance, `(x, x)`."""

    @abstractmethod
    def sample(self, key: jax.Array, n: int) -> jax.Array:
        """Draw n points, `(x, n)`."""

    def log_prob(self, value: jax.Array) -> jax.Array:
        """Log density at points `(x, *n)`, as `(*n)`."""
        refuse(type(self).__name__, "a law with a density", "one that can only be sampled", "Give it a log_prob.")

    def gathered(self, angles: tuple[int, ...]) -> Self:
        """Return the law with what it averages on one branch of the states named, which are angles; see `laws/circular.py`.

        Laws that average nothing, such as one Gaussian, are as they were.
        """
        return self


@record
class Foreign(Law):
    """A distribution object of another library, such as numpyro's: anything with `sample(key, shape)` and `log_prob(x)`.

    Attributes:
        distribution: the object; its components lie along its batch or event axis.
        size: number of components.
    """

    distribution: Any = static()
    size: int = static()

    @property
    def independent(self) -> bool:  # type: ignore[override]
        """Components on a batch axis are independent; an event axis makes a joint density."""
        return not getattr(self.distribution, "event_shape", ()) or self.size == 1

    def mean(self) -> jax.Array:
        """Mean, `(x,)`."""
        return jnp.broadcast_to(jnp.asarray(self.distribution.mean), (self.size,))

    def cov(self) -> jax.Array:
        """Covariance, `(x, x)`."""
        if hasattr(self.distribution, "covariance_matrix"):
            return jnp.asarray(self.distribution.covariance_matrix)
        return jnp.diag(jnp.broadcast_to(jnp.asarray(self.distribution.variance), (self.size,)))

    def sample(self, key: jax.Array, n: int) -> jax.Array:
        """Draw n points, `(x, n)`."""
        own = tuple(getattr(self.distribution, "batch_shape", ())) + tuple(getattr(self.distribution, "event_shape", ()))
        drawn = self.distribution.sample(key, (n,) if own else (n, self.size))
        return jnp.reshape(drawn, (n, self.size)).T

    def log_prob(self, value: jax.Array) -> jax.Array:
        """Log density; NaN components are left out where the components are independent."""
        points = jnp.moveaxis(value, 0, -1)
        if not self.independent:
            return self.distribution.log_prob(points)
        missing = jnp.isnan(points)
        each = self.distribution.log_prob(jnp.where(missing, self.mean().astype(points.dtype), points))
        each = jnp.reshape(each, points.shape)
        return jnp.sum(jnp.where(missing, 0, each), axis=-1)


def drawn(law: Law) -> jax.ShapeDtypeStruct:
    """Shape and type of one draw, `(x, 1)`, found without drawing."""
    center = getattr(law, "center", None)
    if center is not None:
        return jax.ShapeDtypeStruct((center.shape[0], 1), center.dtype)
    return jax.eval_shape(lambda law: law.sample(jax.random.key(0), 1), law)


def as_law(argument: str, value: Any, size: int | None = None) -> Law:
    """Return a law, wrapping a foreign distribution.

    Raises:
        MotesError: the value has neither the methods of a law nor those of a distribution.
    """
    if isinstance(value, Law):
        return value
    if hasattr(value, "sample") and hasattr(value, "log_prob"):
        if size is None:
            shape = tuple(getattr(value, "batch_shape", ())) + tuple(getattr(value, "event_shape", ()))
            size = shape[-1] if shape else 1
        return Foreign(value, size)
    refuse(argument, "a law, or an object with sample(key, shape) and log_prob(x)", type(value).__name__)
