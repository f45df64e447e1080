"""Picture of a study: RMSE over time, one panel per block."""

from typing import Any

import numpy as np

from motes.plotting.figures import BESIDE, COLORS, COLUMNS, DASHED, WORDS, legend_below, new_figure, tidy
from motes.studies.result import StudyResult


def study_figure(result: StudyResult, bound: Any = None) -> Any:
    """Draw the RMSE of each block over time: a line for each filter over its runs that are not lost, and the bound dashed.

    Args:
        result: the study.
        bound: with `cov` `(t, x, x)`, or None.

    Raises:
        MotesError: the bound has another shape.
    """
    columns = min(COLUMNS, len(result.blocks))
    rows = -(-len(result.blocks) // columns)
    figure = new_figure(BESIDE * columns, 2.6 * rows + 0.6)
    steps = np.arange(result.truth.shape[1])
    for place, (block, _) in enumerate(result.blocks):
        axes = figure.add_subplot(rows, columns, place + 1)
        tidy(axes)
        for number, (name, line) in enumerate(zip(result.filters, result.rmse_over_time(block), strict=True)):
            # a leading underscore would hide the name from the legend
            axes.plot(steps, line, color=COLORS[number % len(COLORS)], linewidth=1.4, label=f" {name}")
        if bound is not None:
            axes.plot(steps, result.bound_over_time(block, bound), **DASHED, label="bound")
        axes.set_title(f"RMSE of {block}", fontsize=10, **WORDS)
        axes.set_ylim(bottom=0)
        axes.set_xlim(0, max(steps[-1], 1))
        axes.set_xlabel("step")
    legend_below(figure, axes, 4)
    return figure
