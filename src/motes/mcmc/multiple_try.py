"""Multiple-try Metropolis (Liu, Liang, Wong 2000; named in Djuric 2004, section 3.2).

1. Draw k points y_j from T(x, .); weigh them by w(y, x) = p(y) T(y, x) lambda(y, x) with lambda symmetric; pick y in proportion.
2. Draw k - 1 reference points x*_j from T(y, .), and let x be the k-th.
3. Go to y with probability min(1, sum_j w(y_j, x) / sum_j w(x*_j, y)).
"""

from typing import Any

import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree

from motes.core import checks, random
from motes.core.record import record, static
from motes.laws.cloud import draw
from motes.laws.conditional import Conditional, as_conditional
from motes.mcmc.interface import Info, Kernel, LogDensity, State, accept_or_stay, check_whole

WEIGHTS = {"importance": (0.0, -1.0), "plain": (1.0, 0.0)}
"""Powers of T(y, x) and T(x, y) in the weight: lambda is 1 / (T(x, y) T(y, x)), or 1."""


@record
class MultipleTry(Kernel):
    """The best of several proposals; k = 1 is Metropolis-Hastings, to the same numbers.

    Source: Liu, Liang, Wong 2000, The multiple-try method and local optimization in Metropolis sampling.

    Example:
        >>> kernel = mo.mcmc.MultipleTry(mo.AdditiveGaussian(lambda x, u, t: x, 9 * jnp.eye(1)), tries=4)
        >>> chains = mo.sample(0, kernel, lambda x: -0.5 * x @ x, jnp.zeros(1))
        >>> chains.positions.shape
        (4, 1000, 1)

    Attributes:
        proposal: conditional of a new position given the old one, both as one vector `(x,)`; its functions get None for u.
        tries: k.
        weight: "importance", w = p(y) / T(x, y), or "plain", w = p(y) T(y, x).
    """

    proposal: Conditional
    tries: int = static()
    weight: str = static(default="importance")

    def __post_init__(self) -> None:
        """Check the parameters.

        Raises:
            MotesError: naming the one that cannot be used.
        """
        as_conditional("MultipleTry proposal", self.proposal)
        checks.positive_integer("MultipleTry tries", self.tries)
        checks.option("MultipleTry weight", self.weight, tuple(WEIGHTS))

    def check(self, key: jax.Array, log_density: LogDensity, position: Any) -> None:
        """Ask for proposals that the position can hold."""
        check_whole("MultipleTry", position, lambda x: self.proposal.sample(key, x[:, None], None, 0)[:, 0])

    def step(self, key: jax.Array, log_density: LogDensity, state: State, t: Any) -> tuple[State, Info]:
        """Make one step."""
        x, rebuild = ravel_pytree(state.position)
        backward, forward = WEIGHTS[self.weight]

        def log_weights(points: jax.Array, origin: jax.Array, densities: jax.Array) -> jax.Array:
            near = jnp.broadcast_to(origin[:, None], points.shape)
            weight = densities + backward * self.proposal.log_prob(near, points, None, t)
            return weight + forward * self.proposal.log_prob(points, near, None, t) if forward else weight

        def densities_at(points: jax.Array) -> jax.Array:
            return jax.vmap(lambda point: log_density(rebuild(point)), in_axes=-1)(points)

        purposes = (random.PREDICT, random.RESAMPLE, random.NOISE)
        propose_key, pick_key, reference_key = (random.child(key, purpose) for purpose in purposes)
        # 1. tries
        points = self.proposal.sample(propose_key, jnp.repeat(x[:, None], self.tries, axis=1), None, t)
        densities = densities_at(points)
        invalid = jnp.isnan(densities) | (densities == jnp.inf)
        weights = jnp.where(invalid, -jnp.inf, log_weights(points, x, densities))
        total = jax.nn.logsumexp(weights)
        chosen = draw(pick_key, jnp.where(jnp.isfinite(total), weights - total, 0.0), 1)[0]
        y = points[:, chosen]
        # 2. reference points; x itself is among them: without it the chain would have another law
        others, reference_densities = points[:, :0], densities[:0]
        if self.tries > 1:
            others = self.proposal.sample(reference_key, jnp.repeat(y[:, None], self.tries - 1, axis=1), None, t)
            reference_densities = densities_at(others)
        reference = jnp.concatenate([others, x[:, None]], axis=1)
        reference_densities = jnp.append(reference_densities, state.log_density)
        reference_densities = jnp.where(jnp.isnan(reference_densities), -jnp.inf, reference_densities)
        # 3. accept or stay
        log_ratio = jnp.where(jnp.isfinite(total), total - jax.nn.logsumexp(log_weights(reference, y, reference_densities)), -jnp.inf)
        after, info = accept_or_stay(random.child(key, random.UPDATE), state, State(rebuild(y), densities[chosen]), log_ratio)
        return after, Info(info.tried, info.accepted, info.invalid + jnp.sum(invalid, dtype=jnp.int32))
