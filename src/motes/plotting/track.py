"""Picture of two states of a run against each other: the track in their plane, with ellipses of two standard deviations."""

from typing import Any

import numpy as np

from motes.filters.history import History
from motes.plotting.animation import moments
from motes.plotting.figures import DASHED, ESTIMATE, WORDS, legend_below, new_figure, one_scale, tidy, two_sigma
from motes.plotting.history import course, some_of
from motes.smoothers.interface import Smoothed

ELLIPSES = 16
"""So many moments have an ellipse."""


def plane_figure(result: History | Smoothed, truth: Any, states: tuple[int, int]) -> Any:
    """Draw the mean of one state over that of another.

    Args:
        result: with means and covariances; of many runs means alone are drawn.
        truth: true states `(t, x)`, or None.
        states: indices of the two.

    Raises:
        MotesError: truth has another shape, or the history kept no moments.
    """
    drawn = course(result, truth, states)
    figure = new_figure(6.0, 5.0)
    axes = figure.add_subplot()
    tidy(axes)
    runs = drawn.mean.reshape(-1, *drawn.mean.shape[-2:])
    if len(runs) > 1:
        for name, mean in some_of(runs):
            axes.plot(*mean.T, color=ESTIMATE, linewidth=0.6, alpha=0.6, label=name)
    else:
        _track(axes, runs[0], drawn.cov.reshape(-1, 2, 2))
    if drawn.truth is not None:
        axes.plot(*drawn.truth.T, **DASHED, label="truth")
    axes.set_xlabel(drawn.names[0], **WORDS)
    axes.set_ylabel(drawn.names[1], **WORDS)
    axes.autoscale_view()
    one_scale(axes)
    legend_below(figure, axes, 4)
    return figure


def _track(axes: Any, mean: np.ndarray, cov: np.ndarray) -> None:
    axes.plot(*mean.T, color=ESTIMATE, linewidth=1.4, label="mean")
    known = [step for step in moments(len(mean), ELLIPSES) if np.isfinite(cov[step]).all()]
    for number, step in enumerate(known):
        label = None if number else "2 sigma"
        two_sigma(axes, mean[step], cov[step], edgecolor=ESTIMATE, linewidth=0.8, alpha=0.7, label=label)
    axes.plot(*mean[:1].T, "o", color=ESTIMATE, markersize=5, label="start")
