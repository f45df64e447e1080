"""What all pictures share: figures without a window or global state, and colors that also color-blind readers tell apart."""

from typing import Any

from motes.core.checks import need

TRUE, ESTIMATE, INERTIAL, OTHER = "#111111", "#0072b2", "#d55e00", "#009e73"
COLORS = (ESTIMATE, INERTIAL, OTHER, "#cc79a7", "#e69f00", "#56b4e9")


def new_figure(width: float, height: float) -> Any:
    """Return an empty matplotlib `Figure` of so many inches, ready to be saved.

    Raises:
        MissingExtraError: matplotlib is not installed.
    """
    figure = need("matplotlib.figure", "results").Figure(figsize=(width, height), layout="constrained")
    need("matplotlib.backends.backend_agg", "results").FigureCanvasAgg(figure)
    return figure


def legend_below(figure: Any, axes: Any, columns: int) -> None:
    """Put the legend of some axes under the picture, where it hides no data."""
    handles, labels = axes.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=columns, frameon=False)


def tidy(axes: Any) -> None:
    """Remove the frame's upper and right line and draw a light grid."""
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(True, color="0.9", linewidth=0.8)
    axes.set_axisbelow(True)
