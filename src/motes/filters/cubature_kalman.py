"""Cubature Kalman filter (Arasaratnam, Haykin 2009): moments by the third-degree spherical-radial rule, 2 x points of equal weight.

Predict: mean and covariance of the dynamics over the points, plus noise. Correct: Kalman gain from the covariances of state and
measurement over the points of the prediction. No knobs, and no covariance that is not one.
"""

from typing import Any

import jax

from motes.core.record import record, static
from motes.filters.interface import Guide, Info, TwoStageFilter, single
from motes.filters.needs import as_moment_model
from motes.laws.gaussian import Gaussian
from motes.models import sigma_points
from motes.models.state_space import StateSpaceModel


@record
class CubatureKalmanFilter(TwoStageFilter):
    """Cubature Kalman filter; its state is a `Gaussian`.

    Attributes:
        gate: share of measurements that lie inside the gate where the filter's claims are right, such as 0.9999; one outside is not used,
            and counts in `info.gated`. None for no gate.
    """

    weighs = False
    subtracts = True
    guide = Guide(
        needs="mean functions, noises with covariances",
        cost="x^3, and 2 x + 1 calls of each function",
        use="as UnscentedKalmanFilter, without knobs to set",
    )

    gate: float | None = static(default=None, kw_only=True)

    def prepare(self, model: Any, u: Any) -> StateSpaceModel:
        """Ask for means and covariances of dynamics and sensor.

        Raises:
            MotesError: one of them is a Custom conditional.
        """
        return as_moment_model("CubatureKalmanFilter", model)

    def init(self, key: jax.Array, model: StateSpaceModel) -> Gaussian:
        """Return the Gaussian with the moments of the initial law."""
        return Gaussian(model.initial.mean(), model.initial.cov())

    def predict(self, key: jax.Array, model: StateSpaceModel, state: Gaussian, u: Any, t: Any) -> Gaussian:
        """Move mean and covariance to time t."""
        return sigma_points.moved(model.dynamics, sigma_points.cubature(model.size), state, u, t)

    def correct(self, key: jax.Array, model: StateSpaceModel, state: Gaussian, y: jax.Array, u: Any, t: Any) -> tuple[Gaussian, Info]:
        """Condition on y."""
        done = sigma_points.measured(model.sensor, sigma_points.cubature(model.size), state, y, u, t)
        return done.law, single(done)
