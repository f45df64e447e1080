"""What a run says unasked: findings that are warned of once, in one line; `diagnose` gives them with all others."""

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

import numpy as np

from motes.core import checks
from motes.core.findings import Finding
from motes.filters import precision
from motes.filters.history import History

SCARCE = 10.0
"""Effective sample size below which a step lives on too few particles to trust; of few particles, a fifth of them."""
STARVED = 2.0
"""The same, below which estimates after it are not to be trusted: one measurement in a hundred or so takes a sound run below the other."""
LEFT = 1e-4
"""Share of the probability that may leave a grid in a run: the log likelihood is off by about so much."""
GONE = 1e-2
"""Share that may leave it at one step before estimates there are not to be trusted."""


_quiet: ContextVar[bool] = ContextVar("_quiet", default=False)


@contextmanager
def quiet() -> Iterator[None]:
    """Warn of no run inside of a `with` block: of very many a table says more."""
    before = _quiet.set(True)
    try:
        yield
    finally:
        _quiet.reset(before)


def warn(history: History, before: History | None) -> None:
    """Warn of a run in one line; what the part of the run before it had told already is not told again."""
    if _quiet.get():
        return
    known = set() if before is None else {finding.name for finding in notices(before)}
    found = [finding for finding in notices(history) if finding.name not in known]
    if found:
        first, *rest = found
        more = f" Also: {', '.join(finding.name for finding in rest)}." if rest else ""
        checks.warn(f"{history.label.split('(')[0]}: {first.text} {first.advice}{more} mo.diagnose says more.")


def notices(history: History) -> list[Finding]:
    """Return what a run is warned of, the most telling first: numbers that are none or coarse, collapse, a grid, starvation, the alarm."""
    coarse = coarseness(history)
    # measurements scatter where numbers are coarse, which has another cure
    found = [numbers(history), *coarse, collapse(history), leaving(history), starvation(history), None if coarse else alarm(history)]
    return [finding for finding in found if finding is not None]


def numbers(history: History) -> Finding | None:
    """Tell of estimates that are not numbers, or not finite."""
    wrong = ~np.isfinite(np.asarray(history.info.log_evidence)) & ~np.asarray(history.info.collapsed)
    for name in ("mean", "cov"):
        if name in history.kept:
            wrong |= ~np.isfinite(np.asarray(history.kept[name])).reshape(wrong.size, -1).all(axis=1)
    steps = np.flatnonzero(wrong)
    if not steps.size:
        return None
    text = f"at {at(history, steps)} the estimate is not a number."
    return Finding("not a number", text, "Look for what overflows or is undefined there: dynamics or sensor, too wide a law.", True)


def collapse(history: History) -> Finding | None:
    """Tell of measurements that nothing explained and that were not used."""
    steps = np.flatnonzero(np.asarray(history.info.collapsed))
    if not steps.size:
        return None
    if not history.weighs:
        text = f"at {at(history, steps)} the innovation was so far off that the measurement was not used."
        return Finding("collapse", text, "Check the measurement there; widen the noises, or set a gate.", True)
    text = f"at {at(history, steps)} no particle explained the measurement, which was then not used."
    return Finding("collapse", text, "Check the measurement there; widen the noises, or use more particles or a proposal.", True)


def starvation(history: History) -> Finding | None:
    """Tell of steps, the first included, after which few particles had all the weight."""
    ess = np.asarray(history.ess, np.float64)
    scarce = min(SCARCE, 0.2 * history.particles)
    steps = np.flatnonzero(ess < scarce)
    if not steps.size:
        return None
    worst = int(np.argmin(ess))
    text = (f"at {at(history, steps)} fewer than {scarce:g} of {history.particles} particles were effective"
            f" (at step {int(history.start) + worst} {ess[worst]:.2g}).")  # fmt: skip
    advice = "More particles, a proposal that looks ahead, regularization, or a marginalized filter."
    return Finding("starvation", text, advice, bool(ess[worst] < min(STARVED, 0.1 * history.particles)))


def leaving(history: History) -> Finding | None:
    """Tell of probability that left the grid of a filter that has one, or fell between its nodes."""
    lost = np.asarray(history.info.lost, np.float64)
    if not lost.sum() > LEFT:
        return None
    worst = int(np.argmax(lost))
    text = f"{lost.sum():.2g} of the probability left the grid, {lost[worst]:.2g} of it at step {int(history.start) + worst}."
    advice = "Use a wider grid; where its nodes lie no closer than the noise of the dynamics reaches, a finer one."
    return Finding("narrow grid", text, advice, bool(lost[worst] > GONE))


def coarseness(history: History) -> list[Finding]:
    """Tell of measured components whose numbers are too coarse for their noise, and of priors too wide for it."""
    if history.rounding is None:
        return []
    spacing, prior = np.asarray(history.rounding, np.float64)
    found = []
    if spacing.max() > precision.COARSE:
        worst, kind = int(np.argmax(spacing)), np.asarray(history.rounding).dtype
        text = f"component {worst} of y, or the states it measures, is so large that {kind} rounds it by {spacing[worst]:.2g} of its noise."
        advice = "Take an origin near the data off measurements and states, or use float64 (jax.config.update('jax_enable_x64', True))."
        found.append(Finding("precision", text, advice, True))
    if history.subtracts and prior.max() > precision.LOST:
        worst, kind = int(np.argmax(prior)), np.asarray(history.rounding).dtype
        ratio = prior[worst] / np.finfo(kind).eps
        text = f"the prior variance of component {worst} of y is {ratio:.1g} times its noise's: more than {kind} can take apart."
        advice = "Use a narrower prior, SquareRootKalmanFilter, or float64 (jax.config.update('jax_enable_x64', True))."
        found.append(Finding("wide prior", text, advice, True))
    return found


def alarm(history: History) -> Finding | None:
    """Tell where the alarm rang."""
    steps = np.flatnonzero(np.asarray(history.info.alarm))
    if not steps.size:
        return None
    text = f"alarm at {at(history, steps)}: measurements scatter more than was predicted of them."
    more = ", or use more particles" if history.weighs else ""
    return Finding("alarm", text, f"Raise the noises, or look for what the model leaves out{more}.", True)


def at(history: History, steps: np.ndarray) -> str:
    """Name some steps: the only one, or how many and the first."""
    first = int(history.start) + int(steps[0])
    return f"step {first}" if steps.size == 1 else f"{steps.size} steps (first step {first})"
