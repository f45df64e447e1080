"""Pictures of a robot in a building: the map with the way and particles, the errors; and the same in motion."""

from typing import Any

import numpy as np

from motes.filters.history import History
from motes.plotting.animation import Animation
from motes.plotting.figures import COLORS, ESTIMATE, TRUE, legend_below, new_figure, tidy

PICTURES = 80


def building_figure(history: History, job: Any) -> Any:
    """Draw the map with the estimated way; below it, where the truth is known, the error.

    Raises:
        MissingExtraError: matplotlib is not installed.
    """
    knows = job.truth is not None
    figure = new_figure(10, 9 if knows else 6)
    axes = figure.subplot_mosaic([["map"], ["error"]], height_ratios=[3, 1]) if knows else {"map": figure.add_subplot()}
    _draw(axes["map"], history, job, len(job.times) - 1)
    if knows:
        tidy(axes["error"])
        axes["error"].plot(job.times, job.errors(history), color=ESTIMATE, linewidth=1.0)
        axes["error"].set(title="Error of the place, m", xlabel="time, s", yscale="log")
    legend_below(figure, axes["map"], 4)
    return figure


def building_animation(history: History, job: Any) -> Animation:
    """Return the particles in motion; most pictures are of the beginning."""
    moments = np.unique(np.round((len(job.times) - 1) * np.linspace(0, 1, PICTURES) ** 1.5).astype(int))

    def draw(number: int) -> Any:
        figure = new_figure(8, 5.6)
        axes = figure.add_subplot()
        step = int(moments[number])
        _draw(axes, history, job, step)
        axes.set_title(f"{job.times[step]:.0f} s")
        legend_below(figure, axes, 4)
        return figure

    return Animation(draw, len(moments))


def _draw(axes: Any, history: History, job: Any, step: int) -> None:
    grid, (x, y) = job.grid, job.grid.origin
    rows, columns = grid.occupied.shape
    shades = np.where(grid.occupied, 0.25, np.where(grid.free, 1.0, 0.85))
    extent = (x, x + columns * grid.resolution, y, y + rows * grid.resolution)
    axes.imshow(shades, cmap="gray", vmin=0, vmax=1, origin="lower", extent=extent, interpolation="nearest")
    if job.truth is not None:
        # a line across the jump of a kidnapping would be no way
        way = np.array(job.truth[: step + 1, :2])
        way[1:][np.hypot(*np.diff(way, axis=0).T) > 1.5] = np.nan
        axes.plot(*way.T, color=TRUE, linewidth=1.8, label="truth")
    if "cloud" in history.kept:
        axes.plot(*np.asarray(history.kept["cloud"])[step, :2], ".", color=COLORS[5], markersize=3, label="particle")
    axes.plot(*np.asarray(history.mean)[step, :2], "o", color=ESTIMATE, markersize=7, label="estimate")
    axes.set(xlabel="x, m", ylabel="y, m", aspect="equal")
