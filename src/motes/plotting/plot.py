"""One verb for all pictures."""

from typing import Any

from motes.bounds.bound import Bound
from motes.core import checks
from motes.filters.history import History
from motes.mcmc.chains import Chains
from motes.planning.plan import Plan
from motes.plotting.bound import bound_figure
from motes.plotting.chains import chains_figure
from motes.plotting.history import history_figure
from motes.plotting.plan import plan_figure
from motes.plotting.study import study_figure
from motes.studies.result import StudyResult


def plot(result: Any, truth: Any = None, bound: Any = None) -> Any:
    """Draw a result.

    Args:
        result: a `History` that kept means and covariances, a `Bound`, a `StudyResult`, a `Plan`, or `Chains`.
        truth: true states `(t, x)`, to draw beside the estimates of a history.
        bound: with `cov` `(t, x, x)`, to draw beside the errors of a study.

    Returns:
        A matplotlib `Figure`; save it with `figure.savefig("name.png")`.

    Raises:
        MotesError: there is no picture for such a result, or truth or bound do not fit it.
        MissingExtraError: matplotlib is not installed.
    """
    if isinstance(result, History):
        return history_figure(result, truth)
    if isinstance(result, Bound):
        if truth is not None:
            checks.refuse("plot truth", "none beside a Bound", type(truth).__name__)
        return bound_figure(result)
    if isinstance(result, StudyResult):
        return study_figure(result, bound)
    if isinstance(result, Plan):
        return plan_figure(result)
    if isinstance(result, Chains):
        return chains_figure(result)
    checks.refuse("plot result", "a History, a Bound, a StudyResult, a Plan or Chains", type(result).__name__)
