"""Pictures of a target that a radar loses: the plane with the cloud, range rates, errors; the same in motion; and of many tracks."""

from typing import Any

import numpy as np

from motes.applications.target_tracking.world import range_rate
from motes.filters.history import History
from motes.plotting.animation import Animation
from motes.plotting.figures import COLORS, ESTIMATE, INERTIAL, TRUE, legend_below, new_figure, tidy

MARGIN = 0.12
"""Room about what the plane shows, as a share of it."""
CLOUDS = 5
"""Moments at which the picture shows the cloud."""
NOTCH = "0.87"


def track_figure(history: History, job: Any) -> Any:
    """Draw the plane with the cloud at some moments; beside it the range rate over time and, where the truth is known, the errors.

    Args:
        history: with moments, and with `cloud` `(t, x, k)` where the filter has particles.
        job: what was run.

    Raises:
        MissingExtraError: matplotlib is not installed.
    """
    figure = new_figure(12, 6)
    knows = job.truth is not None
    axes = figure.subplot_mosaic([["plane", "rate"], ["plane", "error"]] if knows else [["plane", "rate"]])
    for one in axes.values():
        tidy(one)
    _draw_plane(axes["plane"], history, job, _moments(job))
    _draw_rates(axes["rate"], history, job, len(job.times) - 1)
    if knows:
        _draw_errors(axes["error"], history, job)
        axes["error"].sharex(axes["rate"])
    axes["error" if knows else "rate"].set_xlabel("time, s")
    legend_below(figure, axes["plane"], 5)
    return figure


def track_animation(history: History, job: Any) -> Animation:
    """Return the cloud in motion: the plane, and the range rate up to the present moment; a picture for each scan."""

    def draw(number: int) -> Any:
        figure = new_figure(9, 4.6)
        axes = figure.subplot_mosaic([["plane", "rate"]])
        for one in axes.values():
            tidy(one)
        _draw_plane(axes["plane"], history, job, [number], upto=number)
        _draw_rates(axes["rate"], history, job, number)
        axes["rate"].set_xlabel("time, s")
        blind = job.truth is not None and bool(job.hidden[number])
        axes["plane"].set_title(f"{job.times[number]:.0f} s" + (": the radar is blind" if blind else ""))
        legend_below(figure, axes["plane"], 5)
        return figure

    return Animation(draw, len(job.times))


def _moments(job: Any) -> list[int]:
    """Return scans at which the cloud is shown: through the time in which the radar is blind, or through all."""
    steps = len(job.times)
    if job.truth is None or not job.hidden.any():
        return np.linspace(0, steps - 1, CLOUDS).astype(int).tolist()
    blind = np.flatnonzero(job.hidden)
    return np.linspace(max(0, blind[0] - 4), min(steps - 1, blind[-1] + 3), CLOUDS).astype(int).tolist()


def _draw_plane(axes: Any, history: History, job: Any, moments: list[int], upto: int | None = None) -> None:
    mean = np.asarray(history.mean)[:, :2] / 1e3
    shown = slice(None) if upto is None else slice(upto + 1)
    known = None if job.truth is None else np.asarray(job.truth)[:, :2] / 1e3
    around = mean if known is None else np.concatenate([mean, known[~np.isnan(known).any(axis=1)]])
    low, high = around.min(axis=0), around.max(axis=0)
    room = MARGIN * max(high - low)
    for step in range(len(job.times))[shown]:
        places = _places(job, step)
        axes.plot(*places.T, ".", color="0.6", markersize=3, label="plot" if step == 0 else None)
    if "cloud" in history.kept:
        for place, step in enumerate(moments):
            cloud = np.asarray(history.kept["cloud"])[step, :2] / 1e3
            axes.plot(*cloud, ".", color=COLORS[5], markersize=2.5, alpha=0.6, label=None if place else "particle")
    if known is not None:
        axes.plot(*known[shown].T, color=TRUE, linewidth=2.2, label="truth")
        axes.plot(*known[moments].T, "o", color=TRUE, markersize=5)
    axes.plot(*mean[shown].T, color=ESTIMATE, linewidth=1.0, label="estimate")
    if known is not None:
        axes.plot(*(np.asarray(job.without.mean)[shown, :2].T / 1e3), color=INERTIAL, linewidth=1.0, label="notch not known")
    axes.set(title="Plane, seen from the radar at (0, 0)", xlabel="east, km", ylabel="north, km", aspect="equal",
             xlim=(low[0] - room, high[0] + room), ylim=(low[1] - room, high[1] + room))  # fmt: skip


