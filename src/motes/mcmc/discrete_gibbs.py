"""The Gibbs sampler for coordinates that have a few values each, from the log density alone (Geman, Geman 1984).

1. Take the coordinates in turn.
2. Ask the log density at each value that a coordinate can have, all others as they are, and draw one in proportion to the density.
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree

from motes.core import checks, random
from motes.core.record import record, static
from motes.laws.switching import pick_each
from motes.mcmc.interface import Info, Kernel, LogDensity, Position, State


@record
class DiscreteGibbs(Kernel):
    """Draws each coordinate of a position from its law given all others, of which the values that it can have are known.

    Two values that hold each other fast (both would have to change at once) let the chain stick: see `ParallelTempering`.

    Source: Geman, Geman 1984, Stochastic relaxation, Gibbs distributions, and the Bayesian restoration of images.

    Example:
        >>> kernel = mo.mcmc.DiscreteGibbs((-1, 1))
        >>> coupled = lambda spins: 0.4 * jnp.sum(spins[1:] * spins[:-1])
        >>> chains = mo.sample(0, kernel, coupled, jnp.ones(10))
        >>> chains.positions.shape
        (4, 1000, 10)

    Attributes:
        values: what each coordinate can be, at least two numbers. Coordinates with others are moved by a `Block` of their own.
    """

    values: tuple[float, ...] = static()

    def __post_init__(self) -> None:
        """Check the values.

        Raises:
            MotesError: they are not two or more different numbers.
        """
        values = np.asarray(checks.as_numbers("DiscreteGibbs values", self.values), float)
        if values.ndim != 1 or values.size < 2 or np.unique(values).size < values.size or not np.isfinite(values).all():
            checks.refuse("DiscreteGibbs values", "two or more different numbers", self.values)
        object.__setattr__(self, "values", tuple(values.tolist()))

    def check(self, key: jax.Array, log_density: LogDensity, position: Position) -> None:
        """Ask for a position whose coordinates have these values."""
        for leaf in jax.tree.leaves(position):
            found = np.asarray(leaf)
            held = np.asarray(self.values).astype(found.dtype)
            if not np.isin(found, held).all() or not np.array_equal(held, np.asarray(self.values, np.float32)):
                checks.refuse("DiscreteGibbs position", f"coordinates that are one of {self.values}", found.tolist())

    def step(self, key: jax.Array, log_density: LogDensity, state: State, t: Any) -> tuple[State, Info]:
        """Draw all coordinates in turn; what counts as accepted is the mean probability of a change."""
        x, rebuild = ravel_pytree(state.position)
        values = jnp.asarray(self.values, x.dtype)

        def drawn(held: tuple[jax.Array, jax.Array], given: tuple[jax.Array, jax.Array]) -> Any:
            x, found = held
            place, u = given
            # 2. the law of a coordinate given all others; the density at the value that it has is known
            own = jnp.argmin(jnp.abs(values - x[place]))
            each = jnp.roll(values, -own)
            densities = jnp.append(found, jax.vmap(lambda value: log_density(rebuild(x.at[place].set(value))))(each[1:]))
            invalid = jnp.isnan(densities) | (densities == jnp.inf)
            weights = jax.nn.softmax(jnp.where(invalid, -jnp.inf, densities))
            chosen = pick_each(weights, u)
            return (x.at[place].set(each[chosen]), densities[chosen]), (1 - weights[0], jnp.sum(invalid, dtype=jnp.int32))

        # 1. in turn
        u = random.uniform(key, x.shape, state.log_density.dtype)
        (x, found), (leaves, invalid) = jax.lax.scan(drawn, (x, state.log_density), (jnp.arange(x.shape[0]), u))
        return State(rebuild(x), found, state.kernel_state), Info(jnp.ones(1), jnp.mean(leaves)[None], jnp.sum(invalid)[None])
