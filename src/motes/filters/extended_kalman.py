"""Extended Kalman filter: the Kalman filter on the model linearized at its own estimate (Jacobians by automatic differentiation).

Predict: the mean goes through f, the covariance through the slope F of f there: P <- F P F' + Q. Correct: condition on the innovation
y - h(mean) with the slope H of h there. On a linear model it is the Kalman filter. With iterations the sensor is linearized again where
the last correction led (Bell, Cathey 1993: Gauss-Newton steps towards the most probable state).
"""

from typing import Any

import jax

from motes.core import checks
from motes.core.record import record, static
from motes.filters.interface import Guide, Info, TwoStageFilter, single
from motes.filters.needs import as_moment_model
from motes.laws.gaussian import Gaussian
from motes.models import linearize
from motes.models.state_space import StateSpaceModel


@record
class ExtendedKalmanFilter(TwoStageFilter):
    """Extended Kalman filter; its state is a `Gaussian`.

    Attributes:
        iterations: linearizations of the sensor in a correction; 1 is the plain filter, more the iterated one. Steps are not damped.
        gate: share of measurements that lie inside the gate where the filter's claims are right, such as 0.9999; one outside is not used,
            and counts in `info.gated`. None for no gate.
    """

    weighs = False
    subtracts = True
    guide = Guide(
        needs="mean functions with slopes, noises with covariances",
        cost="x^3, and a Jacobian of each function",
        use="one mode, functions that bend little within the uncertainty",
    )

    iterations: int = static(default=1)
    gate: float | None = static(default=None, kw_only=True)

    def check_knobs(self) -> None:
        """Check the knobs.

        Raises:
            MotesError: iterations is not a positive whole number.
        """
        checks.positive_integer("ExtendedKalmanFilter iterations", self.iterations)

    def prepare(self, model: Any, u: Any) -> StateSpaceModel:
        """Ask for means and covariances of dynamics and sensor.

        Raises:
            MotesError: one of them is a Custom conditional.
        """
        return as_moment_model("ExtendedKalmanFilter", model)

    def init(self, key: jax.Array, model: StateSpaceModel) -> Gaussian:
        """Return the Gaussian with the moments of the initial law."""
        return Gaussian(model.initial.mean(), model.initial.cov())

    def predict(self, key: jax.Array, model: StateSpaceModel, state: Gaussian, u: Any, t: Any) -> Gaussian:
        """Move mean and covariance to time t."""
        return linearize.moved(model.dynamics, state, u, t)

    def correct(self, key: jax.Array, model: StateSpaceModel, state: Gaussian, y: jax.Array, u: Any, t: Any) -> tuple[Gaussian, Info]:
        """Condition on y."""
        done = linearize.measured(model.sensor, state, y, u, t, self.iterations)
        return done.law, single(done)
