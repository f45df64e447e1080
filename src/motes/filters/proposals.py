"""Importance densities q(x_t | x_{t-1}, y_t): where particles go once the measurement is known (Doucet, Godsill, Andrieu 2000).

A local proposal works in the normal numbers v of a particle's step x' = f(x) + L v, L L' = Q:

1. Replace the model about each particle by a linear-Gaussian one: y is about h + T v + e, e of covariance R.
2. Draw v given y, and move the particle to f(x) + L v.
3. Multiply the weight by p(y | x') p(v) / q(v), where p(v) / q(v) is the local evidence N(y; h, T T' + R) over N(y; h + T v, R).

It never leaves the span of the process noise, so that a singular Q, a state without noise, needs nothing of its own: densities are those
of v, and a number v_i that moves nothing has the same density before and after.
"""

from abc import ABC, abstractmethod
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from motes.core import checks, linalg, random
from motes.core.record import record
from motes.gaussian.sigma_points import regressed_on
from motes.gaussian.taylor import affine
from motes.laws.conditional import AdditiveGaussian, Conditional, matrix_over, over_particles
from motes.laws.density import among, log_normal, max_log_normal, noiseless
from motes.laws.gaussian import Gaussian
from motes.laws.observed import value_of
from motes.models.correlated import users
from motes.models.state_space import StateSpaceModel
from motes.models.structure import trace


class Proposed(NamedTuple):
    """Particles moved by a proposal.

    Attributes:
        particles: `(x, n)`.
        log_weight: log of p(y | x') p(x' | x) / q(x' | x, y), `(n,)`.
        max_log_weight: what `log_weight` would be if y and the step fitted perfectly, `()` or `(n,)`; infinite when not known.
    """

    particles: jax.Array
    log_weight: jax.Array
    max_log_weight: jax.Array


class Proposal(ABC):
    """A way to move particles once the measurement is known."""

    def check(self, asked_by: str, model: StateSpaceModel, u: Any) -> None:  # noqa: B027 (most models will do for some proposals)
        """Refuse models that the proposal is not made for.

        Raises:
            MotesError: the message names what is missing and what to use instead.
        """

    @abstractmethod
    def proposed(self, key: jax.Array, model: StateSpaceModel, X: jax.Array, y: jax.Array, u: Any, t: Any) -> Proposed:
        """Move particles `(x, n)` of the step before to time t, given the measurement `(y,)`; NaN means not measured."""

    def score(self, model: StateSpaceModel, X: jax.Array, y: jax.Array, u: Any, t: Any) -> jax.Array:
        """Log of an estimate of p(y | x) for particles `(x, n)` of the step before, `(n,)`.

        Here it is p(y | mean of x') (Pitt, Shephard 1999).
        """
        return model.sensor.log_prob(y, over_particles(model.dynamics.mean, X, u, t), u, t)


@record
class PriorProposal(Proposal):
    """The dynamics: the measurement is not looked at."""

    def proposed(self, key: jax.Array, model: StateSpaceModel, X: jax.Array, y: jax.Array, u: Any, t: Any) -> Proposed:
        """See `Proposal`."""
        moved = model.dynamics.sample(key, X, u, t)
        return Proposed(moved, model.sensor.log_prob(y, moved, u, t), model.sensor.max_log_prob(y, moved, u, t))


@record
class GivenProposal(Proposal):
    """A proposal of the user's.

    Attributes:
        law: law of x_t given x_{t-1} and y_t: a conditional whose functions get the pair `(u, y)` for inputs.
    """

    law: Conditional

    def proposed(self, key: jax.Array, model: StateSpaceModel, X: jax.Array, y: jax.Array, u: Any, t: Any) -> Proposed:
        """See `Proposal`."""
        inputs = (users(u), value_of(y))
        moved = self.law.sample(key, X, inputs, t)
        log_q = self.law.log_prob(moved, X, inputs, t)
        log_weight = model.sensor.log_prob(y, moved, u, t) + model.dynamics.log_prob(moved, X, u, t) - log_q
        max_log_weight = model.sensor.max_log_prob(y, moved, u, t) + model.dynamics.max_log_prob(moved, X, u, t) - log_q
        return Proposed(moved, log_weight, max_log_weight)


