"""Pictures of a tracked aircraft: the plane seen from the radar, the error, and how sure the filter is that the aircraft turns."""

from typing import Any

import numpy as np

from motes.applications.aircraft.scenario import Track
from motes.filters.history import History
from motes.laws.observed import value_of
from motes.plotting.figures import ESTIMATE, INERTIAL, TRUE, legend_below, new_figure, tidy
from motes.report.scene import Marks, Scene

MARGIN = 0.06
"""Room about what the plane shows, as a share of it."""


def track_figure(history: History, job: Track) -> Any:
    """Draw plots, truth and estimate on the plane; under one another the error of the position and the probability of a turn.

    Args:
        history: with moments, and with the probabilities of the modes where the filter knows them.
        job: what was flown.

    Raises:
        MissingExtraError: matplotlib is not installed.
    """
    figure = new_figure(12, 6)
    knows_modes = "mode_probabilities" in history.kept
    axes = figure.subplot_mosaic([["plane", "error"], ["plane", "mode"]] if knows_modes else [["plane", "error"]])
    for one in axes.values():
        tidy(one)
    _plane(axes["plane"], history, job)
    seconds = np.cumsum(job.dt) - job.dt[0]
    mean, cov = np.asarray(history.mean), np.asarray(history.cov)
    error = np.hypot(*(mean[:, :2] - job.truth[:, :2]).T)
    axes["error"].fill_between(seconds, 0, 2 * np.sqrt(cov[:, 0, 0] + cov[:, 1, 1]), color=ESTIMATE, alpha=0.22, linewidth=0,
                               label="two standard deviations")  # fmt: skip
    axes["error"].plot(seconds, error, color=TRUE, linewidth=0.8, label="actual")
    axes["error"].set(title="Error of the position, also where no plot came", ylabel="m",
                      ylim=(0, 1.3 * max(np.quantile(error, 0.995), 1.0)))  # fmt: skip
    axes["error"].legend(loc="upper right", ncols=2, frameon=False, fontsize="small")
    if knows_modes:
        axes["mode"].plot(seconds, np.asarray(history.mode_probabilities)[:, 1], color=INERTIAL, linewidth=0.8)
        axes["mode"].set(title="Probability that it turns", ylim=(0, 1.05))
        axes["mode"].sharex(axes["error"])
    axes["mode" if knows_modes else "error"].set(xlabel="time, s", xlim=(seconds[0], seconds[-1]))
    legend_below(figure, axes["plane"], 4)
    return figure


def _plane(axes: Any, history: History, job: Track) -> None:
    distance, azimuth = np.asarray(value_of(job.ys), np.float64).reshape(-1, 2).T / [[1e3], [1.0]]
    axes.plot(distance * np.cos(azimuth), distance * np.sin(azimuth), ".", color="0.55", markersize=2.5, label="plot")
    axes.plot(*(np.asarray(job.truth)[:, :2].T / 1e3), color=TRUE, linewidth=2.2, label="truth")
    axes.plot(*(np.asarray(history.mean)[:, :2].T / 1e3), color=ESTIMATE, linewidth=1.0, label="estimate")
    axes.plot(0, 0, "^", color="tab:red", markersize=9, label="radar")
    # false plots lie everywhere: the picture is of the flight
    shown = np.concatenate([np.asarray(job.truth)[:, :2] / 1e3, np.zeros((1, 2))])
    low, high = shown.min(axis=0), shown.max(axis=0)
    room = MARGIN * (high - low).max()
    axes.set(title="Plane", xlabel="east, km", ylabel="north, km", aspect="equal",
             xlim=(low[0] - room, high[0] + room), ylim=(low[1] - room, high[1] + room))  # fmt: skip


def plane(names: tuple[str, ...], truth: np.ndarray | None, title: str) -> Scene:
    """Return the plane about a radar in kilometers.

    Args:
        names: of the states, the first two east and north in meters.
        truth: true states `(t, k)` of the first k, or None.
        title: of the scene.
    """
    known = np.full((0, 2 + len(names)), np.nan)
    if truth is not None:
        known = np.full((len(truth), 2 + len(names)), np.nan)
        known[:, :2], known[:, 2 : 2 + truth.shape[1]] = truth[:, :2] / 1e3, truth
    return Scene(names=("to the east", "to the north", *names), units=("km", "km"), title=title, truth=None if truth is None else known,
                 place=lambda points, u, step: np.concatenate([points[:2] / 1e3, points]),
                 marks=(Marks("radar", np.zeros((1, 2))),))  # fmt: skip
