"""The top of a log likelihood that is estimated by simulation: a quadratic through estimates at many places (Box, Wilson 1951).

1. Climb by the slopes of the filter, averaged over keys, until noise hides the way.
2. Estimate the log likelihood with the same keys at places around, as far away as it falls by about one nat for each parameter; fit a
   quadratic by least squares; go to its top, and do so again until that stays.

Second derivatives of a particle filter are no way to the information: their noise is as large as themselves, and after many steps all
particles have the same ancestors, which makes them too large. Estimates at places further apart say more than slopes at one.
"""

from collections.abc import Callable
from itertools import combinations_with_replacement
from typing import Any, NamedTuple

import jax
import numpy as np
from scipy.special import logsumexp

from motes.core import random
from motes.parameters.climbing import Ascent, Summit, lacking, quasi_newton, stepped
from motes.parameters.likelihood import Likelihood

KEYS = 8
"""So many likelihoods are averaged at each place."""
_REACH = 0.8
_CUBED = 5
"""Up to so many parameters the surface has cubic terms, too: likelihoods are skew, and a quadratic alone would put its top aside."""
_PASSES = 8
_STAYS = 0.3
"""Shift of the top, in standard errors, below which it counts as found."""


class Surface(NamedTuple):
    """A quadratic about a center, in directions `(q, q)` that are its units.

    Attributes:
        slope: at the center, `(q,)`.
        information: negative second derivatives, `(q, q)`.
        slopes: of all keys but one, `(k, q)`.
        best: the place, in these units, with the largest estimate, `(q,)`.
    """

    slope: np.ndarray
    information: np.ndarray
    slopes: np.ndarray
    best: np.ndarray


def surveyed(
    keys: jax.Array, given: Likelihood, z: np.ndarray, rounds: int, told: Callable[[float], object]
) -> tuple[Summit, np.ndarray | None]:
    """Climb from coordinates `(p,)`, and return where that ended and the standard deviation `(q,)` of the free coordinates over keys.

    Args:
        keys: `(k,)`.
        given: the likelihood.
        z: first coordinates.
        rounds: iterations of BFGS, at most.
        told: is told each log likelihood that was found.
    """
    ascent = Ascent(keys, given, told)
    z = quasi_newton(ascent, z, rounds, least=0.5)
    free = np.flatnonzero(given.parameters.free)
    survey = _Survey(ascent, free)
    units = np.diag([survey.far(z, i) for i in free])
    error, far = None, np.inf
    for turn in range(_PASSES):
        ascent.rounds += 1
        found = survey.fitted(z, units, turn)
        curved = lacking(found.information) is None
        back = np.linalg.inv(units)
        information = back.T @ found.information @ back
        if not curved:
            # a saddle, or too much noise: the highest place that was seen, and units that fit it
            z = stepped(z, free, units @ found.best)
            units = np.diag([survey.far(z, i) for i in free])
            continue
        step = np.linalg.solve(found.information, found.slope)
        far = float(np.sqrt(step @ found.information @ step))
        z = stepped(z, free, units @ (step * min(1.0, 2.0 / max(far, 1e-300))))
        each = np.linalg.solve(found.information, (found.slopes - found.slope).T).T @ units.T
        error = each.std(axis=0) * np.sqrt(len(each) - 1)  # by the jackknife
        # directions in which the quadratic is round, one standard error long
        units = np.linalg.inv(np.linalg.cholesky(information)).T
        if turn and far < _STAYS:
            break
    whole, up = np.zeros((z.size, z.size)), np.zeros(z.size)
    whole[np.ix_(free, free)] = information
    if curved and not far < _STAYS:
        up[free] = back.T @ found.information @ step
    return Summit(given, z, survey.log_likelihood(z), up, whole, ascent.rounds), error


class _Survey:
    def __init__(self, ascent: Ascent, free: np.ndarray):
        self._ascent, self._free = ascent, free

    def log_likelihood(self, z: np.ndarray) -> float:
        """Return the logarithm of the average likelihood."""
        return float(_log_mean(self._ascent.heights(z)))

    def far(self, z: np.ndarray, i: Any) -> float:
        """Return how far a coordinate goes until the log likelihood falls by about half a nat, on average of both sides."""
        top, step = self.log_likelihood(z), 0.1
        for _ in range(12):
            sides = [self.log_likelihood(stepped(z, np.array([i]), np.array([side * step]))) for side in (-1, 1)]
            fall = top - np.mean(sides) if np.isfinite(sides).all() else np.inf
            if 0.25 < fall < 1:
                break
            step *= np.clip(np.sqrt(0.5 / max(fall, 1e-3)), 0.2, 4.0)
        return float(step)

    def fitted(self, z: np.ndarray, units: np.ndarray, turn: int) -> Surface:
        """Fit a quadratic about z to estimates at places around it."""
        q = len(self._free)
        even, odd = (np.array(list(combinations_with_replacement(range(q), power))) for power in (2, 3))
        odd = odd if q <= _CUBED else odd[:0]
        pairs = max(len(even), q + len(odd)) + 16
        drawn = np.asarray(random.normal(random.as_key(turn), (q, pairs), np.dtype(np.float64)))
        length = _REACH * np.sqrt(q) * np.resize([0.7, 1.0, 1.3], pairs)
        one_side = (drawn / np.linalg.norm(drawn, axis=0) * length).T
        places = np.concatenate([np.zeros((1, q)), one_side, -one_side])
        found = np.array([self._ascent.heights(stepped(z, self._free, units @ place)) for place in places])
        usable = np.isfinite(found).all(axis=1)
        places, found = places[usable], found[usable]
        terms = [places[:, some].prod(axis=2) for some in (even, odd) if len(some)]
        design = np.column_stack([np.ones(len(places)), places, *terms])
        # the logarithm of the average likelihood has less bias than the average of logarithms; of all keys, and of all but one
        without = [np.delete(found, k, axis=1) for k in range(found.shape[1])]
        logs = np.column_stack([_log_mean(one) for one in (found, *without)])
        fit, *_ = np.linalg.lstsq(design, logs, rcond=None)
        curved = np.zeros((q, q))
        curved[even[:, 0], even[:, 1]] = fit[1 + q : 1 + q + len(even), 0]
        return Surface(fit[1 : 1 + q, 0], -(curved + curved.T), fit[1 : 1 + q, 1:].T, places[logs[:, 0].argmax()])


def _log_mean(found: np.ndarray) -> np.ndarray:
    """Logarithms of averages along the last axis of numbers given by their logarithms."""
    return logsumexp(found, axis=-1) - np.log(found.shape[-1])
