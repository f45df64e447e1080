"""Pictures of a flight over terrain: the map with its tracks, and the error against time."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from motes.core.checks import need
from motes.models.terrain import TerrainMap
from motes.plotting.figures import COLORS, ESTIMATE, INERTIAL, TRUE, WORDS, legend_below, new_figure, tidy, two_sigma

MARGIN = 3000.0
"""Meters of map shown around the tracks."""
ELLIPSES = 10


class Tracks(NamedTuple):
    """Horizontal tracks, each a pair of north and east `(t,)` in meters.

    Attributes:
        inertial: of the inertial navigation system.
        estimate: of the filter.
        covs: the filter's covariances of north and east, `(t, 2, 2)`, m^2.
        true: None if not known.
    """

    inertial: tuple[np.ndarray, np.ndarray]
    estimate: tuple[np.ndarray, np.ndarray]
    covs: np.ndarray
    true: tuple[np.ndarray, np.ndarray] | None = None


def map_figure(terrain: TerrainMap, tracks: Tracks, title: str = "") -> Any:
    """Draw the hillshaded map with true, inertial and estimated track, and a few two-sigma ellipses of the estimate.

    Args:
        terrain: the map.
        tracks: in its meters.
        title: over the picture.
    """
    shown = [track for track in (tracks.inertial, tracks.true, tracks.estimate) if track is not None]
    (south, north), (west, east) = (_reach(terrain, shown, side) for side in (0, 1))
    # the figure takes the shape of the map, within reason, so that little of it stays empty
    figure = new_figure(8.2, min(max(6.6 * (north - south) / (east - west), 3.0), 11.0) + 1.1)
    axes = figure.add_subplot()
    tint = ground(axes, terrain)
    figure.colorbar(tint, ax=axes, label="height, m", shrink=0.7).ax.set_ylim(tint.get_array().min(), tint.get_array().max())
    if tracks.true is not None:
        _draw_track(axes, tracks.true, color=TRUE, linewidth=4.0, label="true")
    _draw_track(axes, tracks.inertial, color=INERTIAL, linewidth=2.0, linestyle="--", label="inertial")
    _draw_track(axes, tracks.estimate, color=ESTIMATE, linewidth=1.8, label="estimated")
    # the estimate usually settles soon: most ellipses belong to the beginning, where they can be seen
    last = len(tracks.covs) - 1
    for step in np.unique(np.geomspace(1, last + 1, ELLIPSES).astype(int)) - 1:
        # rows of the covariance are north, east
        place = np.array([tracks.estimate[1][step], tracks.estimate[0][step]]) / 1e3
        two_sigma(axes, place, np.asarray(tracks.covs[step])[::-1, ::-1] / 1e6, edgecolor=ESTIMATE, linewidth=1.1)
    axes.plot([], [], color=ESTIMATE, linewidth=1.0, label="2 sigma of the estimate")
    axes.set(aspect="equal", xlabel="east, km", ylabel="north, km", xlim=(west, east), ylim=(south, north))
    axes.set_title(title, **WORDS)
    legend_below(figure, axes, 4)
    return figure


def _draw_track(axes: Any, track: tuple[np.ndarray, np.ndarray], **look: Any) -> None:
    north, east = (np.asarray(part) / 1e3 for part in track)
    axes.plot(east, north, color="white", linewidth=look["linewidth"] + 2.5, zorder=2)
    axes.plot(east, north, zorder=3, solid_capstyle="butt", **look)


def ground(axes: Any, terrain: TerrainMap) -> Any:
    """Draw the hillshaded map on axes in km east and north, and return the picture of its heights."""
    heights, shade, extent = _shaded(terrain)
    lowest, highest = float(np.nanmin(heights)), float(np.nanmax(heights))
    axes.imshow(shade, cmap="gray", vmin=0, vmax=1, origin="upper", extent=extent)
    # the blue end of the colors lies below the lowest land
    return axes.imshow(heights, cmap="gist_earth", vmin=lowest - 0.35 * (highest - lowest), vmax=highest, origin="upper", extent=extent,
                       alpha=0.45)


def relief(terrain: TerrainMap) -> tuple[np.ndarray, tuple[float, float, float, float]]:
    """Return the map as a picture, uint8 `(rows, columns, 3)`, north at the top, and what it covers: west, east, south, north, km."""
    heights, shade, extent = _shaded(terrain)
    lowest, highest = float(np.nanmin(heights)), float(np.nanmax(heights))
    share = 0.26 + 0.74 * (heights - lowest) / max(highest - lowest, 1e-9)
    tint = need("matplotlib", "results").colormaps["gist_earth"](share)[..., :3]
    picture = np.where(np.isnan(heights)[..., None], 0.6, 0.55 * shade[..., None] + 0.45 * tint)
    return (255 * np.clip(picture, 0, 1)).astype(np.uint8), extent


def _shaded(terrain: TerrainMap) -> tuple[np.ndarray, np.ndarray, tuple[float, float, float, float]]:
    """Return heights and hillshade of the map, both north at the top, and what they cover: west, east, south, north, km."""
    heights = np.asarray(terrain.heights, np.float64)[::-1]
    filled = np.where(np.isnan(heights), np.nanmean(heights), heights)
    light = need("matplotlib.colors", "results").LightSource(azdeg=315, altdeg=45)
    shade = light.hillshade(filled, vert_exag=2.0, dx=float(terrain.de), dy=float(terrain.dn))
    north, east = (float(side) / 1e3 for side in terrain.size)
    half_row, half_column = float(terrain.dn) / 2e3, float(terrain.de) / 2e3
    return heights, shade, (-half_column, east + half_column, -half_row, north + half_row)


def _reach(terrain: TerrainMap, tracks: list[Any], side: int) -> tuple[float, float]:
    """Return from where to where the picture goes, km: the tracks and some map around them."""
    along = np.concatenate([np.asarray(track[side]) for track in tracks])
    low, high = float(along.min()), float(along.max())
    return max(low - MARGIN, min(0.0, low)) / 1e3, min(high + MARGIN, max(float(terrain.size[side]), high)) / 1e3


def error_figure(seconds: np.ndarray, errors: Mapping[str, np.ndarray], deviation: np.ndarray, lost: float, title: str = "") -> Any:
    """Draw horizontal errors against time.

    Args:
        seconds: time of each fix, `(t,)`.
        errors: horizontal error `(t,)` in meters of each filter by name, the first being the one that `deviation` belongs to.
        deviation: the first filter's own standard deviation of the horizontal error, `(t,)`, m.
        lost: error above which a run counts as lost, m.
        title: over the picture.
    """
    figure = new_figure(8.2, 4.6)
    axes = figure.add_subplot()
    tidy(axes)
    first = next(iter(errors))
    axes.fill_between(seconds, 1e-3, 2 * deviation, color=ESTIMATE, alpha=0.15, linewidth=0, label=f"2 sigma of {first}")
    for (name, error), color in zip(errors.items(), COLORS, strict=False):
        axes.plot(seconds, error, color=color, linewidth=1.6 if name == first else 1.1, label=name)
    axes.axhline(lost, color="0.35", linewidth=1.0, linestyle="--", label=f"lost above {lost:.0f} m")
    lowest = min(float(np.min(error[error > 0], initial=lost)) for error in errors.values())
    highest = max(float(np.max(error)) for error in errors.values())
    axes.set(yscale="log", ylim=(max(lowest / 1.5, 1.0), max(2 * highest, 2 * lost)), xlim=(seconds[0], max(seconds[-1], seconds[0] + 1)),
             xlabel="time, s", ylabel="horizontal error, m")
    axes.set_title(title, **WORDS)
    axes.yaxis.set_major_formatter(need("matplotlib.ticker", "results").FuncFormatter(lambda value, _: f"{value:g}"))
    legend_below(figure, axes, 3)
    return figure


def comparison_figure(seconds: np.ndarray, curves: Mapping[str, np.ndarray], title: str = "") -> Any:
    """Draw root mean square errors of position and velocity against time, one over the other (figures 2 and 3 of Dahia et al. 2004).

    Args:
        seconds: time of each fix, `(t,)`.
        curves: name to errors in m and m/s, `(t, 2)`; what is named "bound" is drawn dotted.
        title: over the picture.
    """
    figure = new_figure(8.2, 7.0)
    colors = iter(COLORS)
    looks = {name: {"color": "black", "linestyle": ":"} if name == "bound" else {"color": next(colors)} for name in curves}
    for place, label in enumerate(("horizontal position, m", "horizontal velocity, m/s")):
        axes = figure.add_subplot(2, 1, place + 1)
        tidy(axes)
        for name, curve in curves.items():
            axes.plot(seconds, curve[:, place], label=name, **looks[name])
        axes.set(yscale="log", ylabel=f"RMSE, {label}")
        axes.set_title("" if place else title, **WORDS)
    axes.set(xlabel="time, s")
    legend_below(figure, axes, 3)
    return figure
