"""Rauch-Tung-Striebel smoother (1965), for what a Kalman filter of any kind has filtered.

Backward over the steps, from the filtered N(m, P) and the smoothed mean+ and cov+ of the next step:

1. Replace the dynamics near m by x' = c + F (x - m) + noise of covariance Q. F, c and Q are what a rule for moments makes of them over
   N(m, P): the slope at m (exact for linear models, the extended smoother elsewhere), or the regression over sigma points (Sarkka 2008).
2. Gain: G = P F' (F P F' + Q)^-1.
3. mean <- m + G (mean+ - c),   cov <- P - G (F P F' + Q) G' + G cov+ G'.

All covariances are held by factors, P = U U' and cov+ = C C', in the manner of Park and Kailath (1995, Square-root RTS smoothing
algorithms): one triangle gives the gain and what it leaves,

    [F U, Q^1/2; U, 0] = [X, 0; Y, D] (orthogonal),   G = Y X^-1,   cov = D D' + (G C) (G C)'

so that a predicted covariance that is singular, or nearly so, costs few digits. A direction in which X has no length is one that the
prediction knows already, and is left alone. So is one in which X^-1 C is below 1 by no more than the rounding of the filtered
covariance: what it says there of the future is noise, and backward over many steps such factors multiply up.
"""

from typing import Any

import jax
import jax.numpy as jnp

from motes.core import linalg
from motes.core.record import record
from motes.filters.history import History
from motes.filters.needs import as_moment_model
from motes.gaussian.rule import Rule, check_rule
from motes.gaussian.taylor import Taylor
from motes.laws.factored import FactoredGaussian
from motes.laws.gaussian import Gaussian
from motes.models.state_space import StateSpaceModel, at_step
from motes.smoothers.interface import Smoothed, Smoother, Steps, ask_kind

_ROUNDING = 4.0


@record
class RauchTungStriebelSmoother(Smoother):
    """Rauch-Tung-Striebel smoother; it works with the moments of a filter whose state is a `Gaussian` or a `FactoredGaussian`.

    Source: Rauch, Tung, Striebel 1965, Maximum likelihood estimates of linear dynamic systems.

    Example:
        >>> model = mo.textbook.constant_velocity()
        >>> xs, ys = mo.simulate(0, model, 50)
        >>> history = mo.run(1, mo.KalmanFilter(), model, ys)
        >>> mo.smooth(2, mo.smoothers.RauchTungStriebelSmoother(), model, history).mean.shape
        (50, 4)

    Attributes:
        rule: how a filtered Gaussian is taken through the dynamics, best by the rule of the filter: `mo.gaussian.Taylor()` (the Kalman
            and the extended smoother), or sigma points such as `mo.gaussian.Cubature()`.
    """

    rule: Rule = Taylor()
    subtracts = True

    def check_parameters(self) -> None:
        """Check the parameters.

        Raises:
            MotesError: the rule is none, or has a parameter that it cannot have.
        """
        check_rule("RauchTungStriebelSmoother", self.rule)

    def prepare(self, model: Any, history: History, u: Any) -> StateSpaceModel:
        """Ask for Gaussian laws, and for mean and covariance of the dynamics.

        Raises:
            MotesError: one is missing.
        """
        ask_kind("RauchTungStriebelSmoother", history, Gaussian, FactoredGaussian)
        model = as_moment_model("RauchTungStriebelSmoother", model, ("dynamics",))
        self.rule.check_size("RauchTungStriebelSmoother", model.size)
        return model

    def smooth(self, key: jax.Array, model: StateSpaceModel, history: History, steps: Steps) -> Smoothed:
        """Go backward from the last law."""
        size, factored, eps = model.size, isinstance(history.state, FactoredGaussian), float(jnp.finfo(model.dtype).eps)

        def back(after: FactoredGaussian, row: Any) -> tuple[FactoredGaussian, tuple[jax.Array, jax.Array]]:
            mean, cov, filtered, u, t = row
            # 1. linear dynamics
            c, F, Q = self.rule.linearized(model.dynamics, Gaussian(mean, cov), u, t)
            # 2. gain Y X^-1
            U = linalg.cholesky(cov)
            nothing = jnp.zeros((size, size), U.dtype)
            rows = [[linalg.product(F, U), linalg.cholesky(linalg.symmetric(Q))], [U, nothing]]
            whole = linalg.triangle(jnp.concatenate([jnp.concatenate(row, axis=1) for row in rows]))
            X, Y, D = whole[:size, :size], whole[size:, :size], whole[size:, size:]
            # 3. smoothed law
            pull = linalg.solve_lower(X, model.dynamics.residual(after.center, c))
            ratio = linalg.solve_lower(X, after.factor)
            variances = jnp.sum(X**2, axis=1)
            # what a filter subtracts from the predicted covariance is rounded to its size; a factor is rounded to its own
            rounding = jnp.diag(filtered) if factored else variances
            pivot = jnp.diag(X)
            silent = (1 - jnp.sum(ratio**2, axis=1)) * pivot**2 <= _ROUNDING * eps * rounding
            pull = jnp.where(silent & (pivot**2 <= eps * variances), 0, pull)
            given = linalg.product(Y, jnp.where(silent[:, None], 0, ratio))
            spread = jnp.concatenate([given, jnp.where(silent, Y, 0)], axis=1)
            now = FactoredGaussian(mean + linalg.times_vector(Y, pull), linalg.cholesky_update(D, spread))
            return now, (now.center, now.cov())

        moments = (history.mean, history.cov)
        rows = *(leaf[:-1] for leaf in moments), history.cov[1:], *jax.tree.map(lambda leaf: leaf[1:], (steps.u, steps.t))
        last = at_step(moments, -1)
        _, earlier = jax.lax.scan(back, FactoredGaussian.of(Gaussian(*last)), rows, reverse=True)
        mean, cov = (jnp.concatenate([some, one[None]]) for some, one in zip(earlier, last, strict=True))
        return Smoothed(mean, cov)
