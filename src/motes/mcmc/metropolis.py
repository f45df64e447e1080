"""Metropolis (1953), Metropolis-Hastings (Hastings 1970) and independence samplers (Djuric 2004, section 2.1).

1. Propose a new position x* from a law q(. | x) (`proposed`).
2. Go there with probability min(1, p(x*) q(x | x*) / (p(x) q(x* | x))), else stay (equations 5 and 6; `Proposing.step_by`, interface.py).
"""

from typing import Any

import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree

from motes.core import checks, random
from motes.core.record import record
from motes.laws.conditional import Conditional, as_conditional
from motes.laws.law import Law, as_law
from motes.mcmc.interface import LogDensity, Proposing, Tunable


@record
class RandomWalkMetropolis(Proposing, Tunable):
    """Gaussian steps about the present position; all its arrays are taken as one vector of x numbers.

    Source: Metropolis, Rosenbluth, Rosenbluth, Teller, Teller 1953, Equation of state calculations by fast computing machines.

    Example:
        >>> kernel = mo.mcmc.RandomWalkMetropolis(scale=2.4)
        >>> chains = mo.sample(0, kernel, lambda x: -0.5 * x @ x, jnp.zeros(1))
        >>> chains.positions.shape
        (4, 1000, 1)

    Attributes:
        scale: standard deviation of a step, `()` or `(x,)`, or a lower factor L `(x, x)` of its covariance L L'.
    """

    scale: jax.Array

    def __init__(self, scale: Any = 1.0):
        """Check the scale.

        Raises:
            MotesError: it is no number, vector or square matrix, or not positive.
        """
        scale = checks.as_float("RandomWalkMetropolis scale", scale)
        if scale.ndim > 2 or (scale.ndim == 2 and scale.shape[0] != scale.shape[1]):
            checks.refuse("RandomWalkMetropolis scale", "a number, shape (x,) or a factor (x, x)", f"shape {scale.shape}")
        checks.finite("RandomWalkMetropolis scale", scale)
        if checks.is_concrete(scale) and not bool(((scale if scale.ndim < 2 else jnp.diag(scale)) > 0).all()):
            checks.refuse("RandomWalkMetropolis scale", "positive numbers", scale.tolist())
        object.__setattr__(self, "scale", scale)

    def check(self, key: jax.Array, log_density: LogDensity, position: Any) -> None:
        """Ask for a scale of the position's size."""
        size = ravel_pytree(position)[0].shape[0]
        if self.scale.ndim and self.scale.shape[0] != size:
            checks.refuse("RandomWalkMetropolis scale", f"one number or {size}, as the position has", self.scale.shape[0])
        super().check(key, log_density, position)

    def proposed(self, key: jax.Array, x: jax.Array, t: Any) -> tuple[jax.Array, Any]:
        """Draw a step (step 1)."""
        noise = random.normal(key, x.shape, x.dtype)
        scale = self.scale.astype(x.dtype)
        return x + (jnp.matmul(scale, noise, precision=jax.lax.Precision.HIGHEST) if scale.ndim == 2 else scale * noise), 0.0

    def target(self, size: int) -> float:
        """0.44 in one dimension, 0.234 in many (Roberts, Gelman, Gilks 1997)."""
        return 0.234 + 0.206 / size

    def initial_scale(self, size: int) -> float:
        """2.38 / sqrt(x) (the same)."""
        return 2.38 / size**0.5

    def tuned(self, step_size: jax.Array, factor: jax.Array) -> "RandomWalkMetropolis":
        """Return the walk with steps of covariance step_size^2 L L'."""
        return RandomWalkMetropolis(step_size * factor)


@record
class IndependenceMetropolis(Proposing):
    """Proposals from one law, wherever the chain is; good where the law has heavier tails than the density.

    Source: Hastings 1970, Monte Carlo sampling methods using Markov chains and their applications.

    Example:
        >>> kernel = mo.mcmc.IndependenceMetropolis(mo.Gaussian(jnp.zeros(1), 4 * jnp.eye(1)))
        >>> chains = mo.sample(0, kernel, lambda x: -0.5 * x @ x, jnp.zeros(1))
        >>> chains.positions.shape
        (4, 1000, 1)

    Attributes:
        law: of a position, all its arrays taken as one vector `(x,)`.
    """

    law: Law

    def __init__(self, law: Any):
        """Take a law.

        Raises:
            MotesError: it is none.
        """
        object.__setattr__(self, "law", as_law("IndependenceMetropolis law", law))

    def proposed(self, key: jax.Array, x: jax.Array, t: Any) -> tuple[jax.Array, Any]:
        """Draw from the law (step 1)."""
        new = self.law.sample(key, 1)[:, 0].astype(x.dtype)
        return new, self.law.log_prob(x) - self.law.log_prob(new)


@record
class MetropolisHastings(Proposing):
    """Any proposal.

    Source: Hastings 1970, Monte Carlo sampling methods using Markov chains and their applications.

    Example:
        >>> kernel = mo.mcmc.MetropolisHastings(mo.AdditiveGaussian(lambda x, u, t: 0.5 * x, jnp.eye(1)))
        >>> chains = mo.sample(0, kernel, lambda x: -0.5 * x @ x, jnp.zeros(1))
        >>> chains.positions.shape
        (4, 1000, 1)

    Attributes:
        proposal: a conditional such as `AdditiveGaussian` or `Custom`, of the new position given the old one, both as one vector `(x,)`.
            Its functions f(x, u, t) get None for u.
    """

    proposal: Conditional

    def __init__(self, proposal: Conditional):
        """Take a proposal.

        Raises:
            MotesError: it is no conditional.
        """
        object.__setattr__(self, "proposal", as_conditional("MetropolisHastings proposal", proposal))

    def proposed(self, key: jax.Array, x: jax.Array, t: Any) -> tuple[jax.Array, Any]:
        """Draw from the proposal (step 1)."""
        old = x[:, None]
        new = self.proposal.sample(key, old, None, t)
        return new[:, 0], (self.proposal.log_prob(old, new, None, t) - self.proposal.log_prob(new, old, None, t))[0]
