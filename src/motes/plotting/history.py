"""Picture of a run: each state with its two-sigma band, and the effective sample size."""

from typing import Any

import numpy as np

from motes.core import checks
from motes.filters.history import History
from motes.plotting.figures import ESTIMATE, TRUE, legend_below, over_steps, state_panels


def history_figure(history: History, truth: Any = None) -> Any:
    """Draw means with bands of two standard deviations, and the effective sample size where there is one.

    Args:
        history: with means and covariances.
        truth: true states `(t, x)`, or None.

    Raises:
        MotesError: truth has another shape, or the history kept no moments.
    """
    means, covs = np.asarray(history.mean, np.float64), np.asarray(history.cov, np.float64)
    if truth is not None:
        checks.shape("plot truth", truth, means.shape, "(steps, states)")
        truth = np.asarray(truth)
    # rounding may leave a variance of a certain state a little below zero
    deviations = np.sqrt(np.maximum(np.diagonal(covs, axis1=1, axis2=2), 0))
    ess = np.asarray(history.ess)
    sampled = bool(np.isfinite(ess).any())
    figure, panels = state_panels(history.names, wide=sampled)
    steps = int(history.start) + np.arange(means.shape[0])
    for state, axes in enumerate(panels[: len(history.names)]):
        _state(axes, steps, means[:, state], deviations[:, state], None if truth is None else truth[:, state])
    legend_below(figure, panels[0], 3)
    if sampled:
        axes = panels[-1]
        axes.plot(steps, ess, color=ESTIMATE, linewidth=0.9)
        axes.set_ylim(bottom=0)
        axes.set_title("effective sample size", fontsize=10)
    over_steps(figure, steps[0], steps[-1])
    return figure


def _state(axes: Any, steps: np.ndarray, mean: np.ndarray, deviation: np.ndarray, truth: np.ndarray | None) -> None:
    axes.fill_between(steps, mean - 2 * deviation, mean + 2 * deviation, color=ESTIMATE, alpha=0.22, linewidth=0, label="2 sigma")
    axes.plot(steps, mean, color=ESTIMATE, linewidth=1.4, label="mean")
    if truth is not None:
        axes.plot(steps, truth, color=TRUE, linewidth=1.0, linestyle=(0, (4, 2)), label="truth")
