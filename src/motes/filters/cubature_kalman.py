"""Cubature Kalman filter (Arasaratnam, Haykin 2009): moments by the third-degree spherical-radial rule, 2 x points of equal weight.

1. Predict: mean and covariance of the dynamics over the points, plus noise.
2. Correct: Kalman gain from the covariances of state and measurement over the points of the prediction.

The steps are those of `OneGaussian` (gaussian.py) with the rule `Cubature` (gaussian/sigma_points.py). No parameters, and no
covariance that is not one.
"""

from motes.core.record import record
from motes.filters.gaussian import OneGaussian
from motes.filters.interface import Guide, TwoStageFilter
from motes.gaussian.sigma_points import Cubature
from motes.laws.gaussian import Gaussian


@record
class CubatureKalmanFilter(OneGaussian, TwoStageFilter[Gaussian]):
    """Cubature Kalman filter; its state is a `Gaussian`.

    Source: Arasaratnam, Haykin 2009, Cubature Kalman filters.

    Example:
        >>> model = mo.textbook.radar_tracking()
        >>> xs, ys = mo.simulate(0, model, 50)
        >>> mo.run(1, mo.CubatureKalmanFilter(), model, ys).mean.shape
        (50, 6)
    """

    guide = Guide(
        needs="mean functions, noises with covariances",
        cost="x^3, and 2 x + 1 calls of each function",
        use="as UnscentedKalmanFilter, without parameters to set",
    )

    @property
    def rule(self) -> Cubature:  # type: ignore[override]
        """The third-degree spherical-radial rule."""
        return Cubature()
