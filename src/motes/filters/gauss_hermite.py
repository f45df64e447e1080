"""Gauss-Hermite filter (Ito, Xiong 2000): moments by Gauss-Hermite quadrature, degree^x points.

Predict: mean and covariance of the dynamics over the points, plus noise. Correct: Kalman gain from the covariances of state and
measurement over the points of the prediction.
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

MOST = 100_000
"""More points than this are a particle filter's work."""


@record
class GaussHermiteFilter(TwoStageFilter):
    """Gauss-Hermite filter; its state is a `Gaussian`.

    Attributes:
        degree: points per state, at least 2; moments are exact for polynomials up to the degree 2 `degree` - 1 in each state.
        gate: share of measurements that lie inside the gate where the filter's claims are right, such as 0.9999; one outside is not used,
            and counts in `info.gated`. None for no gate.
    """

    weighs = False
    subtracts = True
    guide = Guide(
        needs="mean functions, noises with covariances",
        cost="degree^x calls of each function",
        use="one mode, few states, strongly bent functions",
    )

    degree: int = static(default=3)
    gate: float | None = static(default=None, kw_only=True)

    def check_knobs(self) -> None:
        """Check the knobs.

        Raises:
            MotesError: the degree is no whole number of at least 2.
        """
        checks.positive_integer("GaussHermiteFilter degree", self.degree)
        if self.degree < 2:
            checks.refuse("GaussHermiteFilter degree", "at least 2 points per state", self.degree)

    def prepare(self, model: Any, u: Any) -> StateSpaceModel:
        """Ask for means and covariances of dynamics and sensor, and for few states.

        Raises:
            MotesError: one of them is a Custom conditional, or there would be more than 100 000 points.
        """
        model = as_moment_model("GaussHermiteFilter", model)
        if self.degree**model.size > MOST:
            hint = "Use CubatureKalmanFilter or UnscentedKalmanFilter."
            checks.refuse("GaussHermiteFilter degree", f"at most {MOST} points", f"{self.degree}^{model.size}", hint)
        return model

    def init(self, key: jax.Array, model: StateSpaceModel) -> Gaussian:
        """Return the Gaussian with the moments of the initial law."""
        return Gaussian(model.initial.mean(), model.initial.cov())

    def predict(self, key: jax.Array, model: StateSpaceModel, state: Gaussian, u: Any, t: Any) -> Gaussian:
        """Move mean and covariance to time t."""
        return sigma_points.moved(model.dynamics, sigma_points.gauss_hermite(model.size, self.degree), state, u, t)

    def correct(self, key: jax.Array, model: StateSpaceModel, state: Gaussian, y: jax.Array, u: Any, t: Any) -> tuple[Gaussian, Info]:
        """Condition on y."""
        done = sigma_points.measured(model.sensor, sigma_points.gauss_hermite(model.size, self.degree), state, y, u, t)
        return done.law, single(done)
