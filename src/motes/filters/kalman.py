"""Kalman filter (Kalman 1960): exact for linear models with Gaussian noise.

Predict: mean <- A mean, P <- A P A' + Q. Correct: condition on y = H x + e (`Gaussian.corrected`, Joseph form).
"""

from typing import Any

import jax

from motes.core.record import record, static
from motes.filters.interface import Guide, Info, TwoStageFilter, single
from motes.filters.needs import as_linear_model
from motes.laws.gaussian import Gaussian
from motes.models import linearize
from motes.models.state_space import StateSpaceModel


@record
class KalmanFilter(TwoStageFilter):
    """Kalman filter; its state is a `Gaussian`. Functions that are linear need not be written as matrices: tracing finds out.

    Attributes:
        gate: share of measurements that lie inside the gate where the filter's claims are right, such as 0.9999; one outside is not used,
            and counts in `info.gated`. None for no gate.
    """

    weighs = False
    subtracts = True
    guide = Guide(
        needs="a linear model with Gaussian noises and initial law",
        cost="x^3",
        use="the model is linear: nothing beats it",
    )

    gate: float | None = static(default=None, kw_only=True)

    def prepare(self, model: Any, u: Any) -> StateSpaceModel:
        """Ask for a model that is linear in every state, with Gaussian noises and initial law.

        Raises:
            MotesError: it is not; the message names a state and the reason.
        """
        return as_linear_model("KalmanFilter", model, u)

    def init(self, key: jax.Array, model: StateSpaceModel) -> Gaussian:
        """Return the initial law."""
        return Gaussian(model.initial.mean(), model.initial.cov())

    def predict(self, key: jax.Array, model: StateSpaceModel, state: Gaussian, u: Any, t: Any) -> Gaussian:
        """Move mean and covariance to time t."""
        return linearize.moved(model.dynamics, state, u, t)

    def correct(self, key: jax.Array, model: StateSpaceModel, state: Gaussian, y: jax.Array, u: Any, t: Any) -> tuple[Gaussian, Info]:
        """Condition on y."""
        done = linearize.measured(model.sensor, state, y, u, t)
        return done.law, single(done)
