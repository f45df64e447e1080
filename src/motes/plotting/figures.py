"""What all pictures share: figures without a window or global state, and colors that also color-blind readers tell apart."""

import io
from collections.abc import Sequence
from functools import cache
from typing import Any

import numpy as np

from motes.core.checks import need

TRUE, ESTIMATE, INERTIAL, OTHER = "#111111", "#0072b2", "#d55e00", "#009e73"
COLORS = (ESTIMATE, INERTIAL, OTHER, "#cc79a7", "#e69f00", "#56b4e9")
DASHED = {"color": TRUE, "linewidth": 1.0, "linestyle": (0, (4, 2))}
"""Line of what estimates are held against: the truth, or a bound."""
COLUMNS = 3
"""So many panels are side by side."""
ALONE, BESIDE = 6.5, 4.0
"""Inches that a panel over time is wide, alone and among others."""
ENTRY = 1.3
"""Inches that an entry of a legend takes."""
ALIKE = 6
"""Lengths of axes that differ by less are drawn to one scale."""
WORDS = {"parse_math": False, "usetex": False}
"""Of every text with names that the user gave: dollars and backslashes in it are no mathematics."""


def new_figure(width: float, height: float) -> Any:
    """Return an empty matplotlib `Figure` of so many inches, ready to be saved, which shows in a notebook.

    Raises:
        MissingExtraError: matplotlib is not installed.
    """
    figure = _picture()(figsize=(width, height), layout="constrained")
    need("matplotlib.backends.backend_agg", "results").FigureCanvasAgg(figure)
    return figure


@cache
def _picture() -> Any:
    """Return the class of our figures: notebooks show matplotlib's own only where pyplot was imported, which has a global state."""

    class Picture(need("matplotlib.figure", "results").Figure):
        def _repr_png_(self) -> bytes:
            file = io.BytesIO()
            self.savefig(file, format="png", dpi=100)
            return file.getvalue()

    return Picture


def legend_below(figure: Any, axes: Any, columns: int) -> None:
    """Put the legend of some axes under the picture, where it hides no data."""
    handles, labels = axes.get_legend_handles_labels()
    columns = min(columns, max(1, int(figure.get_figwidth() / ENTRY)))
    for text in figure.legend(handles, labels, loc="outside lower center", ncols=columns, frameon=False).get_texts():
        text.set(**WORDS)


def tidy(axes: Any) -> None:
    """Remove the frame's upper and right line and draw a light grid."""
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(True, color="0.9", linewidth=0.8)
    axes.set_axisbelow(True)


def two_sigma(axes: Any, place: Any, cov: Any, **look: Any) -> None:
    """Draw the ellipse of two standard deviations.

    Args:
        axes: to draw on.
        place: its middle, `(2,)`, along the two axes.
        cov: covariance there, `(2, 2)`.
        look: such as color and linewidth.
    """
    variances, directions = np.linalg.eigh(cov)
    width, height = 4 * np.sqrt(np.maximum(variances, 0))
    angle = np.degrees(np.arctan2(directions[1, 0], directions[0, 0]))
    patches = need("matplotlib.patches", "results")
    axes.add_patch(patches.Ellipse(tuple(place), width, height, angle=angle, fill=False, zorder=4, **look))


def state_panels(names: Sequence[str], wide: bool = False, label: str = "step") -> tuple[Any, list[Any]]:
    """Return a figure and its axes over time: one titled panel per state, up to three in a row, and perhaps a wide one under them.

    Args:
        names: of the states.
        wide: whether there is one more.
        label: what the horizontal axis shows.
    """
    columns = min(COLUMNS, len(names))
    state_rows = -(-len(names) // columns)
    rows = state_rows + wide
    figure = new_figure(ALONE if columns == 1 else BESIDE * columns, 2.1 * rows + 0.6)
    grid = figure.add_gridspec(rows, columns)
    for state, name in enumerate(names):
        figure.add_subplot(grid[state // columns, state % columns]).set_title(name, fontsize=10, **WORDS)
    if wide:
        figure.add_subplot(grid[state_rows, :])
    for axes in figure.axes:
        tidy(axes)
    figure.axes[-1].set_xlabel(label, **WORDS)
    return figure, figure.axes


def over_time(figure: Any, times: np.ndarray) -> None:
    """Let all axes of a figure show the same times: dates, numbers or steps, of which there is at least one."""
    for axes in figure.axes:
        if times.dtype.kind == "M":
            dates = need("matplotlib.dates", "results")
            ticks = dates.AutoDateLocator(minticks=3, maxticks=6)
            axes.xaxis.set_major_locator(ticks)
            axes.xaxis.set_major_formatter(dates.ConciseDateFormatter(ticks))
        elif times.dtype.kind in "iu":
            axes.xaxis.set_major_locator(need("matplotlib.ticker", "results").MaxNLocator(6, integer=True))
        if times[-1] > times[0]:
            axes.set_xlim(times[0], times[-1])
        elif times.dtype.kind != "M":
            axes.set_xlim(times[0], times[0] + 1)


def one_scale(axes: Any) -> None:
    """Let both axes have one scale, unless one reaches so much further than the other that little would be seen of it."""
    spans = [abs(high - low) for low, high in (axes.get_xlim(), axes.get_ylim())]
    if min(spans) * ALIKE > max(spans):
        axes.set_aspect("equal", adjustable="datalim")
