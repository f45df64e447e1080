"""One verb for all pictures."""

from typing import Any

from motes.bounds.bound import Bound
from motes.core import checks
from motes.filters.history import History
from motes.plotting.bound import bound_figure
from motes.plotting.history import history_figure


def plot(result: Any, truth: Any = None) -> Any:
    """Draw a result.

    Args:
        result: a `History` that kept means and covariances, or a `Bound`.
        truth: true states `(t, x)`, to draw beside the estimates of a history.

    Returns:
        A matplotlib `Figure`; save it with `figure.savefig("name.png")`.

    Raises:
        MotesError: there is no picture for such a result, or the truth does not fit it.
        MissingExtraError: matplotlib is not installed.
    """
    if isinstance(result, History):
        return history_figure(result, truth)
    if isinstance(result, Bound):
        if truth is not None:
            checks.refuse("plot truth", "none beside a Bound", type(truth).__name__)
        return bound_figure(result)
    checks.refuse("plot result", "a History or a Bound", type(result).__name__)
