"""Picture of a run of the range-only robot: the map, the error and the scale of the ranges."""

from typing import Any

import numpy as np

from motes.filters.history import History
from motes.plotting.figures import ESTIMATE, INERTIAL, TRUE, legend_below, new_figure, tidy

BAND = 0.25
GAP = 10.0
"""Times without a range are shaded where they are longer than this, seconds."""


def robot_figure(history: History, scenario: Any) -> Any:
    """Draw tracks and beacons, position error against time, and the estimated scale against time; bands are two standard deviations.

    Args:
        history: a whole run, with means and covariances.
        scenario: the job that was run, with times, scored, truth, dead_reckoning, beacons and ys.

    Returns:
        A matplotlib `Figure`.

    Raises:
        MissingExtraError: matplotlib is not installed.
    """
    figure = new_figure(12, 6)
    axes = figure.subplot_mosaic([["map", "error"], ["map", "scale"]])
    for one in axes.values():
        tidy(one)
    _map(axes["map"], history, scenario)
    _error(axes["error"], history, scenario)
    _scale(axes["scale"], history, scenario)
    axes["scale"].sharex(axes["error"])
    legend_below(figure, axes["map"], 5)
    return figure


def _map(axes: Any, history: History, scenario: Any) -> None:
    estimate = np.asarray(history.mean)[scenario.scored]
    axes.plot(*scenario.dead_reckoning.T, color=INERTIAL, lw=0.8, label="odometry alone")
    axes.plot(*scenario.truth[:, :2].T, color=TRUE, lw=1.6, label="truth")
    axes.plot(estimate[:, 0], estimate[:, 1], color=ESTIMATE, lw=0.9, label="estimate")
    axes.plot(*scenario.beacons.T, "^", color="tab:red", ms=9, label="beacon")
    axes.plot(*scenario.truth[0, :2], "o", mfc="white", color=TRUE, ms=7, label="start")
    axes.set(title="Map", xlabel="x, m", ylabel="y, m", aspect="equal")


def _error(axes: Any, history: History, scenario: Any) -> None:
    times = scenario.times[scenario.scored]
    mean, cov = (np.asarray(values)[scenario.scored] for values in (history.mean, history.cov))
    error = np.hypot(*(mean[:, :2] - scenario.truth[:, :2]).T)
    claimed = np.sqrt(cov[:, 0, 0] + cov[:, 1, 1])
    rms = np.sqrt(np.mean(error**2))
    axes.fill_between(times, 0, 2 * claimed, color=ESTIMATE, alpha=BAND, lw=0, label="two standard deviations")
    axes.plot(times, error, color=TRUE, lw=0.7, label="actual")
    measured = np.concatenate([[times[0]], scenario.times[~np.isnan(scenario.ys).all(axis=1)], [times[-1]]])
    for place, i in enumerate(np.flatnonzero(np.diff(measured) > GAP)):
        label = None if place else f"no range for {GAP:.0f} s or more"
        axes.axvspan(measured[i], measured[i + 1], color="0.88", lw=0, zorder=0, label=label)
    top = 1.45 * max(error.max(), np.quantile(2 * claimed, 0.99))
    axes.set(title=f"Position error: {rms:.2f} m RMS, {error.max():.2f} m at worst", ylabel="m", ylim=(0, top))
    axes.legend(loc="upper right", ncols=3, frameon=False, fontsize="small", columnspacing=1.2)


def _scale(axes: Any, history: History, scenario: Any) -> None:
    place = history.names.index("scale")
    mean = 100 * np.asarray(history.mean)[:, place]
    spread = 200 * np.sqrt(np.asarray(history.cov)[:, place, place])
    axes.fill_between(scenario.times, mean - spread, mean + spread, color=ESTIMATE, alpha=BAND, lw=0, label="two standard deviations")
    axes.plot(scenario.times, mean, color=ESTIMATE, lw=1.2, label="estimate")
    # the prior is so wide that it would hide everything after the first seconds
    settled = scenario.times > 0.1 * scenario.times[-1]
    low, high = (mean - spread)[settled].min(), (mean + spread)[settled].max()
    room = 0.35 * (high - low)
    axes.set(title=f"Scale error of the ranges: {mean[-1]:.2f} %", xlabel="time, s", ylabel="percent", ylim=(low - room, high + room))
    axes.legend(loc="upper left", ncols=2, frameon=False, fontsize="small")
