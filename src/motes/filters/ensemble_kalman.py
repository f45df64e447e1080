"""Ensemble Kalman filter (Evensen 1994): a Kalman correction whose covariances are those of n members.

1. Predict: move each member by the dynamics, noise included, and spread the members about their mean by the inflation.
2. S = C_yy + R and the gain K = C_xy S^-1, with the sample covariances of members x and their predicted measurements y.
3. Stochastic: x_i <- x_i + K (y + e_i - y_i) with e_i drawn from N(0, R) (Burgers, van Leeuwen, Evensen 1998). Deterministic: K moves the
   mean, and a smaller gain the deviations, so that the covariance is the same without draws (Whitaker, Hamill 2002, equation 10).
"""

from typing import Any

import jax
import jax.numpy as jnp

from motes.core import checks, linalg, random, sums
from motes.core.record import record, replace, static
from motes.filters.gated import Gated
from motes.filters.info import Info, single
from motes.filters.interface import Guide, TwoStageFilter
from motes.filters.needs import as_moment_model
from motes.laws.cloud import Cloud
from motes.laws.conditional import matrix_over, over_particles
from motes.laws.density import among, log_normal, max_log_normal, measured_in, noiseless, zeroed
from motes.laws.gaussian import Correction
from motes.models.state_space import StateSpaceModel


@record
class EnsembleKalmanFilter(Gated, TwoStageFilter[Cloud]):
    """Ensemble Kalman filter; its state is a `Cloud` of members of equal weight.

    Source: Evensen 1994, Sequential data assimilation with a nonlinear quasi-geostrophic model using Monte Carlo methods to forecast
    error statistics.

    Example:
        >>> model = mo.textbook.radar_tracking()
        >>> xs, ys = mo.simulate(0, model, 50)
        >>> mo.run(1, mo.EnsembleKalmanFilter(n=200), model, ys).mean.shape
        (50, 6)

    Attributes:
        n: number of members.
        form: "deterministic" (square root) or "stochastic" (perturbed measurements).
        inflation: factor on the deviations of members from their mean after each prediction; a little above 1 makes up for the
            covariance that few members miss.
    """

    weighs = False
    descends = False
    guide = Guide(
        needs="dynamics that can be drawn from, a sensor with a mean function and a noise covariance",
        cost="n calls of each function",
        use="many states, nearly linear, a covariance too large to carry",
    )

    n: int = static()
    form: str = static(default="deterministic")
    inflation: float = 1.0

    def check_parameters(self) -> None:
        """Check the parameters.

        Raises:
            MotesError: a number is not positive, or the form is unknown.
        """
        checks.positive_integer("EnsembleKalmanFilter n", self.n)
        checks.option("EnsembleKalmanFilter form", self.form, ("deterministic", "stochastic"))
        checks.above_zero("EnsembleKalmanFilter inflation", self.inflation)

    def prepare(self, model: Any, u: Any) -> StateSpaceModel:
        """Ask for means and covariances of dynamics and sensor.

        Raises:
            MotesError: one of them is a Custom conditional.
        """
        return as_moment_model("EnsembleKalmanFilter", model)

    def init(self, key: jax.Array, model: StateSpaceModel) -> Cloud:
        """Draw n members from the initial law."""
        return Cloud.equal(model.initial.sample(key, self.n))

    def predict(self, key: jax.Array, model: StateSpaceModel, state: Cloud, u: Any, t: Any) -> Cloud:
        """Move each member to time t, and inflate (step 1)."""
        moved = replace(state, particles=model.dynamics.sample(random.child(key, random.NOISE), state.particles, u, t))
        members = moved.gathered(model.circular).particles
        middle = jnp.mean(members, axis=1, keepdims=True)
        return replace(state, particles=middle + self.inflation * (members - middle))

    def correct(self, key: jax.Array, model: StateSpaceModel, state: Cloud, y: jax.Array, u: Any, t: Any) -> tuple[Cloud, Info]:
        """Move the members by y (steps 2 and 3)."""
        sensor, X = model.sensor, state.particles
        middle = jnp.mean(X, axis=1)
        anchor = sensor.mean(middle, u, t)
        # differences from one point, so that angles average across the cut
        off = sensor.residual(over_particles(sensor.mean, X, u, t), anchor[:, None])
        shift = jnp.mean(off, axis=1)
        innovation = sensor.residual(y, anchor + shift)
        R = matrix_over(sensor.cov, X, u, t)
        R = jnp.mean(R, axis=2) if R.ndim == 3 else R
        seen = measured_in(y, R)
        R = among(R, seen)
        # 2. sample covariances, and the gain by a factor U of S
        dY, dX = zeroed(off - shift[:, None], seen), X - middle[:, None]
        degrees = max(self.n - 1, 1)
        S = sums.by_blocks(linalg.product_transposed, dY, dY) / degrees + R
        U, C_yx = linalg.cholesky(S), sums.by_blocks(linalg.product_transposed, dY, dX) / degrees
        # 3. move the members
        if self.form == "stochastic":
            K = linalg.transpose(linalg.solve(U, C_yx))
            pulls = zeroed(innovation, seen)[:, None] + self._perturbations(key, R, seen) - dY
            after = X + linalg.times_vector(K, pulls)
        else:
            # K = C_xy U^-T U^-1 and for deviations C_xy U^-T (U + V)^-1, with U and V the factors of S and R
            half = linalg.solve_lower(U, C_yx)
            moved = linalg.times_vector(linalg.transpose(half), linalg.solve_lower(U, zeroed(innovation, seen)))
            less = linalg.times_vector(linalg.transpose(half), linalg.solve_lower(U + linalg.cholesky(R), dY))
            after = X + moved[:, None] - less
        log_evidence, max_log_evidence = log_normal(innovation, S, seen, jnp.abs(y), noiseless(R)), max_log_normal(innovation, S, seen)
        info = single(Correction(None, log_evidence, max_log_evidence, jnp.sum(seen)))
        return replace(state, particles=after), replace(info, ess=jnp.full((), self.n, X.dtype))

    def _perturbations(self, key: jax.Array, R: jax.Array, seen: jax.Array) -> jax.Array:
        """Draw noise of covariance R for each member, `(y, n)`; a missing component uses no numbers, as if the model did not have it."""
        noise = random.normal(key, (R.shape[0], self.n), R.dtype)[jnp.maximum(jnp.cumsum(seen) - 1, 0)]
        return zeroed(linalg.times_vector(linalg.cholesky(R), zeroed(noise, seen)), seen)
