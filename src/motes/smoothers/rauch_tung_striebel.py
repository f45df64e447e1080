"""Rauch-Tung-Striebel smoother (1965), for what a Kalman filter of any kind has filtered.

Backward over the steps, with the dynamics near the filtered mean m replaced by x' = c + F (x - m) + noise of covariance Q:

    G = P F' (F P F' + Q)^-1
    mean <- m + G (mean' - c),   cov <- (1 - G F) P (1 - G F)' + G (Q + cov') G'

F is the slope at m (exact for linear models, the extended smoother elsewhere), or that of the plane through sigma points (Sarkka 2008).
"""

from typing import Any

import jax
import jax.numpy as jnp

from motes.core import checks, linalg
from motes.core.record import record, static
from motes.filters.history import History
from motes.filters.needs import as_moment_model
from motes.laws.gaussian import Gaussian
from motes.models import linearize, sigma_points
from motes.models.state_space import StateSpaceModel, at_step
from motes.smoothers.interface import Smoothed, Smoother, Steps


@record
class RauchTungStriebelSmoother(Smoother):
    """Rauch-Tung-Striebel smoother; it works with the moments of a filter whose state is a `Gaussian`.

    Attributes:
        slope: of the dynamics: "jacobian" at the filtered mean (the Kalman and the extended smoother), or "sigma", that of the plane
            through 2 x sigma points (the unscented smoother).
    """

    slope: str = static(default="jacobian")

    def check_knobs(self) -> None:
        """Check the knobs.

        Raises:
            MotesError: the slope is neither.
        """
        checks.option("RauchTungStriebelSmoother slope", self.slope, ("jacobian", "sigma"))

    def prepare(self, model: Any, history: History, u: Any) -> StateSpaceModel:
        """Ask for Gaussian laws, and for mean and covariance of the dynamics.

        Raises:
            MotesError: one is missing.
        """
        if not isinstance(history.state, Gaussian):
            checks.refuse("RauchTungStriebelSmoother history", "laws of the kind Gaussian", type(history.state).__name__,
                          "Use BackwardSimulationSmoother for clouds.")
        return as_moment_model("RauchTungStriebelSmoother", model)

    def smooth(self, key: jax.Array, model: StateSpaceModel, history: History, steps: Steps) -> Smoothed:
        """Go backward from the last law."""

        def back(after: Gaussian, row: Any) -> tuple[Gaussian, tuple[jax.Array, jax.Array]]:
            mean, cov, u, t = row
            before = Gaussian(mean, cov)
            if self.slope == "sigma":
                prediction, F, Q = sigma_points.affine(model.dynamics, sigma_points.cubature(model.size), before, u, t)
            else:
                prediction, F, Q = linearize.affine(model.dynamics, mean, u, t)
            cross = linalg.product(F, cov)
            factor = linalg.cholesky(linalg.symmetric(linalg.product_transposed(cross, F) + Q))
            G = linalg.transpose(linalg.solve(factor, cross))
            kept = linalg.identity_like(cov) - linalg.product(G, F)
            now = Gaussian(
                mean + linalg.times_vector(G, model.dynamics.residual(after.center, prediction)),
                linalg.sandwich(kept, cov) + linalg.sandwich(G, Q + after.covariance),
            )
            return now, (now.center, now.covariance)

        moments = (history.mean, history.cov)
        rows = *(leaf[:-1] for leaf in moments), *jax.tree.map(lambda leaf: leaf[1:], (steps.u, steps.t))
        last = at_step(moments, -1)
        _, earlier = jax.lax.scan(back, Gaussian(*last), rows, reverse=True)
        mean, cov = (jnp.concatenate([some, one[None]]) for some, one in zip(earlier, last, strict=True))
        return Smoothed(mean, cov)
