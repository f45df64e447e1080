"""Pilot runs: all candidates on the same tracks and measurements; those that are certainly worse get no further runs."""

from typing import NamedTuple

import numpy as np

from motes.core.record import replace
from motes.filters.interface import Filter
from motes.studies.experiment import Experiment
from motes.studies.result import StudyResult
from motes.studies.run import study
from motes.studies.tables import accuracy, difference

FIRST_RUNS = 8
CERTAIN = 3.0
"""Standard errors by which a candidate must be worse than the best to be dropped."""


class Trial(NamedTuple):
    """What pilot runs tell of a candidate.

    Attributes:
        error: RMSE of the states that count, or of all of them in units of the best candidate's (1: best in every state).
        standard_error: Monte Carlo standard error of it.
        lost: runs that were lost.
        runs: runs it had.
    """

    error: float
    standard_error: float
    lost: int
    runs: int


class Errors(NamedTuple):
    """Squared errors of each candidate, `(run, t)`, and what each state's is divided by, `(x,)`."""

    squared: dict[str, np.ndarray]
    unit: np.ndarray


def trials(experiment: Experiment, states: tuple[str, ...], progress: bool | None) -> tuple[dict[str, Trial], np.ndarray]:
    """Try the filters of an experiment on a few runs, and the good ones on all.

    Args:
        experiment: the world, the filters, each state as a block.
        states: states that count, of one unit; empty for all, each in units of the best candidate's error.
        progress: see `study`.

    Returns:
        For each filter what it did, and what the squared error of each state is divided by, `(x,)`: infinite for states that do not count.
    """
    found: dict[str, Trial] = {}
    filters: dict[str, Filter] = dict(experiment.filters)
    runs = experiment.runs
    count = min(FIRST_RUNS, runs)
    while True:
        result = study(replace(experiment, filters=filters, runs=count), progress=progress)
        squared, unit = _errors(result, list(filters), states)
        lost = dict(zip(filters, result.lost.sum(axis=1), strict=True))
        whole = {name: accuracy(squared[name]) for name in filters}
        best = min(filters, key=lambda name: whole[name].rmse)
        found |= {name: Trial(*whole[name], int(lost[name]), count) for name in filters}
        kept = {name: filter for name, filter in filters.items() if name == best or not _worse(squared[name], squared[best])}
        if count == runs or len(kept) == 1:
            return found, unit
        filters, count = kept, min(2 * count, runs)


def _worse(squared: np.ndarray, best: np.ndarray) -> bool:
    beyond = difference(squared, best)
    return not beyond.rmse < CERTAIN * beyond.error


def _errors(result: StudyResult, names: list[str], states: tuple[str, ...]) -> Errors:
    """Put the squared errors of all states that count into one figure per run and time."""
    each = np.stack([result.squared_errors(state) for state in result.states], axis=-1)
    each = np.where(np.isfinite(each), each, np.inf)
    if states:
        unit = np.array([1.0 if state in states else np.inf for state in result.states])
    else:
        best = each.mean(axis=(1, 2)).min(axis=0)
        unit = np.where((best > 0) & np.isfinite(best), best, np.inf)
        unit = unit * np.isfinite(unit).sum()
    counted = np.isfinite(unit)
    return Errors(dict(zip(names, (each[..., counted] / unit[counted]).sum(axis=-1), strict=True)), unit)
