"""Extended Kalman filter: the Kalman filter on the model linearized at its own estimate (Jacobians by automatic differentiation).

1. Predict: the mean goes through f, the covariance through the slope F of f there: P <- F P F' + Q.
2. Correct: condition on the innovation y - h(mean) with the slope H of h there. With iterations the sensor is linearized again where the
   last correction led (Bell, Cathey 1993: Gauss-Newton steps towards the most probable state).

The steps are those of `OneGaussian` (gaussian.py) with the rule `Taylor` (gaussian/taylor.py). On a linear model it is the Kalman filter.
"""

from motes.core.record import record, static
from motes.filters.gaussian import OneGaussian
from motes.filters.interface import Guide, TwoStageFilter
from motes.gaussian.taylor import Taylor
from motes.laws.gaussian import Gaussian


@record
class ExtendedKalmanFilter(OneGaussian, TwoStageFilter[Gaussian]):
    """Extended Kalman filter; its state is a `Gaussian`.

    Source: Jazwinski 1970, Stochastic Processes and Filtering Theory.

    Example:
        >>> model = mo.textbook.radar_tracking()
        >>> xs, ys = mo.simulate(0, model, 50)
        >>> mo.run(1, mo.ExtendedKalmanFilter(), model, ys).mean.shape
        (50, 6)

    Attributes:
        iterations: linearizations of the sensor in a correction; 1 is the plain filter, more the iterated one. Steps are not damped.
    """

    guide = Guide(
        needs="mean functions with slopes, noises with covariances",
        cost="x^3, and a Jacobian of each function",
        use="one mode, functions that bend little within the uncertainty",
    )

    iterations: int = static(default=1)

    @property
    def rule(self) -> Taylor:  # type: ignore[override]
        """Slopes at the mean."""
        return Taylor(self.iterations)
