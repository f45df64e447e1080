"""How weights fall with costs in cost-reference particle filters (Miguez, Bugallo, Djuric 2004): a value apart from the filter."""

from abc import ABC, abstractmethod

import jax
import jax.numpy as jnp

from motes.core import checks
from motes.core.record import record


class Falling(ABC):
    """A weight that falls with the cost."""

    @abstractmethod
    def log_mass(self, costs: jax.Array, least: jax.Array) -> jax.Array:
        """Log of the weight, not normalized, `(n,)`, of costs `(n,)` above the least `()`."""


@record
class InverseCost(Falling):
    """1 / C: nearly flat where costs are large and nearly equal."""

    def log_mass(self, costs: jax.Array, least: jax.Array) -> jax.Array:
        """See `Falling`."""
        return -jnp.log(jnp.maximum(costs + least, jnp.finfo(costs.dtype).tiny))


@record
class InverseExcess(Falling):
    """1 / (C - min C + delta)^beta: looks at differences alone.

    Attributes:
        delta: in units of the cost, above 0; particles this close to the best one count nearly as much. What the noise of one
            measurement costs is a good value; far less leaves one particle with nearly all the weight.
        beta: power, above 0.
    """

    delta: float = 0.01
    beta: float = 2.0

    def __post_init__(self) -> None:
        """Refuse numbers that are not positive."""
        checks.above_zero("InverseExcess delta", self.delta)
        checks.above_zero("InverseExcess beta", self.beta)

    def log_mass(self, costs: jax.Array, least: jax.Array) -> jax.Array:
        """See `Falling`."""
        return -self.beta * jnp.log(costs + self.delta)