def _places(job: Any, step: int) -> np.ndarray:
    """East and north `(m, 2)` of the plots of a scan, km."""
    rows = np.asarray(job.ys.value, np.float64)[step]
    rows = rows[~np.isnan(rows).any(axis=1)]
    return rows[:, :1] / 1e3 * np.stack([np.cos(rows[:, 1]), np.sin(rows[:, 1])], axis=1)


def _draw_rates(axes: Any, history: History, job: Any, upto: int) -> None:
    seconds = job.times[: upto + 1]
    axes.axhspan(-job.radar.notch, job.radar.notch, color=NOTCH, linewidth=0, zorder=0)
    axes.text(job.times[0], 0, " notch", va="center", color="0.35", fontsize="small")
    for step in range(upto + 1):
        rows = np.asarray(job.ys.value)[step]
        rates = rows[~np.isnan(rows).any(axis=1), 2]
        axes.plot(np.full(rates.shape, job.times[step]), rates, ".", color="0.6", markersize=3)
    if "cloud" in history.kept:
        cloud = range_rate(np.moveaxis(np.asarray(history.kept["cloud"])[: upto + 1], 1, -1))
        axes.plot(np.repeat(seconds, cloud.shape[1]), cloud.ravel(), ".", color=COLORS[5], markersize=1.5, alpha=0.4)
    if job.truth is not None:
        axes.plot(seconds, range_rate(np.asarray(job.truth)[: upto + 1]), color=TRUE, linewidth=1.6)
    axes.plot(seconds, range_rate(np.asarray(history.mean)[: upto + 1]), color=ESTIMATE, linewidth=1.0)
    most = 1.3 * np.nanmax(np.abs(range_rate(np.asarray(history.mean))))
    axes.set(title="Range rate, m/s", ylim=(-most, most), xlim=(job.times[0], max(job.times[-1], job.times[0] + 1)))


def _draw_errors(axes: Any, history: History, job: Any) -> None:
    edges = np.flatnonzero(np.diff(np.concatenate([[False], job.hidden, [False]]).astype(int)))
    for begin, end in edges.reshape(-1, 2):
        axes.axvspan(job.times[begin], job.times[end - 1], color=NOTCH, linewidth=0, zorder=0)
    cov = np.asarray(history.cov)
    axes.fill_between(job.times, 0, 2 * np.sqrt(cov[:, 0, 0] + cov[:, 1, 1]), color=ESTIMATE, alpha=0.22, linewidth=0,
                      label="two standard deviations")  # fmt: skip
    axes.plot(job.times, job.errors(history), color=ESTIMATE, linewidth=1.2, label="error")
    axes.plot(job.times, job.errors(job.without), color=INERTIAL, linewidth=1.2, label="error, notch not known")
    axes.set(title="Error of the position, m; the radar is blind where it is grey", yscale="log", ylim=(10, None))
    axes.legend(loc="upper left", ncols=1, frameon=False, fontsize="small")


