"""The generalized Markov sampler (Keith, Kroese, Bryant 2004; Djuric 2004, section 3.1).

A chain of pairs (i, x) of a type of transition and a point. Phi(x) are the types that can be had at x, Psi(i, x) the pairs that a
transition of type i may lead to; these sets share out the space among them.

1. Q step: draw a type m in Phi(x) from Q((i, x), .), which leaves probabilities q_x on Phi(x) as they are.
2. R step: draw a pair (k, z) in Psi(m, x) from R((m, x), .), which leaves p(z) q_z(k), times the Jacobian of the map to z, as it is.

The x of the chain have the density p. Gibbs, Metropolis-Hastings and reversible jump are special cases.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from motes.core import checks, lapack, random
from motes.core.record import record, static
from motes.laws.cloud import draw
from motes.mcmc.interface import Info, Kernel, LogDensity, Position, State

TOLERANCE = 1e-3


class Orbit(NamedTuple):
    """A finite set Psi of c pairs.

    Attributes:
        types: whole numbers `(c,)`.
        points: positions with the axis of the set first.
        log_jacobian: log of |d point / d x| for the maps from x, `(c,)`.
        own: which of the pairs is (m, x) itself, `()`.
    """

    types: jax.Array
    points: Any
    log_jacobian: jax.Array
    own: jax.Array | int


Move = Callable[[jax.Array, jax.Array, Any], tuple[jax.Array, Any]]


@record
class GeneralizedSampler(Kernel):
    """A sampler in terms of Phi, Q, Psi and R.

    Source: Keith, Kroese, Bryant 2004, A generalized Markov sampler.

    Example:
        >>> flip = lambda m, x: mo.mcmc.Orbit(jnp.array([0, 0]), jnp.stack([x, -x]), jnp.zeros(2), 0)
        >>> kernel = mo.mcmc.GeneralizedSampler(phi=lambda x: jnp.ones(1, bool), q=lambda m, x: jnp.zeros(1), psi=flip)
        >>> chains = mo.sample(0, kernel, lambda x: x[0], jnp.ones(1))  # at -1 or 1
        >>> chains.positions.shape
        (4, 1000, 1)

    Attributes:
        phi: position to `(m,)`, whether each type can be had there.
        q: type and position to log probabilities `(m,)` of the next type.
        psi: type and position to an `Orbit`; None where R draws from sets that are not finite.
        r: "gibbs" draws from the orbit in proportion to p(z) q_z(k) |dz/dx|; "metropolis" proposes another pair of the orbit, all with
            equal probability, and accepts or stays; or a function (key, type, position) that returns a pair and has the right law.
        start: type of the first transition.
    """

    phi: Callable[[Any], jax.Array] = static()
    q: Callable[[jax.Array, Any], jax.Array] = static()
    psi: Callable[[jax.Array, Any], Orbit] | None = static(default=None)
    r: str | Move = static(default="gibbs")
    start: int = static(default=0)

    def __post_init__(self) -> None:
        """Check the parameters.

        Raises:
            MotesError: naming the one that cannot be used.
        """
        for name in ("phi", "q"):
            if not callable(getattr(self, name)):
                checks.refuse(f"GeneralizedSampler {name}", "a function", type(getattr(self, name)).__name__)
        if not callable(self.r):
            checks.option("GeneralizedSampler r", self.r, ("gibbs", "metropolis"))
            if self.psi is None:
                checks.refuse("GeneralizedSampler psi", f"a function that gives orbits (r is {self.r!r})", "None")

    def init_kernel_state(self, log_density: LogDensity, position: Position) -> Any:
        """Return the type that the chain carries along."""
        return jnp.int32(self.start)

    def log_stationary(self, position: Position) -> jax.Array:
        """Log of q_x, `(m,)`: the probabilities on Phi(x) that Q leaves as they are."""
        allowed = self.phi(position)
        unit = jnp.eye(allowed.shape[0])
        Q = jnp.exp(jax.vmap(lambda i: self.q(i, position))(jnp.arange(allowed.shape[0])))
        # q (1 - Q + J) = 1', J all ones, has q = q Q with sum 1 for its only solution, also where Q is periodic
        system = jnp.where(allowed[:, None] & allowed, unit - Q + 1, unit)
        return jnp.log(jnp.maximum(lapack.inverse(system.T) @ allowed.astype(system.dtype), 0))

    def _log_weights(self, log_density: LogDensity, orbit: Orbit) -> tuple[jax.Array, jax.Array]:
        """Log of p(z) q_z(k) |dz/dx| and log p(z) of each pair of an orbit, `(c,)` both."""
        densities = jax.vmap(log_density)(orbit.points)
        of_types = jax.vmap(self.log_stationary)(orbit.points)
        return densities + jnp.take_along_axis(of_types, orbit.types[:, None], axis=1)[:, 0] + orbit.log_jacobian, densities

    def step(self, key: jax.Array, log_density: LogDensity, state: State, t: Any) -> tuple[State, Info]:
        """Make a Q step and an R step."""
        x = state.position
        # 1. Q step
        m = draw(random.child(key, random.PREDICT), self.q(state.kernel_state, x), 1)[0]
        # 2. R step
        r_key = random.child(key, random.UPDATE)
        if callable(self.r):
            k, z = self.r(r_key, m, x)
            return State(z, log_density(z), jnp.asarray(k, jnp.int32)), Info.of_one(1.0)
        assert self.psi is not None
        orbit = self.psi(m, x)
        weights, densities = self._log_weights(log_density, orbit)
        invalid = jnp.isnan(weights)
        weights = jnp.where(invalid, -jnp.inf, weights)
        own = jnp.asarray(orbit.own, jnp.int32)
        if self.r == "gibbs":
            chosen = draw(r_key, jax.nn.log_softmax(weights), 1)[0]
        else:
            count = weights.shape[0]
            other = (random.uniform(random.child(r_key, 0), (), jnp.float32) * (count - 1)).astype(jnp.int32)
            other = other + (other >= own)
            accepted = jnp.log(random.uniform(random.child(r_key, 1), (), weights.dtype)) < weights[other] - weights[own]
            chosen = jnp.where(accepted, other, own)
        z = jax.tree.map(lambda leaf: leaf[chosen], orbit.points)
        after = State(z, densities[chosen], orbit.types[chosen].astype(jnp.int32))
        return after, Info.of_one((chosen != own).astype(weights.dtype), jnp.any(invalid))

    def check(self, key: jax.Array, log_density: LogDensity, position: Position) -> None:
        """Ask that Q has probabilities on Phi(x), and that all pairs of an orbit have the same orbit."""
        allowed = np.asarray(self.phi(position))
        for i in np.flatnonzero(allowed):
            row = np.exp(np.asarray(self.q(jnp.int32(i), position), np.float64))
            if abs(row[allowed].sum() - 1) > TOLERANCE or row[~allowed].any():
                given = f"a sum of {row[allowed].sum():.4g} there"
                checks.refuse(f"GeneralizedSampler q({i}, x)", "logs of probabilities on phi(x) that sum to 1", given)
        if self.psi is None:
            return
        for m in np.flatnonzero(allowed):
            orbit = self.psi(jnp.int32(m), position)
            for c in range(orbit.types.shape[0]):
                other = self.psi(orbit.types[c], jax.tree.map(lambda leaf, c=c: leaf[c], orbit.points))
                if not _same_orbit(orbit, other, c):
                    checks.refuse(f"GeneralizedSampler psi({m}, x)", "the same pairs from each of its pairs (the sets must not overlap)",
                                  f"others from its pair {c}")


def _same_orbit(one: Orbit, other: Orbit, seen_from: int) -> bool:
    """Tell whether two orbits hold the same pairs, with Jacobians that fit."""

    def rows(orbit: Orbit, base: Any) -> np.ndarray:
        columns = [np.asarray(orbit.types)[:, None], np.asarray(orbit.log_jacobian - base)[:, None]]
        columns += [np.asarray(leaf).reshape(leaf.shape[0], -1) for leaf in jax.tree.leaves(orbit.points)]
        return np.concatenate(columns, axis=1).astype(np.float64)

    a, b = rows(one, one.log_jacobian[seen_from]), rows(other, 0.0)
    if a.shape != b.shape:
        return False
    near = np.all(np.abs(a[:, None] - b[None]) <= TOLERANCE * (1 + np.abs(a[:, None])), axis=-1)
    return bool(near.any(axis=0).all() and near.any(axis=1).all())
