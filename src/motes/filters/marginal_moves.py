"""Particles that carry a Gaussian each: how they begin, and how they move (steps 2 and 3 of `filters/marginalized.py`)."""

from typing import Any

import jax
import jax.numpy as jnp

from motes.core import linalg, logspace
from motes.core.record import replace
from motes.laws.circular import near, wrap
from motes.laws.gaussian import Gaussian
from motes.laws.marginal_cloud import MarginalCloud
from motes.models.mixed_linear import Affine, MixedLinearModel, initial_split
from motes.models.split import SplitModel


def first_particles(key: jax.Array, model: SplitModel, n: int) -> MarginalCloud:
    """Draw n particles of x_p, each with the Gaussian of x_k given it."""
    mixed: MixedLinearModel = model.mixed
    x_p, means = initial_split(key, mixed.initial_p, mixed.initial_k, mixed.initial_gain, n)
    cov = mixed.initial_k.covariance
    if model.per_particle:
        cov = jnp.broadcast_to(cov[..., None], (*cov.shape, n))
    return MarginalCloud(x_p, Gaussian(means, cov), logspace.uniform_weights(n, means.dtype), jnp.arange(n, dtype=jnp.int32), mixed.order)


def moved(  # noqa: PLR0913 (a step of a filter, and how places are drawn)
    key: jax.Array, model: SplitModel, cloud: MarginalCloud, example: jax.Array, u: Any, t: Any, first: jax.Array | None = None,
    offset: jax.Array | None = None,
) -> MarginalCloud:  # fmt: skip
    """Move the particles, then correct and predict their Gaussians (steps 2 and 3).

    Args:
        key: of the noise.
        model: split.
        cloud: what is moved.
        example: a particle `(p,)`, for what is the same for all.
        u: inputs of the step.
        t: its number.
        first: where the first particle goes `(p,)`, for conditional sequential Monte Carlo; None draws it like the others.
        offset: how far each goes from the mean of `expected_places`, `(p, n)`; None draws from it.
    """
    of_p, of_k = (model.over(part, cloud.particles, example, u, t) for part in ("particle", "kalman"))
    angles = tuple(place for place in model.places if place < of_p.f.shape[0])
    if model.drives:
        # 2. draw x_p' with the spread of x_k; 3. correct the Gaussians by it
        expected = cloud.kalman.through(of_p.A, of_p.f, of_p.Q)
        offset = _offset(key, expected) if offset is None else offset
        if first is not None:
            offset = offset.at[:, 0].set(wrap(first - expected.center[:, 0], angles))
        informed, x_p = cloud.kalman.corrected(offset, of_p.A, of_p.Q).law, expected.center + offset
    else:
        # 2. draw x_p', which tells nothing of x_k
        offset = _offset(key, Gaussian(of_p.f, of_p.Q)) if offset is None else offset
        informed, x_p = cloud.kalman, of_p.f + offset
        x_p = x_p if first is None else x_p.at[:, 0].set(near(first, of_p.f[:, 0], angles))
    # 3. predict the Gaussians
    f, A, Q = _decorrelated(of_p, of_k, model.cross_cov(cloud.particles, example, u, t), x_p)
    return replace(cloud, particles=x_p, kalman=informed.through(A, f, Q))


def expected_places(model: SplitModel, cloud: MarginalCloud, example: jax.Array, u: Any, t: Any) -> Gaussian:
    """Return the Gaussians from which `moved` draws where each particle goes."""
    of_p = model.over("particle", cloud.particles, example, u, t)
    return cloud.kalman.through(of_p.A, of_p.f, of_p.Q) if model.drives else Gaussian(of_p.f, of_p.Q)


def _offset(key: jax.Array, expected: Gaussian) -> jax.Array:
    return Gaussian(jnp.zeros_like(expected.center), expected.covariance).sample(key, expected.center.shape[-1])


def _decorrelated(of_p: Affine, of_k: Affine, cross_cov: jax.Array | None, x_p: jax.Array) -> Affine:
    """Give the Kalman part's dynamics once the noise of the particle part, x_p' - f_p - A_p x_k, is known (step 3)."""
    if cross_cov is None:
        return of_k
    factor = linalg.cholesky(of_p.Q)
    aligned = cross_cov if cross_cov.ndim >= factor.ndim else cross_cov[..., None]
    G = linalg.transpose(linalg.solve(factor, aligned))
    return Affine(
        linalg.add_vectors(linalg.times_vector(G, x_p - of_p.f), of_k.f),
        linalg.add(of_k.A, -linalg.product(G, of_p.A)),
        linalg.add(of_k.Q, -linalg.symmetric(linalg.product(G, aligned))),
    )
