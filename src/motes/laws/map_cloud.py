"""Clouds of particles that each carry a map: the law of a filter that does not know its landmarks."""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from motes.core import linalg, sums
from motes.core.record import record, replace
from motes.laws.gaussian import Gaussian
from motes.laws.law import Law
from motes.laws.marginal_cloud import MarginalCloud


class Map(NamedTuple):
    """The landmarks of n particles, each a mixture of J Gaussians.

    Attributes:
        centers: `(L, J, d, n)`.
        covs: `(L, J, d, d, n)`.
        log_shares: log weight of each Gaussian, `(L, J, n)`.
        seen: whether the landmark has been sighted, bool `(L, n)`.
    """

    centers: jax.Array
    covs: jax.Array
    log_shares: jax.Array
    seen: jax.Array

    @classmethod
    def empty(cls, landmarks: int, born: tuple[jax.ShapeDtypeStruct, ...], n: int) -> "Map":
        """Return a map in which nothing has been sighted; `born` are the shapes of a landmark's parts without the particle axis."""
        centers, covs, log_shares = (jnp.zeros((landmarks, *part.shape, n), part.dtype) for part in born)
        return cls(centers, covs, log_shares, jnp.zeros((landmarks, n), bool))

    def of(self, landmark: jax.Array) -> "Map":
        """Return one landmark, `(J, ..., n)`: the same for all particles, `()`, or one for each, `(n,)`."""
        if landmark.ndim == 0:
            return Map(*(part[landmark] for part in self))
        every = jnp.arange(landmark.shape[0])
        return Map(*(jnp.moveaxis(part[landmark, ..., every], 0, -1) for part in self))

    def with_one(self, landmark: jax.Array, one: "Map") -> "Map":
        """Return the map with one landmark exchanged; see `of`."""
        if landmark.ndim == 0:
            return Map(*(part.at[landmark].set(new) for part, new in zip(self, one, strict=True)))
        every = jnp.arange(landmark.shape[0])
        return Map(*(part.at[landmark, ..., every].set(jnp.moveaxis(new, -1, 0)) for part, new in zip(self, one, strict=True)))


class Landmarks(NamedTuple):
    """What is known of the landmarks.

    Attributes:
        mean: `(L, d)`; NaN of those that no particle has sighted.
        cov: `(L, d, d)`, within and between particles.
        seen: probability that a landmark has been sighted, `(L,)`.
    """

    mean: jax.Array
    cov: jax.Array
    seen: jax.Array


@record
class MapCloud(Law):
    """Weighted particles of a path, each with a Gaussian of the states that are linear given it, and with a map of its own.

    Mean, covariance and draws are those of the states without the landmarks, which `landmarks` tells.

    Attributes:
        path: particles with their Gaussians.
        centers: of the landmarks, see `Map`, as the others.
        covs: their covariances.
        log_shares: log weights of their Gaussians.
        seen: whether they have been sighted.
    """

    weighted = marks_ancestors = True
    path: MarginalCloud
    centers: jax.Array
    covs: jax.Array
    log_shares: jax.Array
    seen: jax.Array

    @property
    def map(self) -> Map:
        """The landmarks of all particles."""
        return Map(self.centers, self.covs, self.log_shares, self.seen)

    @property
    def log_weights(self) -> jax.Array:
        """Normalized, `(n,)`."""
        return self.path.log_weights

    @property
    def ancestors(self) -> jax.Array:
        """Index of each particle's parent at the step before, `(n,)` int32."""
        return self.path.ancestors

    def mean(self) -> jax.Array:
        """Mean of the states, `(x,)`."""
        return self.path.mean()

    def cov(self) -> jax.Array:
        """Covariance of the states, `(x, x)`."""
        return self.path.cov()

    def sample(self, key: jax.Array, n: int) -> jax.Array:
        """Draw n points of the states, `(x, n)`."""
        return self.path.sample(key, n)

    def weighted_points(self) -> tuple[jax.Array, jax.Array]:
        """Return particles and means of the Kalman part, in the user's order, and their log weights."""
        return self.path.weighted_points()

    def landmarks(self) -> Landmarks:
        """Return mean and covariance of each landmark over particles and Gaussians."""

        def one(centers: jax.Array, covs: jax.Array, log_shares: jax.Array, seen: jax.Array) -> Landmarks:
            weights = jnp.where(seen, jnp.exp(self.log_weights), 0)
            total = jnp.sum(weights)
            of_modes = (jnp.exp(log_shares) * weights / total).reshape(-1)
            points = jnp.moveaxis(centers, 1, 0).reshape(centers.shape[1], -1)
            mean = sums.weighted_sum(points, of_modes)
            off = points - mean[:, None]
            within = sums.weighted_sum(jnp.moveaxis(covs, 0, 2).reshape(*covs.shape[1:3], -1), of_modes)
            return Landmarks(mean, within + linalg.product_transposed(off * of_modes, off), total)

        return jax.lax.map(lambda parts: one(*parts), self.map)

    def resampled(self, ancestors: jax.Array) -> "MapCloud":
        """Return the cloud of the named particles `(n,)` with their maps, equal weights."""
        return MapCloud(self.path.resampled(ancestors), *(part[..., ancestors] for part in self.map))

    def not_resampled(self) -> "MapCloud":
        """Return the cloud as it is, each particle its own ancestor."""
        return replace(self, path=self.path.not_resampled())

    def gathered(self, angles: tuple[int, ...]) -> "MapCloud":
        """Return the cloud with the states that are angles on one branch."""
        return replace(self, path=self.path.gathered(angles))

    def inflated(self, factor: float) -> "MapCloud":
        """Return the cloud with the covariance of the states, and of each landmark given them, times a factor."""
        return replace(self, path=self.path.inflated(factor), covs=self.covs * factor)


def parts_of(law: Law) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Return centers `(J, d)`, covariances `(J, d, d)` and log weights `(J,)` of a landmark that is born."""
    if isinstance(law, Gaussian):
        return law.center[None], law.covariance[None], jnp.zeros((1,), law.center.dtype)
    centers, covs = law.parts.center, law.parts.covariance  # type: ignore[attr-defined]
    covs = jnp.broadcast_to(covs[..., None], (*covs.shape, centers.shape[-1])) if covs.ndim == 2 else covs
    return centers.T, jnp.moveaxis(covs, -1, 0), law.log_weights  # type: ignore[attr-defined]
