"""One run in pictures: frames as they are, the same with cloud and truth, and what both trackers make of existence over time."""

from typing import Any

import numpy as np
from trials import APPEARS, STEPS, VANISHES, Found

from motes.plotting.animation import Animation
from motes.plotting.figures import ESTIMATE, INERTIAL, TRUE, legend_below, new_figure, tidy

MOMENTS = (APPEARS - 4, APPEARS + 2, APPEARS + 8, (APPEARS + VANISHES) // 2, VANISHES - 2, VANISHES + 5)


class Shown:
    """What is drawn of a run.

    Args:
        film: frames `(t, size, size)`.
        truth: states `(t, 6)`.
        direct: what track before detect found in this run, each array with one run.
        through: the same of tracking through plots.
        cloud: some particles of track before detect `(t, 6, k)`.
    """

    def __init__(self, film: np.ndarray, truth: np.ndarray, direct: Found, through: Found, cloud: np.ndarray):
        """Take it."""
        self.film, self.truth, self.direct, self.through, self.cloud = film, truth, direct, through, cloud

    def frame(self, axes: Any, step: int, told: bool) -> None:
        """Draw a frame, and what is known of it if `told`."""
        # few greys, so that colors remain for the rest in an animation
        axes.imshow(np.round(2 * self.film[step]) / 2, cmap="gray", vmin=-2, vmax=4, interpolation="nearest")
        if told:
            there = self.cloud[step, 5] > 0.5
            axes.plot(*self.cloud[step, :2, there].T, ".", color="#56b4e9", markersize=3, label="particles with a target")
            if self.truth[step, 5]:
                ring = {"markersize": 15, "markeredgewidth": 1.6, "markerfacecolor": "none", "color": "#e69f00"}
                axes.plot(*self.truth[step, :2], "o", **ring, label="truth")
        axes.set(xticks=[], yticks=[], xlim=(-0.5, self.film.shape[2] - 0.5), ylim=(self.film.shape[1] - 0.5, -0.5))

    def existence(self, axes: Any, upto: int = STEPS - 1) -> None:
        """Draw the probabilities of existence up to a frame."""
        tidy(axes)
        axes.axvspan(APPEARS - 0.5, VANISHES - 0.5, color="0.9", linewidth=0, label="the target is there")
        steps = np.arange(upto + 1)
        for found, name, color in ((self.direct, "track before detect", ESTIMATE), (self.through, "through plots", INERTIAL)):
            axes.plot(steps, found.exists[0, : upto + 1], color=color, linewidth=1.6, label=name)
        axes.set(xlim=(0, STEPS - 1), ylim=(-0.02, 1.02), xlabel="frame", title="Probability that there is a target")

    def figure(self) -> Any:
        """Draw frames at some moments, without and with the truth, and existence below.

        Raises:
            MissingExtraError: matplotlib is not installed.
        """
        figure = new_figure(11, 6.4)
        grid = figure.add_gridspec(3, len(MOMENTS), height_ratios=(1, 1, 1.1))
        for column, step in enumerate(MOMENTS):
            for row, told in enumerate((False, True)):
                axes = figure.add_subplot(grid[row, column])
                self.frame(axes, step, told)
                if not row:
                    axes.set_title(f"frame {step}", fontsize=10)
        below = figure.add_subplot(grid[2, :])
        self.existence(below)
        for step in MOMENTS:
            below.axvline(step, color=TRUE, linewidth=0.6, linestyle=":")
        handles, names = figure.axes[2 * (len(MOMENTS) // 2) + 1].get_legend_handles_labels()
        own, words = below.get_legend_handles_labels()
        figure.legend(handles + own, names + words, loc="outside lower center", ncols=5, frameon=False)
        return figure

    def animation(self) -> Animation:
        """Return the run in motion: the frame as it is, the frame with cloud and truth, existence up to now."""

        def draw(step: int) -> Any:
            figure = new_figure(9, 3.6)
            axes = figure.subplot_mosaic([["frame", "cloud", "exists"]], width_ratios=(1, 1, 1.4))
            self.frame(axes["frame"], step, False)
            self.frame(axes["cloud"], step, True)
            self.existence(axes["exists"], step)
            axes["frame"].set_title(f"frame {step}")
            axes["cloud"].set_title("cloud and truth")
            legend_below(figure, axes["exists"], 3)
            return figure

        return Animation(draw, STEPS)
