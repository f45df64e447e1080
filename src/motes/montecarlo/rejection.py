"""Rejection sampling with an envelope that is watched (von Neumann 1951)."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from motes.core import checks, random
from motes.core.types import KeyLike
from motes.laws.law import as_law
from motes.montecarlo.estimate import densities_at
from motes.tracing.compiling import jitted

ROUNDING = 1e-4
"""Nats by which a density may exceed its envelope."""
MOST_ROUNDS = 10_000


class Accepted(NamedTuple):
    """Independent draws.

    Attributes:
        points: `(x, n)`.
        acceptance: share of the proposals that were accepted.
        log_evidence: log of the integral of the unnormalized density, estimated from that share.
    """

    points: jax.Array
    acceptance: float
    log_evidence: float


def rejection_sampling(key: KeyLike, log_density: Any, proposal: Any, log_bound: float, n: int) -> Accepted:
    """Draw n independent points exactly from a density: points of the proposal, kept with probability p / (q exp(log_bound)).

    Every point is checked against the envelope q exp(log_bound); the first that exceeds it ends the work.

    Args:
        key: JAX key or integer seed.
        log_density: a law, or a function of one point `(x,)`; up to a constant.
        proposal: law with `sample` and `log_prob`.
        log_bound: log of a number that p / q never exceeds.
        n: number of draws.

    Raises:
        MotesError: an argument cannot be used, the density exceeds its envelope or is NaN somewhere, or next to nothing is accepted.
    """
    checks.positive_integer("rejection_sampling n", n)
    checks.finite("rejection_sampling log_bound", log_bound)
    law = as_law("rejection_sampling proposal", proposal)
    key = random.as_key(key)
    batch = max(1_000, n)

    @jitted
    def tried(key: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
        points = law.sample(random.child(key, 2), batch)
        excess = densities_at(log_density, points) - law.log_prob(points) - log_bound
        return points, excess, jnp.log(random.uniform(random.child(key, 3), (batch,), points.dtype)) < excess

    kept: list[np.ndarray] = []
    found = proposed = 0
    for turn in range(MOST_ROUNDS):
        points, excess, taken = (np.asarray(part) for part in tried(random.step_key(key, turn)))
        _check_envelope(points, excess)
        proposed += batch
        kept.append(points[:, taken])
        found += int(taken.sum())
        if found >= n:
            share = found / proposed
            return Accepted(jnp.asarray(np.concatenate(kept, axis=1)[:, :n]), share, float(np.log(share) + log_bound))
        if proposed >= 1_000_000 and found < 1e-6 * proposed:
            break
    given = f"{found} of {proposed} accepted"
    checks.refuse("rejection_sampling proposal", f"one of which {n} points are accepted in reasonable time", given,
                  "Use a proposal nearer to the density, or a Markov chain (mo.sample).")


def _check_envelope(points: np.ndarray, excess: np.ndarray) -> None:
    if np.isnan(excess).any():
        checks.refuse("log_density", "numbers", f"NaN at {points[:, np.argmax(np.isnan(excess))].tolist()}", "Give impossible points -inf.")
    worst = int(np.argmax(excess))
    if excess[worst] > ROUNDING:
        checks.refuse("rejection_sampling log_bound", f"an envelope above the density: at least {excess[worst]:.4g} more",
                      f"a density that exceeds it at {np.round(points[:, worst].astype(float), 4).tolist()}",
                      "Draws so far would have the wrong law and are not given.")
