"""Pictures of runs over time: each state with its two-sigma band, and the effective sample size; many runs at once as a fan of lines."""

from typing import Any, NamedTuple

import numpy as np

from motes.core import checks
from motes.filters.frames import deviations, first_step, seconds_of
from motes.filters.history import History
from motes.filters.predictive import Predictive
from motes.io.tabular import by_columns
from motes.plotting.figures import DASHED, ESTIMATE, legend_below, over_time, state_panels
from motes.smoothers.interface import Smoothed

LINES = 20
"""So many of many runs are drawn as lines."""
WIDE = 20
"""So many times as wide as most a band may be before it leaves the picture: after a wide prior nothing else could be seen in it."""


class Course(NamedTuple):
    """Some states over time.

    Attributes:
        times: of steps: dates, numbers or steps, `(t,)`.
        label: what they are.
        names: of the states.
        mean: `(..., t, x)`.
        cov: `(..., t, x, x)`.
        truth: `(t, x)`, or None.
    """

    times: np.ndarray
    label: str
    names: tuple[str, ...]
    mean: np.ndarray
    cov: np.ndarray
    truth: np.ndarray | None

    @property
    def deviation(self) -> np.ndarray:
        """Standard deviations `(..., t, x)`."""
        return deviations(self.cov)


def course(result: History | Smoothed, truth: Any, states: tuple[int, ...]) -> Course:
    """Return some states of a run over time.

    Args:
        result: with means and covariances.
        truth: true states `(t, x)`, a table or an array, or None.
        states: indices.

    Raises:
        MotesError: truth has another shape, or the history kept no moments.
    """
    means, covs = np.asarray(result.mean, np.float64), np.asarray(result.cov, np.float64)
    if truth is not None:
        truth = np.asarray(checks.as_numbers("plot truth", by_columns("plot truth", truth, result.names)))
        checks.shape("plot truth", truth, means.shape[-2:], "(steps, states)")
        truth = truth[:, states]
    times, label = times_of(result, means.shape[-2])
    names = tuple(result.names[state] for state in states)
    return Course(times, label, names, means[..., states], covs[..., states, :][..., states], truth)


def times_of(result: History | Smoothed | Predictive, steps: int) -> tuple[np.ndarray, str]:
    """Return the times of the steps of a result, as they were given, and what they are."""
    labels = result.labels
    if labels is not None and labels.index is not None:
        if labels.index.dtype.kind == "m":
            return labels.index / np.timedelta64(1, "s"), "time, s"
        return labels.index, (labels.name or "time") + (", UTC" if labels.zone else "")
    if not isinstance(result, Predictive) and result.times is not None:
        return seconds_of(result), "time, s"
    return first_step(result) + np.arange(steps), "step"


def history_figure(result: History | Smoothed, truth: Any, states: tuple[int, ...]) -> Any:
    """Draw means with bands of two standard deviations, and the effective sample size where there is one.

    Args:
        result: with means and covariances; of many runs too.
        truth: true states `(t, x)`, or None.
        states: indices of those to draw.

    Raises:
        MotesError: truth has another shape, or the history kept no moments.
    """
    drawn = course(result, truth, states)
    if drawn.mean.ndim > 2:
        return _runs_figure(drawn)
    ess = np.asarray(result.ess) if isinstance(result, History) else np.full(1, np.inf)
    sampled = bool(np.isfinite(ess).any())
    figure, panels = state_panels(drawn.names, wide=sampled, label=drawn.label)
    for state, axes in enumerate(panels[: len(drawn.names)]):
        mean, deviation = drawn.mean[:, state], drawn.deviation[:, state]
        axes.fill_between(drawn.times, mean - 2 * deviation, mean + 2 * deviation, color=ESTIMATE, alpha=0.22, linewidth=0, label="2 sigma")
        axes.plot(drawn.times, mean, color=ESTIMATE, linewidth=1.4, label="mean")
        _truth(axes, drawn, state)
        _frame(axes, mean, deviation, [] if drawn.truth is None else drawn.truth[:, state])
    legend_below(figure, panels[0], 3)
    if sampled:
        axes = panels[-1]
        axes.plot(drawn.times, ess, color=ESTIMATE, linewidth=0.9)
        axes.set_ylim(bottom=0)
        axes.set_title("effective sample size", fontsize=10)
    over_time(figure, drawn.times)
    return figure


def some_of(runs: np.ndarray) -> list[tuple[str | None, np.ndarray]]:
    """Return those of many runs `(r, ...)` that are drawn as lines, the first with what they are called in a legend."""
    shown = runs[:LINES]
    name = f"means of {len(shown)} of {len(runs)} runs"
    return [(None if number else name, one) for number, one in enumerate(shown)]


def _truth(axes: Any, drawn: Course, state: int) -> None:
    if drawn.truth is not None:
        axes.plot(drawn.times, drawn.truth[:, state], **DASHED, label="truth")


def _frame(axes: Any, mean: np.ndarray, deviation: np.ndarray, truth: Any) -> None:
    """Frame what is known: bands that are very much wider than most go beyond."""
    finite = deviation[np.isfinite(deviation)]
    usual = WIDE * np.median(finite) if finite.size else 0.0
    known = deviation <= usual
    if usual > 0 and not known.all():
        ends = np.concatenate([(mean - 2 * deviation)[known], (mean + 2 * deviation)[known], truth])
        low, high = np.nanmin(ends), np.nanmax(ends)
        axes.set_ylim(low - 0.05 * (high - low), high + 0.05 * (high - low))


def _runs_figure(drawn: Course) -> Any:
    """Draw the means of many runs: some of them as lines, the median of all, and what nine of ten lie within."""
    means = drawn.mean.reshape(-1, *drawn.mean.shape[-2:])
    figure, panels = state_panels(drawn.names, label=drawn.label)
    lower, middle, upper = np.nanquantile(means, (0.05, 0.5, 0.95), axis=0)
    for state, axes in enumerate(panels):
        for name, line in some_of(means[..., state]):
            axes.plot(drawn.times, line, color="0.55", linewidth=0.6, alpha=0.7, label=name)
        axes.fill_between(drawn.times, lower[:, state], upper[:, state], color=ESTIMATE, alpha=0.22, linewidth=0, label="nine of ten")
        axes.plot(drawn.times, middle[:, state], color=ESTIMATE, linewidth=1.4, label="median")
        _truth(axes, drawn, state)
    legend_below(figure, panels[0], 4)
    over_time(figure, drawn.times)
    return figure
