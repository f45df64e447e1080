"""Picture of a run: each state with its two-sigma band, and the effective sample size."""

from typing import Any

import numpy as np

from motes.core import checks
from motes.filters.history import History
from motes.plotting.figures import ESTIMATE, TRUE, legend_below, new_figure, tidy

COLUMNS = 3


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
    columns = min(COLUMNS, len(history.names))
    state_rows = -(-len(history.names) // columns)
    rows = state_rows + bool(np.isfinite(ess).any())
    figure = new_figure(4.0 * columns, 2.1 * rows + 0.6)
    grid = figure.add_gridspec(rows, columns)
    steps = int(history.start) + np.arange(means.shape[0])
    for state, name in enumerate(history.names):
        axes = figure.add_subplot(grid[state // columns, state % columns])
        _state(axes, steps, means[:, state], deviations[:, state], None if truth is None else truth[:, state])
        axes.set_title(name, fontsize=10)
    legend_below(figure, axes, 3)
    if rows > state_rows:
        axes = figure.add_subplot(grid[state_rows, :])
        tidy(axes)
        axes.plot(steps, ess, color=ESTIMATE, linewidth=0.9)
        axes.set_ylim(bottom=0)
        axes.set_title("effective sample size", fontsize=10)
    for axes in figure.axes:
        axes.set_xlim(steps[0], max(steps[-1], steps[0] + 1))
    figure.axes[-1].set_xlabel("step")
    return figure


def _state(axes: Any, steps: np.ndarray, mean: np.ndarray, deviation: np.ndarray, truth: np.ndarray | None) -> None:
    tidy(axes)
    axes.fill_between(steps, mean - 2 * deviation, mean + 2 * deviation, color=ESTIMATE, alpha=0.22, linewidth=0, label="2 sigma")
    axes.plot(steps, mean, color=ESTIMATE, linewidth=1.4, label="mean")
    if truth is not None:
        axes.plot(steps, truth, color=TRUE, linewidth=1.0, linestyle=(0, (4, 2)), label="truth")
