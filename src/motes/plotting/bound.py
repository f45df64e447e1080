"""Picture of a bound: the smallest standard deviation of the error of each state over time."""

from typing import Any

import numpy as np

from motes.bounds.bound import Bound
from motes.plotting.figures import ESTIMATE, WORDS, over_time, state_panels


def bound_figure(bound: Bound) -> Any:
    """Draw the root of the bound of each state's variance."""
    figure, panels = state_panels(bound.names)
    variances = np.diagonal(np.asarray(bound.cov, np.float64), axis1=1, axis2=2)
    for axes, deviations in zip(panels, np.sqrt(variances).T, strict=True):
        axes.plot(deviations, color=ESTIMATE, linewidth=1.4)
        axes.set_ylim(bottom=0)
    over_time(figure, np.arange(len(variances)))
    figure.suptitle(bound.kind, fontsize=10, **WORDS)
    return figure
