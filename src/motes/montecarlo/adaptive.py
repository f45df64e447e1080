"""Adaptive importance sampling: a proposal that learns from its own weighted draws (Cornuet, Marin, Mira, Robert 2012; Cappe et al. 2008).

1. Draw n points from the present proposal.
2. Weigh all points so far by the mixture of all proposals so far.
3. Fit the next proposal, a mixture of t laws, to them by a step of expectation and maximization; go to 1.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from motes.core import checks, linalg, logspace, random
from motes.core.record import record
from motes.core.types import KeyLike
from motes.laws.cloud import draw
from motes.laws.density import log_normal
from motes.laws.gaussian import Gaussian
from motes.laws.law import Law
from motes.laws.mixture import Mixture
from motes.montecarlo.estimate import Estimate, averaged, densities_at, mixture_log_prob, values_at, warned
from motes.tracing.compiling import jitted

DEGREES = 5
"""Of freedom of the t laws: tails heavier than a Gaussian's, with a variance."""
LEAST_SHARE = 1e-3


@record
class StudentMixture(Law):
    """A mixture of multivariate t laws with `DEGREES` degrees of freedom.

    Attributes:
        mixture: its centers, scale matrices and weights.
    """

    mixture: Mixture

    def mean(self) -> jax.Array:
        """Mean, `(x,)`."""
        return self.mixture.mean()

    def cov(self) -> jax.Array:
        """Covariance, `(x, x)`."""
        parts = self.mixture.parts
        return Mixture(Gaussian(parts.center, parts.covariance * (DEGREES / (DEGREES - 2))), self.mixture.log_weights).cov()

    def sample(self, key: jax.Array, n: int) -> jax.Array:
        """Draw n points, `(x, n)`: normal deviations over the root of a mean of squared ones."""
        chosen = self.mixture.resampled(draw(random.child(key, 0), self.mixture.log_weights, n)).parts
        size = chosen.center.shape[0]
        noise = random.normal(random.child(key, 1), (size + DEGREES, n), chosen.center.dtype)
        scale = jnp.sqrt(jnp.mean(noise[size:] ** 2, axis=0))
        return chosen.center + linalg.times_vector(linalg.cholesky(chosen.covariance), noise[:size] / scale)

    def log_prob(self, value: jax.Array) -> jax.Array:
        """Log density at `(x,)` or `(x, n)`."""
        shape, points = value.shape[1:], value.reshape(value.shape[0], -1)
        return jax.nn.logsumexp(self.each(points) + self.mixture.log_weights[:, None], axis=0).reshape(shape)

    def each(self, points: jax.Array) -> jax.Array:
        """Log density of each component at points `(x, n)`, `(m, n)`."""
        size = points.shape[0]
        constant = jax.lax.lgamma((DEGREES + size) / 2) - jax.lax.lgamma(DEGREES / 2) - 0.5 * size * jnp.log(DEGREES * jnp.pi)

        def of_one(center: jax.Array, scale: jax.Array) -> jax.Array:
            # the Gaussian's density tells both the distance and the determinant
            highest = log_normal(jnp.zeros((size, 1), points.dtype), scale)
            squared = 2 * (highest - log_normal(points - center[:, None], scale))
            log_root = -highest - 0.5 * size * jnp.log(2 * jnp.pi)
            return constant - log_root - (DEGREES + size) / 2 * jnp.log1p(squared / DEGREES)

        return jax.vmap(of_one, in_axes=(-1, -1))(self.mixture.parts.center, self.mixture.parts.covariance)


class Adapted(NamedTuple):
    """What `adaptive_importance_sampling` gives.

    Attributes:
        estimate: of the function's mean, from the points of all rounds.
        proposal: the last one.
        points: of all rounds, `(x, rounds n)`.
        log_weights: normalized, `(rounds n,)`.
    """

    estimate: Estimate
    proposal: StudentMixture
    points: jax.Array
    log_weights: jax.Array