class Local(NamedTuple):
    """The model about each particle: x' = center + spread v, and y = prediction + slope v + e, with v standard normal.

    Attributes:
        center: f(x), `(x, n)`.
        spread: L, lower factor of the process noise covariance, `(x, x, *n)`.
        innovation: y - h, `(y, n)`.
        slope: T, slope in v, `(y, x, *n)`.
        noise: R, covariance of e, `(y, y, *n)`.
        seen: components of y that count, `(y,)`.
        size: how large the numbers are whose difference the innovation is, `(y,)`.
    """

    center: jax.Array
    spread: jax.Array
    innovation: jax.Array
    slope: jax.Array
    noise: jax.Array
    seen: jax.Array
    size: jax.Array

    def evidence(self) -> tuple[jax.Array, jax.Array]:
        """Log density of y before v is known, and the same for a perfect prediction, `(n,)`."""
        cov = linalg.add(linalg.product_transposed(self.slope, self.slope), self.noise)
        density = log_normal(self.innovation, cov, self.seen, self.size, noiseless(among(self.noise, self.seen)))
        return density, max_log_normal(self.innovation, cov, self.seen)

    def residual(self, v: jax.Array) -> jax.Array:
        """What v `(x, n)` leaves of the innovation, `(y, n)`."""
        return self.innovation - linalg.times_vector(self.slope, v)

    def drawn(self, key: jax.Array) -> jax.Array:
        """Draw v given y, `(x, n)`: a draw of v and e before y, corrected by what they leave of y. No factor of a covariance is needed."""
        size, n = self.center.shape
        numbers = random.normal(key, (size + self.innovation.shape[0], n), self.center.dtype)
        v, e = numbers[:size], linalg.times_vector(linalg.cholesky(self.noise), numbers[size:])
        unit = jnp.eye(size, dtype=v.dtype)
        return Gaussian(v, unit).corrected(self.residual(v) - e, self.slope, self.noise, self.seen).law.center

    def moved(self, v: jax.Array) -> jax.Array:
        """Return x', `(x, n)`."""
        return self.center + linalg.times_vector(self.spread, v)


class LocalProposal(Proposal):
    """A proposal from a linear-Gaussian model about each particle; subclasses say which."""

    @abstractmethod
    def about(self, model: StateSpaceModel, X: jax.Array, y: jax.Array, u: Any, t: Any) -> Local:
        """Return the model about each particle `(x, n)`."""

    def check(self, asked_by: str, model: StateSpaceModel, u: Any) -> None:
        """Ask for additive Gaussian noise of the dynamics, and for a sensor with moments.

        Raises:
            MotesError: one is missing.
        """
        name = type(self).__name__
        if not isinstance(model.dynamics, AdditiveGaussian):
            checks.refuse(f"{asked_by} dynamics", f"additive Gaussian noise ({name} bends it)", type(model.dynamics).__name__,
                          "Use no proposal, or a conditional of your own.")
        if not model.sensor.has_moments:
            checks.refuse(f"{asked_by} sensor", f"a mean function and a noise covariance ({name} looks at them)",
                          type(model.sensor).__name__, "Use no proposal, or a conditional of your own.")

    def proposed(self, key: jax.Array, model: StateSpaceModel, X: jax.Array, y: jax.Array, u: Any, t: Any) -> Proposed:
        """See `Proposal`; p(v) / q(v) is the local evidence over the local likelihood."""
        # 1. local model
        local = self.about(model, X, y, u, t)
        # 2. draw and move
        v = local.drawn(key)
        moved = local.moved(v)
        # 3. weight
        ratio = local.evidence()[0] - log_normal(local.residual(v), local.noise, local.seen, local.size)
        max_log_weight = model.sensor.max_log_prob(y, moved, u, t) + 0.5 * jnp.sum(v**2, axis=0) + ratio
        return Proposed(moved, model.sensor.log_prob(y, moved, u, t) + ratio, max_log_weight)

    def score(self, model: StateSpaceModel, X: jax.Array, y: jax.Array, u: Any, t: Any) -> jax.Array:
        """See `Proposal`; here the local evidence."""
        return self.about(model, X, y, u, t).evidence()[0]


@record
class OptimalProposal(LocalProposal):
    """The exact p(x_t | x_{t-1}, y_t), for additive Gaussian dynamics and a sensor that is linear in the states with Gaussian noise.

    A weight is multiplied by p(y_t | x_{t-1}), whatever was drawn: of all proposals the one with the least varying weights (Doucet,
    Godsill, Andrieu 2000). The dynamics may be nonlinear.
    """

    def check(self, asked_by: str, model: StateSpaceModel, u: Any) -> None:
        """Ask for such a model.

        Raises:
            MotesError: it is not; the message names the reason.
        """
        LocalProposal.check(self, asked_by, model, u)
        reason = _not_linear(model, u)
        if reason:
            checks.refuse(f"{asked_by} sensor", "one that is linear-Gaussian in the states (OptimalProposal is exact)", reason,
                          "Use ExtendedKalmanProposal or UnscentedProposal.")

    def about(self, model: StateSpaceModel, X: jax.Array, y: jax.Array, u: Any, t: Any) -> Local:
        """See `LocalProposal`."""
        return _linearized(model, X, y, u, t)

    def proposed(self, key: jax.Array, model: StateSpaceModel, X: jax.Array, y: jax.Array, u: Any, t: Any) -> Proposed:
        """See `Proposal`."""
        local = self.about(model, X, y, u, t)
        return Proposed(local.moved(local.drawn(key)), *local.evidence())


