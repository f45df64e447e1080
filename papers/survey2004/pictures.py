"""How far above the exact answer each filter stays on the growth model, in one picture."""

from collections.abc import Sequence
from typing import Any

import numpy as np

import motes as mo
from motes.plotting.figures import COLORS, TRUE, legend_below, new_figure, tidy

MARKERS = "osD^v"


def growth_figure(table: mo.io.Table, numbers: Sequence[int]) -> Any:
    """Draw the errors of filters over that of the exact one, each with a mark for every number of particles.

    Args:
        table: of `over_growth`, the exact filter first.
        numbers: of particles, which end the names of filters that draw; the others get a black mark.
    """
    exact = table.column("RMSE")[0]
    ends = {f", {n}": n for n in numbers}
    places: dict[str, int] = {}
    groups: dict[str, list[tuple[int, float, float]]] = {"no particles": []} | {f"{n} particles": [] for n in numbers}
    columns = (table.column(name) for name in ("filter", "above exact, %", "s.e. of difference"))
    for name, above, error in list(zip(*columns, strict=True))[1:]:
        end = next((end for end in ends if name.endswith(end)), "")
        place = places.setdefault(name.removesuffix(end), len(places))
        groups[f"{ends[end]} particles" if end else "no particles"].append((place, above, 100 * error / exact))
    figure = new_figure(7.5, 0.3 * len(places) + 1.2)
    axes = figure.add_subplot()
    tidy(axes)
    for (label, points), marker, color in zip(groups.items(), MARKERS, (TRUE, *COLORS), strict=False):
        place, above, error = np.transpose(points)
        axes.errorbar(above, place, xerr=error, fmt=marker, markersize=5, color=color, linewidth=1, label=label)
    axes.set(xscale="log", xlabel="RMSE above that of the exact answer, percent", yticks=range(len(places)), yticklabels=list(places))
    axes.invert_yaxis()
    axes.xaxis.set_major_formatter("{x:g}")
    legend_below(figure, axes, 4)
    return figure