def adaptive_importance_sampling(
    key: KeyLike, function: Any, log_density: Any, first: Gaussian | Mixture, n: int, rounds: int = 10, normalized: bool = False
) -> Adapted:
    """Estimate the mean of a function under a density, with a proposal that fits itself to the density.

    Args:
        key: JAX key or integer seed.
        function: of one point `(x,)`, to a number or a vector `(m,)`.
        log_density: a law, or a function of one point; up to a constant unless `normalized`.
        first: wide enough to see all modes; a `Mixture` has as many components as are fitted.
        n: points of each round.
        rounds: how often to draw.
        normalized: whether the density integrates to one.

    Raises:
        MotesError: an argument cannot be used, or no point of the first round has any density.
    """
    if not isinstance(first, (Gaussian, Mixture)):
        checks.refuse("adaptive_importance_sampling first", "a Gaussian or a Mixture", type(first).__name__)
    for name, value in (("n", n), ("rounds", rounds)):
        checks.positive_integer(f"adaptive_importance_sampling {name}", value)
    key = random.as_key(key)
    laws, drawn, densities = [StudentMixture(_as_mixture(first))], [], []
    weights = jnp.zeros(0)
    for turn in range(rounds):
        fresh = laws[-1].sample(random.step_key(key, turn), n)
        drawn.append(fresh)
        densities.append(densities_at(log_density, fresh))
        points = jnp.concatenate(drawn, axis=1)
        raw = jnp.concatenate(densities) - mixture_log_prob(laws, jnp.ones(len(laws)), points)
        raw = jnp.where(jnp.isnan(raw), -jnp.inf, raw)
        if checks.is_concrete(raw) and not bool(jnp.isfinite(raw).any()):
            wanted = "a law that reaches where the density is positive"
            checks.refuse("adaptive_importance_sampling first", wanted, "none of its points there")
        weights = logspace.normalize(raw)[0]
        if turn + 1 < rounds:
            laws.append(_fitted(laws[-1], weights, points))
    estimate = averaged(raw, values_at(function, points), normalized)
    return Adapted(warned(estimate, "adaptive_importance_sampling"), laws[-1], points, weights)


def _as_mixture(law: Gaussian | Mixture) -> Mixture:
    if isinstance(law, Gaussian):
        return Mixture(Gaussian(law.center[:, None], law.covariance[..., None]), jnp.zeros(1, law.center.dtype))
    cov = law.parts.covariance
    spread = cov if cov.ndim == 3 else jnp.broadcast_to(cov[..., None], (*cov.shape, law.log_weights.shape[0]))
    return Mixture(Gaussian(law.parts.center, spread), law.log_weights)


@jitted
def _fitted(law: StudentMixture, log_weights: jax.Array, points: jax.Array) -> StudentMixture:
    """Step once from expectation to maximization."""
    each = law.each(points) + law.mixture.log_weights[:, None]
    weights = jnp.exp(log_weights + each - jax.nn.logsumexp(each, axis=0))
    totals = jnp.sum(weights, axis=1)
    own = weights / jnp.maximum(totals, 1e-30)[:, None]
    center = jnp.einsum("mn,xn->xm", own, points, precision=jax.lax.Precision.HIGHEST)
    off = points[:, :, None] - center[:, None]
    cov = jnp.einsum("mn,xnm,ynm->xym", own, off, off, precision=jax.lax.Precision.HIGHEST)
    # a component that lives on few points keeps its old shape
    enough = (totals > LEAST_SHARE) & (1 / jnp.sum(own**2, axis=1) > 2 * points.shape[0] + 2)
    old = law.mixture.parts
    scale = linalg.symmetric(cov) * ((DEGREES - 2) / DEGREES)
    parts = Gaussian(jnp.where(enough, center, old.center), jnp.where(enough, scale, old.covariance))
    return StudentMixture(Mixture(parts, logspace.normalize(jnp.log(jnp.maximum(totals, LEAST_SHARE)))[0]))