@record
class ExtendedKalmanProposal(LocalProposal):
    """The extended Kalman filter's p(x_t | x_{t-1}, y_t): the sensor by its slope at f(x) (Doucet, Godsill, Andrieu 2000).

    Where the sensor is linear this is the exact law. The sensor's noise may have any law with a variance; components of it that have none
    do not guide.
    """

    def about(self, model: StateSpaceModel, X: jax.Array, y: jax.Array, u: Any, t: Any) -> Local:
        """See `LocalProposal`."""
        return _linearized(model, X, y, u, t)


@record
class UnscentedProposal(LocalProposal):
    """The unscented p(x_t | x_{t-1}, y_t): the sensor regressed over sigma points of each step.

    Source: van der Merwe, Doucet, de Freitas, Wan 2000, with the noise of one step in place of a covariance carried by each particle.

    What the regression leaves unexplained is added to R, which makes it wider and safer than `ExtendedKalmanProposal`, for 2 x + 1 calls
    of the sensor per particle. Noises are as there.
    """

    def about(self, model: StateSpaceModel, X: jax.Array, y: jax.Array, u: Any, t: Any) -> Local:
        """See `LocalProposal`."""
        sensor, seen = _gaussian(model.sensor, y)
        center, spread = _step(model, X, u, t)
        found = regressed_on(sensor, range(X.shape[0]), center, spread, u, t)
        noise = linalg.add(found.unexplained, matrix_over(sensor.Q, center, u, t))
        return Local(center, spread, sensor.residual(y, found.prediction), found.scaled_slope, noise, seen, jnp.abs(y))


def as_proposal(argument: str, value: Any) -> Proposal:
    """Return a proposal from one, a conditional, or None for the dynamics.

    Raises:
        MotesError: the value is none of them.
    """
    if value is None:
        return PriorProposal()
    if isinstance(value, Conditional):
        return GivenProposal(value)
    if not isinstance(value, Proposal):
        checks.refuse(argument, "a proposal such as OptimalProposal(), or a conditional such as AdditiveGaussian", type(value).__name__)
    return value


def _step(model: StateSpaceModel, X: jax.Array, u: Any, t: Any) -> tuple[jax.Array, jax.Array]:
    """Mean `(x, n)` and factor of the noise covariance `(x, x, *n)` of the step of each particle."""
    dynamics: AdditiveGaussian = model.dynamics  # type: ignore[assignment]
    return dynamics.means(X, u, t), linalg.cholesky(matrix_over(dynamics.Q, X, u, t))


def _gaussian(sensor: Conditional, y: jax.Array) -> tuple[AdditiveGaussian, jax.Array]:
    """Return the sensor with Gaussian noise of the same moments, and the components of y that are there and have a variance, `(y,)`."""
    if isinstance(sensor, AdditiveGaussian):
        return sensor, ~jnp.isnan(y)
    cov = getattr(sensor, "law").cov().astype(y.dtype)  # noqa: B009
    known = jnp.isfinite(jnp.diagonal(cov))
    return AdditiveGaussian(sensor.mean, jnp.where(known[:, None] & known, cov, 0), sensor.angles), known & ~jnp.isnan(y)


def _linearized(model: StateSpaceModel, X: jax.Array, y: jax.Array, u: Any, t: Any) -> Local:
    sensor, seen = _gaussian(model.sensor, y)
    center, spread = _step(model, X, u, t)
    slope = matrix_over(lambda x, u, t: affine(sensor, x, u, t).slope, center, u, t)
    innovation = sensor.residual(y, sensor.means(center, u, t))
    return Local(center, spread, innovation, linalg.product(slope, spread), matrix_over(sensor.Q, center, u, t), seen, jnp.abs(y))


def _not_linear(model: StateSpaceModel, u: Any) -> str:
    """Say why a sensor is not linear-Gaussian in the states; empty where it is."""
    sensor = model.sensor
    if not isinstance(sensor, AdditiveGaussian):
        return type(sensor).__name__
    if sensor.angles:
        return "angles among its components (they are wrapped)"
    traced = trace(model, u)
    for _, i, j in np.argwhere(traced.slope_pairs["sensor"][:, : model.size, : model.size]):
        return f"one that is nonlinear in {model.names[i]}" + (f" and {model.names[j]}" if i != j else "")
    for i in np.flatnonzero(traced.noise_uses["sensor"][: model.size]):
        return f"one whose noise covariance depends on {model.names[i]}"
    return ""
