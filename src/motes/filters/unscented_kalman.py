"""Unscented Kalman filter (Julier, Uhlmann 1997; scaled form of Wan, van der Merwe 2000): 2 x + 1 sigma points in place of a Jacobian.

1. Predict: mean and covariance of the dynamics over the sigma points, plus noise.
2. Correct: Kalman gain from the covariances of state and measurement over the sigma points of the prediction.

The steps are those of `OneGaussian` (gaussian.py) with the rule `Unscented` (gaussian/sigma_points.py).
"""

from motes.core.record import record, static
from motes.filters.gaussian import OneGaussian
from motes.filters.interface import Guide, TwoStageFilter
from motes.gaussian.sigma_points import Unscented
from motes.laws.gaussian import Gaussian


@record
class UnscentedKalmanFilter(OneGaussian, TwoStageFilter[Gaussian]):
    """Unscented Kalman filter; its state is a `Gaussian`.

    Sigma points lie alpha sqrt(x + kappa) standard deviations from the mean. The defaults never give a negative variance.

    Source: Julier, Uhlmann 1997, A new extension of the Kalman filter to nonlinear systems; Wan, van der Merwe 2000, The unscented
    Kalman filter for nonlinear estimation.

    Example:
        >>> model = mo.textbook.radar_tracking()
        >>> xs, ys = mo.simulate(0, model, 50)
        >>> mo.run(1, mo.UnscentedKalmanFilter(), model, ys).mean.shape
        (50, 6)

    Attributes:
        alpha: spread of the points, above 0. Small ones read the slope at the mean, and need float64 below about 1e-2.
        beta: what is known of the fourth moments; 2 suits Gaussians.
        kappa: second scaling, above -x; with alpha = 1 and beta = 0, 3 - x makes fourth moments right along each axis.
    """

    guide = Guide(
        needs="mean functions, noises with covariances",
        cost="x^3, and 2 x + 1 calls of each function",
        use="one mode, functions that bend within the uncertainty or have no slopes",
    )

    alpha: float = static(default=1.0)
    beta: float = static(default=2.0)
    kappa: float = static(default=0.0)

    @property
    def rule(self) -> Unscented:  # type: ignore[override]
        """The scaled unscented rule."""
        return Unscented(self.alpha, self.beta, self.kappa)
