"""Square-root Kalman filter (Potter 1963; Kailath, Sayed, Hassibi 2000, chapter 12): the Kalman filter on a factor of the covariance.

1. Predict: P = L L' goes over to the triangle of [A L, Q^1/2] (`FactoredGaussian.moved`).
2. Correct: by the triangle of [R^1/2, H L; 0, L] (`FactoredGaussian.corrected`).

No covariance is formed, so that none can become indefinite; it works where variances differ by more than the digits of float32 can hold.
"""

from typing import Any

import jax
import jax.numpy as jnp

from motes.core.record import record
from motes.filters.gated import Gated
from motes.filters.info import Info, single
from motes.filters.interface import Guide, TwoStageFilter
from motes.filters.needs import as_linear_model
from motes.gaussian.taylor import affine
from motes.laws.density import measured_in
from motes.laws.factored import FactoredGaussian
from motes.models.state_space import StateSpaceModel


@record
class SquareRootKalmanFilter(Gated, TwoStageFilter[FactoredGaussian]):
    """Square-root Kalman filter; its state is a `FactoredGaussian`.

    Source: Potter 1963, New statistical formulas; Kailath, Sayed, Hassibi 2000, Linear Estimation.

    Example:
        >>> model = mo.textbook.constant_velocity()
        >>> xs, ys = mo.simulate(0, model, 50)
        >>> mo.run(1, mo.SquareRootKalmanFilter(), model, ys).mean.shape
        (50, 4)
    """

    weighs = False
    light = True
    guide = Guide(
        needs="a linear model with Gaussian noises and initial law",
        cost="x^3, a few times what KalmanFilter takes",
        use="the model is linear and badly scaled, in float32",
    )

    def prepare(self, model: Any, u: Any) -> StateSpaceModel:
        """Ask for a model that is linear in every state, with Gaussian noises and initial law.

        Raises:
            MotesError: it is not; the message names a state and the reason.
        """
        return as_linear_model("SquareRootKalmanFilter", model, u)

    def init(self, key: jax.Array, model: StateSpaceModel) -> FactoredGaussian:
        """Return the initial law."""
        return FactoredGaussian.of(model.initial)

    def predict(self, key: jax.Array, model: StateSpaceModel, state: FactoredGaussian, u: Any, t: Any) -> FactoredGaussian:
        """Move mean and factor to time t (step 1)."""
        return state.moved(*affine(model.dynamics, state.center, u, t))

    def correct(
        self, key: jax.Array, model: StateSpaceModel, state: FactoredGaussian, y: jax.Array, u: Any, t: Any
    ) -> tuple[FactoredGaussian, Info]:
        """Condition on y (step 2)."""
        prediction, H, R = affine(model.sensor, state.center, u, t)
        seen = measured_in(y, R)
        done = state.corrected(model.sensor.residual(y, prediction), H, R, seen)
        return done.law, single(done._replace(count=jnp.sum(seen)))
