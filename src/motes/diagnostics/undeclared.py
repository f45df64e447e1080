"""Whether a state looks like an angle that the dynamics wrap and nobody declared: its average over the cut then means nothing."""

import numpy as np

from motes.core.findings import Finding
from motes.filters import frames
from motes.filters.history import History

SHARP, TORN = 0.5, 1.0
"""Standard deviations, rad: below the one the side of the cut is known; above the other, a step later, a law lies on both sides."""
EDGE = 0.75
"""Rad from the cut within which a step begins or ends that leads over it."""
HALF_WAY = 0.6
"""How close to pi the distance of a torn law from the middle must be: all its points lie at the cut, at plus or minus pi."""


def undeclared_angles(history: History) -> Finding | None:
    """Find states whose mean leaps over the cut of (-pi, pi] or [0, 2 pi), or whose law is torn to both sides of it.

    Asked of states whose means stay within one turn and move by less than a radian a step.
    """
    if not {"mean", "cov"} <= set(history.kept):
        return None
    means = np.asarray(history.mean, np.float64)
    deviations = frames.deviations(np.asarray(history.cov, np.float64))
    for state in sorted(set(range(means.shape[1])) - set(history.circular)):
        for middle in (0.0, np.pi):
            steps, torn = _crossings(means[:, state] - middle, deviations[:, state])
            if steps.size:
                text = (f"{history.names[state]} looks like an angle that the dynamics wrap: at {steps.size} steps, first "
                        f"step {int(history.start) + int(steps[0])}, it leaps by a turn or lies on both sides of the cut.")  # fmt: skip
                advice = f"Declare it: angles=({state},) of the dynamics, and those of a sensor that measures it."
                return Finding("undeclared angle", text, advice, torn)
    return None


def _crossings(means: np.ndarray, deviations: np.ndarray) -> tuple[np.ndarray, bool]:
    """Return the steps at which a state `(t,)`, counted from the middle of its turn, is cut, and whether it is torn."""
    sharp = np.flatnonzero(deviations < SHARP)
    nowhere = np.zeros(0, int), False
    if sharp.size < 2:
        return nowhere
    known = means[sharp]
    if np.abs(known).max() > np.pi + EDGE or np.median(np.abs(np.diff(known))) > 1:
        return nowhere
    at_edge = np.abs(np.abs(known) - np.pi) < EDGE
    over = at_edge[:-1] & at_edge[1:] & (known[:-1] * known[1:] < 0)
    before = np.zeros(means.size, bool)
    for later in (1, 2):
        before[np.minimum(sharp[at_edge] + later, means.size - 1)] = True
    torn = np.flatnonzero(before & (deviations > TORN) & (np.abs(np.hypot(means, deviations) - np.pi) < HALF_WAY))
    # a law that takes several steps to come over was torn meanwhile
    return np.union1d(sharp[:-1][over], torn), bool(torn.size or np.any(np.diff(sharp)[over] > 1))
