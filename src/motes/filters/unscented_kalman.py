"""Unscented Kalman filter (Julier, Uhlmann 1997; scaled form of Wan, van der Merwe 2000): 2 x + 1 sigma points in place of a Jacobian.

Predict: mean and covariance of the dynamics over the sigma points, plus noise. Correct: Kalman gain from the covariances of state and
measurement over the sigma points of the prediction.
"""

from typing import Any

import jax

from motes.core import checks
from motes.core.record import record, static
from motes.filters.interface import Guide, Info, TwoStageFilter, single
from motes.filters.needs import as_moment_model
from motes.laws.gaussian import Gaussian
from motes.models import sigma_points
from motes.models.state_space import StateSpaceModel


@record
class UnscentedKalmanFilter(TwoStageFilter):
    """Unscented Kalman filter; its state is a `Gaussian`.

    Sigma points lie alpha sqrt(x + kappa) standard deviations from the mean. The defaults never give a negative variance.

    Attributes:
        alpha: spread of the points, above 0. Small ones read the slope at the mean, and need float64 below about 1e-2.
        beta: what is known of the fourth moments; 2 suits Gaussians.
        kappa: second scaling, above -x; with alpha = 1 and beta = 0, 3 - x makes fourth moments right along each axis.
        gate: share of measurements that lie inside the gate where the filter's claims are right, such as 0.9999; one outside is not used,
            and counts in `info.gated`. None for no gate.
    """

    weighs = False
    subtracts = True
    guide = Guide(
        needs="mean functions, noises with covariances",
        cost="x^3, and 2 x + 1 calls of each function",
        use="one mode, functions that bend within the uncertainty or have no slopes",
    )

    alpha: float = static(default=1.0)
    beta: float = static(default=2.0)
    kappa: float = static(default=0.0)
    gate: float | None = static(default=None, kw_only=True)

    def check_knobs(self) -> None:
        """Check the knobs.

        Raises:
            MotesError: alpha is not above 0.
        """
        checks.above_zero("UnscentedKalmanFilter alpha", self.alpha)

    def prepare(self, model: Any, u: Any) -> StateSpaceModel:
        """Ask for means and covariances of dynamics and sensor.

        Raises:
            MotesError: one of them is a Custom conditional, or kappa is too small for the model.
        """
        model = as_moment_model("UnscentedKalmanFilter", model)
        if not model.size + self.kappa > 0:
            checks.refuse("UnscentedKalmanFilter kappa", f"a number above -{model.size} (minus the number of states)", self.kappa)
        return model

    def _rule(self, model: StateSpaceModel) -> sigma_points.SigmaPoints:
        return sigma_points.unscented(model.size, self.alpha, self.beta, self.kappa)

    def init(self, key: jax.Array, model: StateSpaceModel) -> Gaussian:
        """Return the Gaussian with the moments of the initial law."""
        return Gaussian(model.initial.mean(), model.initial.cov())

    def predict(self, key: jax.Array, model: StateSpaceModel, state: Gaussian, u: Any, t: Any) -> Gaussian:
        """Move mean and covariance to time t."""
        return sigma_points.moved(model.dynamics, self._rule(model), state, u, t)

    def correct(self, key: jax.Array, model: StateSpaceModel, state: Gaussian, y: jax.Array, u: Any, t: Any) -> tuple[Gaussian, Info]:
        """Condition on y."""
        done = sigma_points.measured(model.sensor, self._rule(model), state, y, u, t)
        return done.law, single(done)
