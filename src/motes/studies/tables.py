"""Tables of a study: how accurate, how sure of it, how consistent, how many lost."""

import math
from typing import Any, NamedTuple

import numpy as np

from motes.core import checks
from motes.io.result_table import Table

COLUMNS = (
    "filter", "block", "RMSE", "s.e.", "median", "kept", "difference", "s.e. of it", "bias", "NEES/dim", "of bound", "lost", "s/step",
)


class Accuracy(NamedTuple):
    """Root mean square error over time and runs, and its Monte Carlo standard error (NaN for fewer than two runs)."""

    rmse: float
    error: float


def accuracy(squared: np.ndarray) -> Accuracy:
    """Return the RMSE as the papers define it: root of the mean over time and runs of the squared 2-norm.

    The standard error is by the delta method over runs, which are independent: that of the mean square, divided by twice the RMSE.

    Args:
        squared: squared errors, `(run, t)`.
    """
    if not squared.shape[0]:
        return Accuracy(math.nan, math.nan)
    return Accuracy(_root(squared), _standard_error(_influence(squared)))


def difference(squared: np.ndarray, reference: np.ndarray) -> Accuracy:
    """Return by how much one RMSE exceeds another of the same runs, with the standard error of that difference.

    Args:
        squared: squared errors, `(run, t)`.
        reference: those of the filter to compare with, on the same runs.
    """
    if not squared.shape[0]:
        return Accuracy(math.nan, math.nan)
    return Accuracy(_root(squared) - _root(reference), _standard_error(_influence(squared) - _influence(reference)))


def _root(squared: np.ndarray) -> float:
    return float(np.sqrt(squared.mean()))


def _influence(squared: np.ndarray) -> np.ndarray:
    """Return what each run adds to the RMSE, to first order."""
    rmse = _root(squared)
    return squared.mean(axis=1) / (2 * rmse) if rmse > 0 else np.zeros(squared.shape[0])


def _standard_error(influence: np.ndarray) -> float:
    return float(influence.std(ddof=1) / np.sqrt(influence.size)) if influence.size > 1 else math.nan


def study_table(result: Any, bound: Any, seconds: dict[str, float] | None) -> Table:
    """Return one row for each filter and block.

    Columns: RMSE (root of the mean over time and runs of the squared 2-norm) with its standard error; RMSE of the median run; difference to
    the first filter on the same runs, with its standard error; bias (2-norm of the error averaged over time and runs); NEES / dim (1 for a
    filter whose covariances are right, infinite where one was certain and wrong); ratio to the bound; lost runs; seconds per step. Where
    runs are lost, "RMSE" and "median" are over all runs, and there is a further column "kept" with the RMSE of those that are not lost;
    difference, bias, NEES and ratio are over runs that are not lost then (by neither of the two, for the difference).

    Args:
        result: the study.
        bound: with `cov` `(t, x, x)`, or None.
        seconds: seconds per step by filter, or None.

    Raises:
        MotesError: the bound has another shape, or a name is unknown.
    """
    for name in seconds or {}:
        checks.option("table seconds", name, result.filters)
    lost = result.lost
    optional = {"kept": lost.any(), "of bound": bound is not None, "s/step": seconds is not None}
    columns = tuple(name for name in COLUMNS if optional.get(name, True))
    rows = []
    for place, filter in enumerate(result.filters):
        for block, _ in result.blocks:
            cells = _cells(result, place, block, lost)
            if bound is not None:
                least = _root(np.square(result.bound_over_time(block, bound)))
                cells["of bound"] = cells["kept"] / least if least > 0 else math.nan
            cells |= {"filter": filter, "block": block, "lost": int(lost[place].sum()), "s/step": (seconds or {}).get(filter)}
            rows.append(tuple(cells[name] for name in columns))
    return Table(columns, tuple(rows))


def _cells(result: Any, place: int, block: str, lost: np.ndarray) -> dict[str, Any]:
    errors, dimension = result.errors(block), len(result.block(block))
    squared = np.square(errors).sum(axis=-1)
    kept, both = ~lost[place], ~(lost[place] | lost[0])
    whole = accuracy(squared[place])
    beyond = difference(squared[place][both], squared[0][both]) if place else Accuracy(math.nan, math.nan)
    names = [name for name, _ in result.blocks]
    nees = result.nees[place, kept, :, names.index(block)].astype(np.float64)
    bias = errors[place][kept].mean(axis=(0, 1)) if kept.any() else np.full(dimension, math.nan)
    return {
        "RMSE": whole.rmse, "s.e.": whole.error, "median": float(np.median(np.sqrt(squared[place].mean(axis=1)))),
        "kept": accuracy(squared[place][kept]).rmse, "difference": beyond.rmse, "s.e. of it": beyond.error,
        "bias": float(np.linalg.norm(bias)), "NEES/dim": float(nees.mean()) / dimension if kept.any() else math.nan,
    }
