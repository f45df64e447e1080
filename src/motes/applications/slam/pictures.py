"""Pictures of a map that a robot makes: the ways, the landmarks with what is left open of them; and how they came to be."""

from typing import Any

import numpy as np

from motes.applications.slam.job import laid_on
from motes.filters.history import History
from motes.plotting.animation import Animation, moments
from motes.plotting.figures import COLORS, ESTIMATE, INERTIAL, TRUE, legend_below, new_figure, tidy

PICTURES = 60
"""Of the animation."""
LEAST = 0.004
"""Share below which a Gaussian of a landmark is not drawn."""
MARGIN = 0.15


def map_figure(history: History, job: Any) -> Any:
    """Draw the map with the ways; beside it, where the truth is known, the error of the path.

    Args:
        history: with the particles' ancestors, and with "places" and "shares" of the landmarks.
        job: what was run.

    Raises:
        MissingExtraError: matplotlib is not installed.
    """
    knows = job.way.truth is not None
    figure = new_figure(12 if knows else 8, 6.5)
    axes = figure.subplot_mosaic([["map", "error"]], width_ratios=[1.4, 1]) if knows else {"map": figure.add_subplot()}
    for one in axes.values():
        tidy(one)
    path = job.path(history)
    laid = laid_on(job.way.truth, path) if knows else (lambda points: points)
    _draw_truth(axes["map"], job)
    alone = laid_on(job.way.truth, job.way.alone)(job.way.alone) if knows else job.way.alone
    axes["map"].plot(*alone.T, color=INERTIAL, linewidth=0.7, label="odometry alone")
    axes["map"].plot(*laid(path).T, color=ESTIMATE, linewidth=1.0, label="estimate")
    places = laid(job.landmarks(history))
    axes["map"].plot(*places.T, "o", color=COLORS[3], markersize=4, label="landmark")
    _look(axes["map"], np.concatenate([laid(path), places, *([job.way.places] if job.way.places is not None else [])]))
    axes["map"].set_title("Map")
    if knows:
        apart = np.hypot(*(laid(path) - job.way.truth).T)
        there = ~np.isnan(apart)
        steps = np.flatnonzero(there) if job.times is None else job.times[there]
        axes["error"].plot(steps, apart[there], color=ESTIMATE, linewidth=0.8)
        axes["error"].set(title=f"Error of the path, m: {np.sqrt(np.mean(apart[there] ** 2)):.2f} RMS",
                          xlabel="step" if job.times is None else "time, s", ylim=(0, None))  # fmt: skip
    legend_below(figure, axes["map"], 5)
    return figure


def map_animation(history: History, job: Any) -> Animation:
    """Return how the map came to be, as the best particle of each moment had it."""
    shown = moments(len(job.way.alone), PICTURES)
    mean = np.asarray(history.mean, np.float64)[:, :2]
    knows = job.way.truth is not None
    laid = laid_on(job.way.truth, job.path(history)) if knows else (lambda points: points)
    last = laid(job.landmarks(history))
    seen = np.concatenate([laid(mean), last, *([job.way.places] if job.way.places is not None else [])])

    def draw(number: int) -> Any:
        step = int(shown[number])
        figure = new_figure(6.4, 6)
        axes = figure.add_subplot()
        tidy(axes)
        _draw_truth(axes, job)
        particles = np.asarray(history.law.particles[step], np.float64)[:2]
        axes.plot(*laid(mean[: step + 1]).T, color=ESTIMATE, linewidth=0.9, label="estimate")
        axes.plot(*laid(particles.T).T, ".", color=COLORS[5], markersize=2, label="particle")
        places, shares = (np.asarray(history.kept[name][step], np.float64) for name in ("places", "shares"))
        drawn = shares > LEAST
        axes.scatter(*laid(places[drawn]).T, s=90 * np.sqrt(shares[drawn]), color=COLORS[3], alpha=0.55, linewidth=0, label="landmark")
        _look(axes, seen)
        axes.set_title(f"step {step}" if job.times is None else f"{job.times[step]:.0f} s")
        legend_below(figure, axes, 5)
        return figure

    return Animation(draw, len(shown))


def _draw_truth(axes: Any, job: Any) -> None:
    if job.way.truth is None:
        return
    known = job.way.truth[~np.isnan(job.way.truth).any(axis=1)]
    axes.plot(*known.T, color=TRUE, linewidth=1.6, label="truth")
    if job.way.places is not None:
        axes.plot(*job.way.places.T, "x", color=TRUE, markersize=6, label="true landmark")


def _look(axes: Any, points: np.ndarray) -> None:
    known = points[~np.isnan(points).any(axis=1)]
    low, high = known.min(axis=0), known.max(axis=0)
    room = MARGIN * max(high - low)
    axes.set(xlabel="x, m", ylabel="y, m", aspect="equal", xlim=(low[0] - room, high[0] + room), ylim=(low[1] - room, high[1] + room))
