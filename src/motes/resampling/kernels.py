"""Regularization: a kernel smooths a cloud, so that particles which resampling made equal part again (Musso, Oudjane, LeGland 2001)."""

import math
from collections.abc import Callable

import jax
import jax.numpy as jnp

from motes.core import checks, linalg, random
from motes.core.record import record, static
from motes.laws.cloud import weighted_moments

GAUSSIAN, EPANECHNIKOV = "gaussian", "epanechnikov"

Smoothing = Callable[[jax.Array, jax.Array], jax.Array]


@record
class Regularization:
    """A kernel and its bandwidth, on the cloud scaled to unit covariance: x <- x + h D e, with D D' the covariance of the cloud.

    Attributes:
        kernel: law of e in d dimensions: "gaussian", or "epanechnikov", with density (d + 2) (1 - |e|^2) / (2 c_d) in the unit ball of
            volume c_d.
        scale: factor on the bandwidth that is best (in mean integrated squared error) for a Gaussian cloud; about a half where there are
            several modes.
        shrink: draw the smoothed cloud together about its mean so that its covariance does not grow (after Liu, West 2001).
    """

    kernel: str = static(default=GAUSSIAN)
    scale: float = 1.0
    shrink: bool = static(default=False)

    def __post_init__(self) -> None:
        """Check kernel and scale.

        Raises:
            MotesError: the kernel is unknown, or the scale is not positive.
        """
        checks.option("Regularization kernel", self.kernel, (GAUSSIAN, EPANECHNIKOV))
        checks.above_zero("Regularization scale", self.scale)

    def bandwidth(self, d: int, n: int) -> jax.Array | float:
        """Bandwidth h for n particles in d dimensions, as a share of the standard deviation of the cloud (Silverman 1986)."""
        best = 4 / (d + 2)
        if self.kernel == EPANECHNIKOV:
            log_ball = 0.5 * d * math.log(math.pi) - math.lgamma(0.5 * d + 1)
            best = 8 * (d + 4) * math.exp(d * math.log(2 * math.sqrt(math.pi)) - log_ball)
        return self.scale * (best / n) ** (1 / (d + 4))

    def draw(self, key: jax.Array, shape: tuple[int, ...], dtype: jnp.dtype) -> jax.Array:
        """Draw n points `(d, n)` of the kernel: of covariance one if Gaussian, 1 / (d + 4) if Epanechnikov."""
        d, n = shape
        if self.kernel == GAUSSIAN:
            return random.normal(key, shape, dtype)
        # d coordinates of a point on the sphere in d + 4 dimensions have this very law
        noise = random.normal(key, (d + 4, n), dtype)
        return noise[:d] / jnp.sqrt(jnp.sum(noise**2, axis=0))

    def fitted(self, log_weights: jax.Array, particles: jax.Array, needed: jax.Array | bool = True) -> Smoothing:
        """Return what smooths particles `(d, n)`, each on its own, from a key and the particles.

        Args:
            log_weights: normalized, `(n,)`, of the cloud that tells the covariance.
            particles: of that cloud, `(d, n)`.
            needed: whether to smooth at all.
        """
        d, n = particles.shape
        mean, cov = weighted_moments(log_weights, particles)
        h = jnp.where(needed, jnp.asarray(self.bandwidth(d, n), particles.dtype), 0)
        factor = h * linalg.cholesky(cov)
        within = h**2 if self.kernel == GAUSSIAN else h**2 / (d + 4)
        together = 1 / jnp.sqrt(1 + within) if self.shrink else 1.0

        def smooth(key: jax.Array, X: jax.Array) -> jax.Array:
            spread = X + linalg.times_vector(factor, self.draw(key, X.shape, X.dtype))
            return mean[:, None] + together * (spread - mean[:, None]) if self.shrink else spread

        return smooth
