"""Gauss-Hermite filter (Ito, Xiong 2000): moments by Gauss-Hermite quadrature, degree^x points.

1. Predict: mean and covariance of the dynamics over the points, plus noise.
2. Correct: Kalman gain from the covariances of state and measurement over the points of the prediction.

The steps are those of `OneGaussian` (gaussian.py) with the rule `GaussHermite` (gaussian/sigma_points.py).
"""

from motes.core.record import record, static
from motes.filters.gaussian import OneGaussian
from motes.filters.interface import Guide, TwoStageFilter
from motes.gaussian.sigma_points import GaussHermite
from motes.laws.gaussian import Gaussian


@record
class GaussHermiteFilter(OneGaussian, TwoStageFilter[Gaussian]):
    """Gauss-Hermite filter; its state is a `Gaussian`.

    Source: Ito, Xiong 2000, Gaussian filters for nonlinear filtering problems.

    Example:
        >>> model = mo.textbook.growth()
        >>> xs, ys = mo.simulate(0, model, 50)
        >>> mo.run(1, mo.GaussHermiteFilter(degree=5), model, ys).mean.shape
        (50, 1)

    Attributes:
        degree: points per state, at least 2; moments are exact for polynomials up to the degree 2 `degree` - 1 in each state.
    """

    guide = Guide(
        needs="mean functions, noises with covariances",
        cost="degree^x calls of each function",
        use="one mode, few states, strongly bent functions",
    )

    degree: int = static(default=3)

    @property
    def rule(self) -> GaussHermite:  # type: ignore[override]
        """Gauss-Hermite quadrature."""
        return GaussHermite(self.degree)