def tracks_figure(history: History, job: Any) -> Any:
    """Draw all tracks over plots and truth on the plane; beside it their existence, and when targets are there where that is known.

    Args:
        history: with `states`, `exists` and `confirmed` of the tracks.
        job: what was run.

    Raises:
        MissingExtraError: matplotlib is not installed.
    """
    figure = new_figure(12, 6)
    knows = job.truth is not None and len(job.targets) > 0
    axes = figure.subplot_mosaic([["plane", "exists"], ["plane", "targets"]] if knows else [["plane", "exists"]])
    for one in axes.values():
        tidy(one)
    places = job.places(history) / 1e3
    _draw_tracks(axes["plane"], places, job)
    for track in range(places.shape[1]):
        exists = np.where(history.kept["exists"][:, track] > 0, history.kept["exists"][:, track], np.nan)
        axes["exists"].plot(job.times, exists, color=COLORS[track % len(COLORS)], linewidth=1.0)
    axes["exists"].set(title="Probability that the target of a track exists", ylim=(-0.03, 1.05),
                       xlim=(job.times[0], max(job.times[-1], job.times[0] + 1)))  # fmt: skip
    if knows:
        _draw_targets(axes["targets"], history, job)
        axes["targets"].sharex(axes["exists"])
    axes["targets" if knows else "exists"].set_xlabel("time, s")
    legend_below(figure, axes["plane"], 4)
    return figure


def _draw_tracks(axes: Any, places: np.ndarray, job: Any) -> None:
    """Draw plots, truth and tracks `(t, m, 2)`, km, each with its number where it begins."""
    for step in range(len(job.times)):
        axes.plot(*_places(job, step).T, ".", color="0.7", markersize=2, label="plot" if step == 0 else None, zorder=0)
    known = np.zeros((0, 2)) if job.truth is None else np.asarray(job.truth)[..., :2] / 1e3
    for target in range(known.shape[1] if known.ndim == 3 else 0):
        axes.plot(*known[:, target].T, color=TRUE, linewidth=3.0, alpha=0.35, label=None if target else "truth")
    for track in range(places.shape[1]):
        color, began = COLORS[track % len(COLORS)], int(np.argmax(~np.isnan(places[:, track, 0])))
        axes.plot(*places[:, track].T, color=color, linewidth=1.2, label=None if track else "track, numbered where it is confirmed")
        axes.annotate(str(track + 1), places[began, track], color=color, fontsize="small", xytext=(3, 3), textcoords="offset points",
                      clip_on=True)  # fmt: skip
    axes.plot(0, 0, "^", color="tab:red", markersize=8, label="radar")
    shown = np.concatenate([places.reshape(-1, 2), known.reshape(-1, 2), np.zeros((1, 2))])
    shown = shown[~np.isnan(shown).any(axis=1)]
    low, high = shown.min(axis=0), shown.max(axis=0)
    room = MARGIN * max(1.0, *(high - low))
    axes.set(title="Plane, seen from the radar", xlabel="east, km", ylabel="north, km", aspect="equal",
             xlim=(low[0] - room, high[0] + room), ylim=(low[1] - room, high[1] + room))  # fmt: skip


def _draw_targets(axes: Any, history: History, job: Any) -> None:
    """Draw for each target when it is there and, in the color of its track, when it is followed."""
    judged = job.judged(history)
    for row, (there, tracks) in enumerate(zip(judged.there.T, judged.followers.T, strict=True)):
        axes.plot(job.times, np.where(there, row, np.nan), color=TRUE, linewidth=6, alpha=0.25, solid_capstyle="butt")
        for track in set(tracks[tracks >= 0].tolist()):
            axes.plot(job.times, np.where(tracks == track, row, np.nan), color=COLORS[track % len(COLORS)], linewidth=2.5, marker=".",
                      markersize=2)  # fmt: skip
    some = range(0, len(job.targets), max(1, len(job.targets) // 12))
    axes.set(title="Targets: there (broad), and followed by a track (its color)", ylim=(len(job.targets) - 0.4, -0.6), yticks=list(some),
             yticklabels=[job.targets[row] for row in some])  # fmt: skip
