"""Kalman filter (Kalman 1960): exact for linear models with Gaussian noise.

1. Predict: mean <- A mean, P <- A P A' + Q.
2. Correct: condition on y = H x + e (`Gaussian.corrected`, Joseph form).

The steps are those of `OneGaussian` (gaussian.py) with the rule `Linear` (gaussian/taylor.py).
"""

from motes.core.record import record
from motes.filters.gaussian import OneGaussian
from motes.filters.interface import Guide, TwoStageFilter
from motes.gaussian.taylor import Linear
from motes.laws.gaussian import Gaussian


@record
class KalmanFilter(OneGaussian, TwoStageFilter[Gaussian]):
    """Kalman filter; its state is a `Gaussian`. Functions that are linear need not be written as matrices: tracing finds out.

    Source: Kalman 1960, A new approach to linear filtering and prediction problems.

    Example:
        >>> model = mo.textbook.constant_velocity()
        >>> xs, ys = mo.simulate(0, model, 50)
        >>> mo.run(1, mo.KalmanFilter(), model, ys).mean.shape
        (50, 4)
    """

    guide = Guide(
        needs="a linear model with Gaussian noises and initial law",
        cost="x^3",
        use="the model is linear: nothing beats it",
    )

    @property
    def rule(self) -> Linear:  # type: ignore[override]
        """The matrices of the model."""
        return Linear()
