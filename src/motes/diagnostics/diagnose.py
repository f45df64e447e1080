"""A run judged in words: what is wrong, where, and what to try."""

from typing import Any

import jax
import numpy as np

from motes.core import checks
from motes.core.findings import Diagnosis, Finding
from motes.diagnostics.consistency import chi_square_band, nees
from motes.diagnostics.undeclared import undeclared_angles
from motes.diagnostics.weights import TRUSTED, pareto_k, surviving_ancestors
from motes.filters import alarm, notices
from motes.filters.frames import ask_one_run
from motes.filters.history import History

FAR = 12.5
"""Nats below a perfect fit, five standard deviations: a best particle or a prediction this far off has been missed."""
IN_A_ROW = 3
"""So many such misses one after the other are no outlier any more."""
MILD = 0.5
"""Innovations so much smaller (squared) than was predicted of them are called small; noises with heavy tails seldom average so little."""
SCARCE = 0.02
"""Share of the particles below which a median effective sample size is called low."""
LEVEL = 0.999
"""Probability of the bands for averages over the steps of a run."""


def diagnose(history: History, truth: Any = None, angles: tuple[int, ...] = ()) -> Diagnosis:
    """Judge a run and say in words what is wrong and what to try.

    Looks for what `run` warns of (collapse, numbers too coarse for their noise, starvation at any step, the alarm), for measurements that
    lie far from what was predicted, or so near that noises must be too large, low effective sample sizes, likelihoods that are not numbers;
    at states that look like angles which nobody declared; in runs with kept laws at heavy-tailed weights and degenerate paths; with the
    truth at covariances too small or large.

    Args:
        history: of a run. With `keep=mo.keep.laws` more can be seen.
        truth: true states `(t, x)`, where they are known.
        angles: states that are angles in radians, beside those that the dynamics of the run declare.

    Raises:
        MotesError: truth has another shape, or the history is of many runs.
    """
    if not isinstance(history, History):
        checks.refuse("diagnose history", "what mo.run gave", type(history).__name__)
    ask_one_run("diagnose", history, "Judge one by one: the first is jax.tree.map(lambda leaf: leaf[0], history).")
    found = [*notices.notices(history), _scarce(history), _invalid(history), undeclared_angles(history)]
    if not notices.coarseness(history):  # whose errors have another cure than noise
        found += _innovations(history)
    if "law" in history.kept:
        found += _laws(history)
    if truth is not None:
        found.append(_consistency(history, truth, angles))
    return Diagnosis.of(found)


def _innovations(history: History) -> list[Finding]:
    gaps = np.asarray(history.info.shortfall, np.float64)
    usual = history.rounding.shape[-1] / 2 if history.rounding is not None else 1.0
    far = (gaps > FAR + usual) | np.asarray(history.info.collapsed)
    runs = _in_a_row(far)
    long = [piece for piece in runs if piece.size >= IN_A_ROW]
    if long:
        first = long[0]
        deviations, center = np.sqrt(2 * gaps[first].max()), "every particle" if history.weighs else "the prediction"
        text = (f"from step {int(history.start) + first[0]} on, {first.size} measurements in a row lie {deviations:.0f} or fewer "
                f"standard deviations from {center}.")  # fmt: skip
        return [Finding("lost", text, "More process noise, a model that can move so, or more particles; start anew there.", True)]
    used = ~(np.asarray(history.info.collapsed) | (np.asarray(history.info.gated) > 0))
    nis, freedom = (np.asarray(each, np.float64)[used] for each in (history.info.nis, history.info.freedom))
    nis = np.minimum(nis, alarm.largest_square(freedom)) if history.weighs else nis
    degrees = int(freedom.sum())
    if degrees < 1:
        return []
    ratio, band = nis[freedom > 0].sum() / freedom.sum(), chi_square_band(degrees, 1, LEVEL)
    text, most = f"innovations are {ratio:.2g} times as large (squared) as was predicted of them.", band.high / degrees
    if ratio > most:
        advice = f"Raise the noises, {'use more particles, ' * history.weighs}or look for what the model leaves out."
        return [Finding("large innovations", text, advice, ratio > 2 * most)]
    if ratio < min(MILD, band.low / degrees):
        return [Finding("small innovations", text, "Lower the noises of the dynamics, of the sensor, or of both.", False)]
    return []


def _scarce(history: History) -> Finding | None:
    ess, n = np.asarray(history.ess, np.float64), history.particles
    median = float(np.median(ess))
    if not median < SCARCE * n:
        return None
    text = f"half of the steps have an effective sample size below {median:.3g} of {n} particles."
    return Finding("few particles", text, "More particles, or a proposal that looks ahead.", median < 5)


def _invalid(history: History) -> Finding | None:
    invalid = np.asarray(history.info.invalid)
    if not invalid.any():
        return None
    text = f"at {notices.at(history, np.flatnonzero(invalid))} up to {invalid.max()} particles had a likelihood that is not a number."
    return Finding("invalid", text, "Look for roots and logarithms of negative numbers in the sensor; such particles got no weight.", False)


_tails = jax.jit(jax.vmap(pareto_k))


def _laws(history: History) -> list[Finding]:
    found = []
    weights = getattr(history.law, "log_weights", None)
    if weights is not None and weights.shape[1] >= 25:
        shapes = np.asarray(_tails(weights[:: max(1, len(weights) // 50)]))
        heavy = float(np.mean(shapes > TRUSTED))
        if heavy > 0.2:
            text = f"weights have so heavy a tail (Pareto k above {TRUSTED}) at {100 * heavy:.0f} % of the steps that few particles decide."
            found.append(Finding("heavy weights", text, "A proposal that looks ahead helps more than more particles.", heavy > 0.5))
    ancestors = getattr(history.law, "ancestors", None)
    lag = 10
    if ancestors is not None and len(ancestors) > lag:
        alive = surviving_ancestors(history, lag)
        if alive.min() <= 1 < ancestors.shape[1]:
            text = f"at {int(np.sum(alive <= 1))} steps all particles descend from one particle of {lag} steps before."
            found.append(Finding("degenerate paths", text, "Filtered estimates may still be right; smooth by backward simulation.", False))
    return found


def _consistency(history: History, truth: Any, angles: tuple[int, ...]) -> Finding | None:
    squares = np.asarray(nees(history, truth, angles), np.float64)
    size = history.mean.shape[1]
    average = float(np.mean(squares)) / size
    # errors of neighboring steps are not independent: a run counts for as many as a tenth of its steps
    band = chi_square_band(size, max(1, len(squares) // 10), LEVEL)
    if average > band.high / size:
        text = f"errors are {average:.2g} times as large (squared) as the covariances claim."
        advice = "More process noise, more particles, or regularization." if history.weighs else "More process noise, or another filter."
        return Finding("overconfident", text, advice, average > 2 * band.high / size)
    if average < band.low / size:
        text = f"errors are {average:.2g} times as large (squared) as the covariances claim."
        return Finding("cautious", text, "Lower the noises.", False)
    return None


def _in_a_row(flags: np.ndarray) -> list[np.ndarray]:
    """Return the indices of each unbroken run of true values."""
    where = np.flatnonzero(flags)
    return [] if not where.size else np.split(where, np.flatnonzero(np.diff(where) > 1) + 1)
