"""Gaussian filter (Ito, Xiong 2000): a Kalman filter that takes moments of the model's functions by any rule.

1. Predict: mean and covariance of the dynamics over the Gaussian, plus noise (`Rule.through`).
2. Correct: condition on y through the linear conditional that stands for the sensor over the predicted Gaussian (`Rule.measured`); of a
   scan of plots by probabilistic data association (`gaussian/association.py`).

`KalmanFilter`, `ExtendedKalmanFilter`, `UnscentedKalmanFilter`, `CubatureKalmanFilter` and `GaussHermiteFilter` are this filter with one
rule each.
"""

from typing import Any

import jax

from motes.core.record import record
from motes.filters.gated import Gated
from motes.filters.info import Info, single
from motes.filters.interface import Guide, TwoStageFilter
from motes.filters.needs import as_linear_model, as_moment_model, of_one_plot
from motes.gaussian.association import conditioned
from motes.gaussian.rule import Rule, check_rule
from motes.laws.gaussian import Gaussian
from motes.models.state_space import StateSpaceModel, as_state_space


class OneGaussian(Gated):
    """Stages of the filters whose law is one Gaussian; each says by which rule it takes moments."""

    rule: Rule
    weighs = False
    light = True
    subtracts = True

    def check_parameters(self) -> None:
        """Check the parameters.

        Raises:
            MotesError: the rule is none, or has a parameter that it cannot have.
        """
        check_rule(type(self).__name__, self.rule)

    def prepare(self, model: Any, u: Any) -> StateSpaceModel:
        """Ask for means and covariances of dynamics and sensor; for a linear model where the rule is for such alone.

        Raises:
            MotesError: the model is not linear (the message names a state and the reason), one of them is a Custom conditional, or the
                rule does not suit the number of states.
        """
        name = type(self).__name__
        model = as_state_space(name, model)
        for one in of_one_plot(model):
            _ = as_linear_model(name, one, u) if self.rule.exact else as_moment_model(name, one)
        self.rule.check_size(name, model.size)
        return model

    def init(self, key: jax.Array, model: StateSpaceModel) -> Gaussian:
        """Return the Gaussian with the moments of the initial law."""
        return Gaussian(model.initial.mean(), model.initial.cov())

    def predict(self, key: jax.Array, model: StateSpaceModel, state: Gaussian, u: Any, t: Any) -> Gaussian:
        """Move mean and covariance to time t (step 1)."""
        return self.rule.through(model.dynamics, state, u, t)

    def correct(self, key: jax.Array, model: StateSpaceModel, state: Gaussian, y: jax.Array, u: Any, t: Any) -> tuple[Gaussian, Info]:
        """Condition on y (step 2)."""
        done = conditioned(self.rule, model.sensor, state, y, u, t)
        return done.law, single(done)


@record
class GaussianFilter(OneGaussian, TwoStageFilter[Gaussian]):
    """Gaussian filter; its state is a `Gaussian`.

    Source: Ito, Xiong 2000, Gaussian filters for nonlinear filtering problems.

    Example:
        >>> model = mo.textbook.radar_tracking()
        >>> xs, ys = mo.simulate(0, model, 50)
        >>> mo.run(1, mo.GaussianFilter(mo.gaussian.Cubature()), model, ys).mean.shape
        (50, 6)

    Attributes:
        rule: how moments are taken: `mo.gaussian.Linear()`, `Taylor(iterations)`, `Unscented(alpha, beta, kappa)`, `Cubature()`,
            `GaussHermite(degree)`, or a `mo.gaussian.Rule` of your own.
    """

    guide = Guide(
        needs="mean functions, noises with covariances; a linear model with the rule Linear",
        cost="x^3, and what the rule asks of each function",
        use="a rule of your own, or one rule for filter and smoother",
    )

    rule: Rule
