"""Picture of a plan: the error of each candidate at its time."""

from typing import Any

from motes.planning.plan import Plan
from motes.plotting.figures import COLORS, WORDS, new_figure, tidy


def plan_figure(plan: Plan) -> Any:
    """Draw the RMSE of each candidate with two standard errors, best on top; the choice in another color."""
    names, errors, spread = (plan.table.column(name) for name in ("filter", "RMSE", "s.e."))
    figure = new_figure(7.0, 0.9 + 0.28 * len(names))
    axes = figure.add_subplot()
    tidy(axes)
    for place, (error, one) in enumerate(zip(map(_or_nan, errors), map(_or_nan, spread), strict=True)):
        axes.errorbar(error, place, xerr=2 * one, fmt="o", color=COLORS[place > 0], markersize=4, linewidth=1.2)
    axes.set_yticks(range(len(names)), [f"{name}" for name in names], **WORDS)
    axes.invert_yaxis()
    axes.set_xlabel("RMSE, two standard errors to each side")
    return figure


def _or_nan(cell: Any) -> float:
    return float("nan") if cell is None else float(cell)
