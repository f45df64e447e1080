"""Pictures of a robot in a building: the map with the way, particles and clusters, the errors; and the same in motion."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from motes.applications.laser.grid import Grid
from motes.filters.history import History
from motes.laws.clusters import Clusters, clusters
from motes.plotting.animation import Animation, moments
from motes.plotting.figures import COLORS, ESTIMATE, INERTIAL, TRUE, legend_below, new_figure, tidy, two_sigma

PICTURES = 80
EARLY = 2
"""Small maps of moments at which the robot may be at several places."""
APART = 1.0
"""Meters: a law with a smaller standard deviation of the place is one place, whatever its shape."""
PLACES, LEAST = 8, 0.05
"""Most clusters of a moment, and the share below which one is not drawn."""


def building_figure(history: History, job: Any) -> Any:
    """Draw the map while the robot may be at several places, and at the end; below that, where the truth is known, the error.

    Raises:
        MissingExtraError: matplotlib is not installed.
    """
    knows, wide = job.truth is not None, _wide(history)
    several = np.flatnonzero(wide)
    early = several[[0, -1]][: min(EARLY, len(several))]
    columns = max(len(early), 1)
    rows, heights = [["map"] * columns], [3.9]
    if len(early):
        rows, heights = [[f"early {i}" for i in range(columns)], *rows], [4.2 / columns, *heights]
    if knows:
        rows, heights = [*rows, ["error"] * columns], [*heights, 1.2]
    figure = new_figure(7, sum(heights) + 1.2)
    axes = figure.subplot_mosaic(rows, height_ratios=heights)
    for i, step in enumerate(early):
        small = axes[f"early {i}"]
        _draw(small, history, job, int(step))
        small.set(xlabel="", ylabel="", xticks=[], yticks=[])
    way = np.where(wide[:, None], np.nan, np.asarray(history.mean)[:, :2])
    axes["map"].plot(*way.T, color=ESTIMATE, linewidth=1.0, zorder=3, label="estimated way")
    _draw(axes["map"], history, job, len(job.times) - 1)
    if knows:
        tidy(axes["error"])
        axes["error"].plot(job.times, job.errors(history), color=ESTIMATE, linewidth=1.0)
        axes["error"].set(title="Error of the place, m", xlabel="time, s", yscale="log")
    legend_below(figure, axes["map"], 3)
    return figure


def building_animation(history: History, job: Any) -> Animation:
    """Return the particles in motion; most pictures are of the beginning."""
    shown = moments(len(job.times), PICTURES)

    def draw(number: int) -> Any:
        figure = new_figure(6.4, 5)
        axes = figure.add_subplot()
        _draw(axes, history, job, int(shown[number]))
        legend_below(figure, axes, 3)
        return figure

    return Animation(draw, len(shown))


def floor(grid: Grid) -> tuple[np.ndarray, tuple[float, float, float, float]]:
    """Return a map as a picture, uint8 `(rows, columns, 3)`, north at the top, and what it covers: west, east, south, north, m."""
    x, y = grid.origin
    rows, columns = grid.occupied.shape
    shades = np.where(grid.occupied, 64, np.where(grid.free, 255, 217)).astype(np.uint8)[::-1]
    return np.repeat(shades[..., None], 3, axis=2), (x, x + columns * grid.resolution, y, y + rows * grid.resolution)


def _wide(history: History) -> np.ndarray:
    """Whether the robot may be at places that lie apart, at each step."""
    return np.einsum("tii->t", np.asarray(history.cov, np.float64)[:, :2, :2]) > APART**2


@jax.jit
def _clusters_of(points: jax.Array) -> Clusters:
    """Clusters of particles `(2, n)` of equal weights."""
    return clusters(points, jnp.full(points.shape[1], -jnp.log(points.shape[1]), points.dtype), PLACES)


def _draw(axes: Any, history: History, job: Any, step: int) -> None:
    picture, extent = floor(job.grid)
    axes.imshow(picture, origin="upper", extent=extent, interpolation="nearest")
    if job.truth is not None:
        # a line across the jump of a kidnapping would be no way
        way = np.array(job.truth[: step + 1, :2])
        way[1:][np.hypot(*np.diff(way, axis=0).T) > 1.5] = np.nan
        axes.plot(*way.T, color=TRUE, linewidth=1.8, label="true way")
        axes.plot(*job.truth[step, :2], "o", markerfacecolor="none", color=TRUE, markersize=11, label="truth")
    if "cloud" in history.kept:
        axes.plot(*np.asarray(history.kept["cloud"])[step, :2], ".", color=COLORS[5], markersize=3, label="particle")
    apart = _wide(history)[step] and "cloud" in history.kept
    estimate = ([], []) if apart else np.asarray(history.mean)[step, :2]
    axes.plot(*estimate, "o", color=ESTIMATE, markersize=7, label="estimate")
    if apart:
        found = _clusters_of(jnp.asarray(history.kept["cloud"][step, :2]))
        for place, cov, share in zip(*(np.asarray(part) for part in found), strict=True):
            if share >= LEAST:
                two_sigma(axes, place, cov, edgecolor=INERTIAL, linewidth=1.4)
                top = place + [0, 2 * np.sqrt(cov[1, 1])]
                axes.text(*top, f"{100 * share:.0f} %", color=INERTIAL, ha="center", va="bottom", zorder=5, clip_on=True,
                          bbox={"facecolor": "white", "alpha": 0.8, "linewidth": 0, "pad": 1})  # fmt: skip
    axes.plot([], [], color=INERTIAL, linewidth=1.4, label="place, with its share")
    axes.set(xlabel="x, m", ylabel="y, m", aspect="equal", xlim=extent[:2], ylim=extent[2:], title=f"{job.times[step]:.1f} s")
