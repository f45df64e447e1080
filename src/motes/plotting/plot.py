"""One verb for all pictures."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from motes.bounds.bound import Bound
from motes.core import checks
from motes.filters.history import History
from motes.filters.predictive import Forecast
from motes.filters.stream import Stream
from motes.laws.law import Law
from motes.mcmc.chains import Chains
from motes.models.interface import index_of
from motes.planning.plan import Plan
from motes.plotting.bound import bound_figure
from motes.plotting.chains import chains_figure
from motes.plotting.forecast import forecast_figure
from motes.plotting.history import history_figure
from motes.plotting.law import components, law_figure
from motes.plotting.plan import plan_figure
from motes.plotting.study import study_figure
from motes.plotting.track import plane_figure
from motes.smoothers.interface import Smoothed
from motes.studies.result import StudyResult

if TYPE_CHECKING:
    from matplotlib.figure import Figure

KINDS = "a History, Smoothed, Forecast, Stream, law, Bound, StudyResult, Plan or Chains"


def plot(result: Any, truth: Any = None, bound: Any = None, states: Sequence[str | int] | str | None = None) -> "Figure":
    """Draw a result; the figure shows itself in a notebook.

    Args:
        result: a `History` or `Smoothed` with means and covariances, of many runs at once too; a `Forecast`, as a fan; a law, such as
            `history.state`, or a `Stream`, whose law it is; a `Bound`, a `StudyResult`, a `Plan`, or `Chains`.
        truth: true states `(t, x)`, to draw beside the estimates of a history; of a forecast measurements `(t, y)`, to draw before it.
        bound: with `cov` `(t, x, x)`, to draw beside the errors of a study.
        states: names or indices of those to draw; all over time where none are given, and the first two of a law. Two of a history are
            drawn as a track in their plane, with ellipses of two standard deviations; those of a forecast in place of its measurements.

    Returns:
        A matplotlib `Figure`; save it with `figure.savefig("name.png")`.

    Raises:
        MotesError: there is no picture for such a result, or truth, bound or states do not fit it.
        MissingExtraError: matplotlib is not installed.
    """
    if isinstance(result, (History, Smoothed)):
        chosen = _chosen(states, result.names)
        figure = plane_figure if chosen is not None and len(chosen) == 2 else history_figure
        return figure(result, truth, tuple(range(len(result.names))) if chosen is None else chosen)  # type: ignore[arg-type]
    if isinstance(result, Forecast):
        return forecast_figure(result, truth, _chosen(states, result.states.names))
    if truth is not None:
        checks.refuse("plot truth", f"none beside a {type(result).__name__}", type(truth).__name__)
    if isinstance(result, Stream):
        names, now = result.model.names, f"step {result.t}"
        return law_figure(result.state, names, _one_or_two(states, names), now)
    if isinstance(result, Law):
        names = tuple(f"x{place}" for place in range(components(result)))
        return law_figure(result, names, _one_or_two(states, names))
    if states is not None:
        checks.refuse("plot states", f"none beside a {type(result).__name__}", states)
    if isinstance(result, StudyResult):
        return study_figure(result, bound)
    figures: dict[type, Any] = {Bound: bound_figure, Plan: plan_figure, Chains: chains_figure}
    for kind, draw in figures.items():
        if isinstance(result, kind):
            return draw(result)  # type: ignore[arg-type]
    checks.refuse("plot result", KINDS, type(result).__name__)


def _chosen(states: Sequence[str | int] | str | None, names: tuple[str, ...]) -> tuple[int, ...] | None:
    """Return the indices of the states asked for; None where none are."""
    if states is None:
        return None
    asked = (states,) if isinstance(states, (str, int)) else tuple(states)
    if not asked:
        checks.refuse("plot states", f"names of states, such as {names[0]!r}", "none")
    return tuple(index_of(state, names) for state in asked)


def _one_or_two(states: Sequence[str | int] | str | None, names: tuple[str, ...]) -> tuple[int, ...]:
    chosen = _chosen(states, names) or tuple(range(min(2, len(names))))
    if len(chosen) > 2:
        checks.refuse("plot states", "one or two states of a law", f"{len(chosen)}")
    return chosen
