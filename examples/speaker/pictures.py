"""The room from above with path, cloud and truth, and the error over time."""

from typing import Any, NamedTuple

import numpy as np
from delays import FRAME
from room import Room

from motes.plotting.figures import COLORS, ESTIMATE, OTHER, TRUE, new_figure, tidy

LIGHT = COLORS[5]
MOMENTS = 5


class Shown(NamedTuple):
    """What is drawn of a run.

    Attributes:
        mean: of the filter, `(t, 2)`.
        cloud: some particles, `(t, 2, k)`.
        sound: which frames are not silent, `(t,)`.
        path: true places `(t, 2)`; None where nobody knows them.
        frames: places found frame by frame, `(t, 2)`.
    """

    mean: np.ndarray
    cloud: np.ndarray
    sound: np.ndarray
    path: np.ndarray | None
    frames: np.ndarray


def picture(room: Room, shown: Shown) -> Any:
    """Draw a run.

    Raises:
        MissingExtraError: matplotlib is not installed.
    """
    figure = new_figure(9, 6.6)
    grid = figure.add_gridspec(2, 1, height_ratios=(2.6, 1))
    above, below = figure.add_subplot(grid[0]), figure.add_subplot(grid[1])
    plan(above, room, shown)
    over_time(below, shown)
    handles, names = above.get_legend_handles_labels()
    own, words = below.get_legend_handles_labels()
    fresh = [place for place, word in enumerate(words) if word not in names]
    figure.legend(handles + [own[i] for i in fresh], names + [words[i] for i in fresh],
                  loc="outside lower center", ncols=3, frameon=False, markerscale=1.5)  # fmt: skip
    return figure


def plan(axes: Any, room: Room, shown: Shown) -> None:
    """Draw the room from above."""
    axes.plot(*shown.frames[shown.sound].T, ".", color="0.75", markersize=2.5, label="frame by frame")
    moments = np.linspace(0.1, 0.95, MOMENTS) * len(shown.mean)
    for place, step in enumerate(moments.astype(int)):
        axes.plot(*shown.cloud[step], ".", color=LIGHT, markersize=2, alpha=0.5, label=None if place else f"particles at {MOMENTS} times")
    if shown.path is not None:
        axes.plot(*shown.path.T, color=TRUE, linewidth=1.4, label="truth")
    settled = shown.mean[round(1 / FRAME) :]
    axes.plot(*settled.T, color=ESTIMATE, linewidth=1.2, label="particle filter")
    for step in moments.astype(int):
        axes.plot(*shown.mean[step], "o", color=ESTIMATE, markersize=5)
    for name, pair in zip(room.names, room.microphones, strict=True):
        axes.plot(*pair[:, :2].T, "s", color=OTHER, markersize=6, label="microphones" if name == room.names[0] else None, clip_on=False)
    axes.set(xlim=(0, room.size[0]), ylim=(0, room.size[1]), aspect="equal", xlabel="m", ylabel="m")


def over_time(axes: Any, shown: Shown) -> None:
    """Draw errors over time or, where nobody knows the truth, the spread of the cloud; silence is grey."""
    tidy(axes)
    seconds = FRAME * np.arange(len(shown.mean))
    axes.fill_between(seconds, 0, 1, where=~shown.sound, transform=axes.get_xaxis_transform(), color="0.92", linewidth=0, step="mid",
                      label="silence")  # fmt: skip
    if shown.path is None:
        axes.plot(seconds, np.sqrt(shown.cloud.var(axis=2).sum(axis=1)), color=ESTIMATE, linewidth=1.2)
        axes.set(ylabel="spread of particles, m")
    else:
        loud = np.linalg.norm(shown.frames - shown.path, axis=1)
        axes.plot(seconds[shown.sound], loud[shown.sound], ".", color="0.75", markersize=2.5, label="frame by frame")
        axes.plot(seconds, np.linalg.norm(shown.mean - shown.path, axis=1), color=ESTIMATE, linewidth=1.2, label="particle filter")
        axes.set(ylabel="error, m")
    axes.set(xlabel="seconds", xlim=(0, seconds[-1]))
    axes.set_ylim(0, min(axes.get_ylim()[1], 2.5))
