"""Picture of a forecast: a fan of intervals for each quantity, after what was known before."""

from typing import Any

import numpy as np

from motes.core import checks
from motes.filters.frames import first_step
from motes.filters.predictive import Forecast, Predictive
from motes.io.tabular import unlabelled
from motes.plotting.figures import ESTIMATE, TRUE, legend_below, over_time, state_panels
from motes.plotting.history import course, times_of

LEVELS = (0.95, 0.8, 0.5)
BEFORE = 4
"""So many times as many steps as are predicted are drawn of those before."""


def forecast_figure(forecast: Forecast, given: Any, states: tuple[int, ...] | None) -> Any:
    """Draw intervals of 50, 80 and 95 percent and the median of each quantity.

    Args:
        forecast: of one run.
        given: measurements of the run `(t, y)`, to draw before those that are predicted; those after its end are drawn beside them.
        states: indices of the states to draw in place of the measurements; None for these.

    Raises:
        MotesError: the forecast is of many runs, or the measurements have another number of components.
    """
    of_states = states is not None or forecast.measured is None
    shown: Predictive = forecast.states if of_states else forecast.measurements
    if shown.mean.ndim != 2:
        checks.refuse("plot result", "a forecast of one run", f"one of {shown.mean.shape[0]} runs",
                      "Draw one: jax.tree.map(lambda leaf: leaf[0], forecasts).")  # fmt: skip
    places = tuple(range(len(shown.names))) if states is None or not of_states else states
    ahead, label = times_of(shown, shown.mean.shape[0])
    # where the times ahead are not known, steps are numbered, those before too
    known = shown.labels is not None and shown.labels.index is not None
    steps = np.shape(forecast.history.info.ess)[0]
    before = times_of(forecast.history, steps)[0] if known else first_step(shown) - np.arange(steps, 0, -1)
    figure, panels = state_panels(tuple(shown.names[place] for place in places), label=label)
    tail = slice(-BEFORE * len(ahead), None)
    past = course(forecast.history, None, places) if of_states and {"mean", "cov"} <= set(forecast.history.kept) else None
    bands = [np.asarray(shown.interval(level), np.float64) for level in LEVELS]
    median = np.asarray(shown.quantile(0.5), np.float64)
    for number, (axes, place) in enumerate(zip(panels, places, strict=True)):
        if past is not None:
            mean, deviation = past.mean[tail, number], past.deviation[tail, number]
            axes.fill_between(before[tail], mean - 2 * deviation, mean + 2 * deviation, color="0.6", alpha=0.3, linewidth=0)
            axes.plot(before[tail], mean, color="0.4", linewidth=1.2, label="mean before, 2 sigma")
        for level, depth, (lower, upper) in zip(LEVELS, (0.18, 0.25, 0.35), bands, strict=True):
            axes.fill_between(ahead, lower[:, place], upper[:, place], color=ESTIMATE, alpha=depth, linewidth=0, label=f"{level:.0%}")
        axes.plot(ahead, median[:, place], color=ESTIMATE, linewidth=1.4, label="median")
    if given is not None and not of_states:
        _draw_given(panels, given, len(places), before, ahead, tail)
    legend_below(figure, panels[0], 5)
    shown_before = before[tail] if of_states or given is not None else ahead[:0]
    over_time(figure, np.concatenate([shown_before, ahead]))
    return figure


def _draw_given(panels: list[Any], given: Any, size: int, before: np.ndarray, ahead: np.ndarray, tail: slice) -> None:
    values = np.asarray(checks.as_numbers("plot truth", unlabelled("plot truth", given)[0]), np.float64)
    values = values[:, None] if values.ndim == 1 and size == 1 else values
    checks.shape("plot truth", values, (None, size), "(steps, measured components)")
    if len(values) < len(before):
        checks.refuse("plot truth", f"the measurements of the run, {len(before)} steps or more", f"{len(values)} steps")
    after = values[len(before) : len(before) + len(ahead)]
    for axes, column, later in zip(panels, values[: len(before)].T, after.T, strict=True):
        axes.plot(before[tail], column[tail], ".-", color="0.4", markersize=3, linewidth=0.8, label="measured")
        if len(later):
            axes.plot(ahead[: len(later)], later, ".-", color=TRUE, markersize=4, linewidth=0.8, label="measured later")
