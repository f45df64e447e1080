"""Pictures of a robot in a building: the map with the way, particles and clusters, the errors; and the same in motion."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from motes.filters.history import History
from motes.laws.clusters import Clusters, clusters
from motes.plotting.animation import Animation, moments
from motes.plotting.figures import COLORS, ESTIMATE, INERTIAL, TRUE, legend_below, new_figure, tidy, two_sigma

PICTURES = 80
EARLY = 3
"""Small maps of moments at which the robot may be at several places."""
PLACES, LEAST = 8, 0.05
"""Most clusters of a moment, and the share below which one is not drawn."""


def building_figure(history: History, job: Any) -> Any:
    """Draw the map while the robot may be at several places, and at the end; below that, where the truth is known, the error.

    Raises:
        MissingExtraError: matplotlib is not installed.
    """
    knows = job.truth is not None
    found = places(history)
    several = np.flatnonzero(_count(found) > 1)
    early = several[np.linspace(0, len(several) - 1, min(EARLY, len(several))).astype(int)]
    rows = [*([[f"early {i}" for i in range(len(early))]] if len(early) else []), ["map"] * max(len(early), 1)]
    heights = [*([1.4] if len(early) else []), 4]
    if knows:
        rows, heights = [*rows, ["error"] * max(len(early), 1)], [*heights, 1.2]
    figure = new_figure(9, 1.6 * sum(heights))
    axes = figure.subplot_mosaic(rows, height_ratios=heights)
    for i, step in enumerate(early):
        small = axes[f"early {i}"]
        _draw(small, history, job, found, int(step), 2)
        small.set(title=f"{job.times[step]:.0f} s", xlabel="", ylabel="", xticks=[], yticks=[])
    last = len(job.times) - 1
    way = np.where((_count(found) == 1)[:, None], np.asarray(history.mean)[:, :2], np.nan)
    axes["map"].plot(*way.T, color=ESTIMATE, linewidth=1.0, zorder=3, label="estimated way, where it is one place")
    _draw(axes["map"], history, job, found, last, 3)
    axes["map"].set_title(f"{job.times[last]:.0f} s")
    if knows:
        tidy(axes["error"])
        axes["error"].plot(job.times, job.errors(history), color=ESTIMATE, linewidth=1.0)
        axes["error"].set(title="Error of the place, m", xlabel="time, s", yscale="log")
    legend_below(figure, axes["map"], 3)
    return figure


def building_animation(history: History, job: Any) -> Animation:
    """Return the particles in motion; most pictures are of the beginning."""
    shown, found = moments(len(job.times), PICTURES), places(history)

    def draw(number: int) -> Any:
        figure = new_figure(8, 5.6)
        axes = figure.add_subplot()
        step = int(shown[number])
        _draw(axes, history, job, found, step, 3)
        axes.set_title(f"{job.times[step]:.0f} s")
        legend_below(figure, axes, 4)
        return figure

    return Animation(draw, len(shown))


def places(history: History) -> Clusters:
    """Return the clusters of the particles that were kept, by place alone, time axis first; one of a law without particles."""
    if "cloud" not in history.kept:
        mean, cov = np.asarray(history.mean)[:, None, :2], np.asarray(history.cov)[:, None, :2, :2]
        return Clusters(mean, cov, np.ones(mean.shape[:2]))  # type: ignore[arg-type]
    cloud = jnp.asarray(history.kept["cloud"])[:, :2]
    even = jnp.full(cloud.shape[2], -np.log(cloud.shape[2]), cloud.dtype)
    return Clusters(*(np.asarray(one) for one in jax.lax.map(lambda points: clusters(points, even, PLACES), cloud)))


def _count(found: Clusters) -> np.ndarray:
    return (found.weight >= LEAST).sum(axis=-1)


def _draw(axes: Any, history: History, job: Any, found: Clusters, step: int, size: float) -> None:
    grid, (x, y) = job.grid, job.grid.origin
    rows, columns = grid.occupied.shape
    shades = np.where(grid.occupied, 0.25, np.where(grid.free, 1.0, 0.85))
    extent = (x, x + columns * grid.resolution, y, y + rows * grid.resolution)
    axes.imshow(shades, cmap="gray", vmin=0, vmax=1, origin="lower", extent=extent, interpolation="nearest")
    if job.truth is not None:
        # a line across the jump of a kidnapping would be no way
        way = np.array(job.truth[: step + 1, :2])
        way[1:][np.hypot(*np.diff(way, axis=0).T) > 1.5] = np.nan
        axes.plot(*way.T, color=TRUE, linewidth=0.6 * size, label="true way")
        axes.plot(*job.truth[step, :2], "o", markerfacecolor="none", color=TRUE, markersize=4 * size, label="truth")
    if "cloud" in history.kept:
        axes.plot(*np.asarray(history.kept["cloud"])[step, :2], ".", color=COLORS[5], markersize=size, label="particle")
    there = np.flatnonzero(found.weight[step] >= LEAST)
    if len(there) == 1:
        axes.plot(*np.asarray(history.mean)[step, :2], "o", color=ESTIMATE, markersize=2.5 * size, label="estimate")
    for one in there if len(there) > 1 else ():
        place = found.mean[step, one]
        two_sigma(axes, place, found.cov[step, one], edgecolor=INERTIAL, linewidth=0.5 * size)
        share = f"{100 * found.weight[step, one]:.0f} %"
        axes.text(*place, share, color=INERTIAL, fontsize=2 + 2 * size, ha="center", va="center", zorder=5)
    axes.plot([], [], color=INERTIAL, linewidth=0.5 * size, label="one of several places, and its share")
    axes.set(xlabel="x, m", ylabel="y, m", aspect="equal")
