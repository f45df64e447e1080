"""Whether chains have converged, and how much their draws tell; all of draws `(chain, draw)` of one number.

R-hat, effective sizes and standard errors are those of the library arviz-stats (extra `results`): rank-normalized, of split chains
(Vehtari et al. 2021).
"""

import math
from typing import Any, NamedTuple

import numpy as np
from scipy.special import ndtri

from motes.core import checks

TAILS = (0.05, 0.95)
SHORTEST = 200
"""Draws that a thinned chain must have for its transitions to be counted."""


def _of_arviz(name: str, draws: Any, **options: Any) -> float:
    values = np.asarray(draws, np.float64)
    checks.shape(f"{name} draws", values, (None, None), "(chain, draw)")
    if values.shape[1] < 4 or not np.isfinite(values).all() or np.ptp(values) == 0:
        # a chain that never moved must not look converged
        return math.nan
    with np.errstate(all="ignore"):
        return float(getattr(checks.need("arviz_stats.base", "results").array_stats, name)(values, chain_axis=0, draw_axis=1, **options))


def r_hat(draws: Any) -> float:
    """Rank-normalized potential scale reduction, 1 for chains that agree; NaN for draws that are all equal or not finite."""
    return _of_arviz("rhat", draws)


def bulk_ess(draws: Any) -> float:
    """Effective number of draws for the center of the law."""
    return _of_arviz("ess", draws, method="bulk")


def tail_ess(draws: Any) -> float:
    """Effective number of draws for the 5 and 95 percent quantiles, the lower of the two."""
    return _of_arviz("ess", draws, method="tail", prob=TAILS)


def mean_ess(draws: Any) -> float:
    """Effective number of draws for the mean."""
    return _of_arviz("ess", draws, method="mean")


def standard_error(draws: Any) -> float:
    """Monte Carlo standard error of the mean over all chains."""
    return _of_arviz("mcse", draws, method="mean")


def geweke(draws: Any, first: float = 0.1, last: float = 0.5) -> np.ndarray:
    """Difference of the means of each chain's first and last share in standard errors, `(chain,)` (Geweke 1992).

    The variances are spectral densities at zero, as the variance over the effective number of draws. About normal for chains that have
    converged; NaN where a share is constant.

    Raises:
        MotesError: the shares overlap.
    """
    if not (0 < first < 1 and 0 < last < 1 and first + last <= 1):
        checks.refuse("geweke shares", "first + last of at most 1", f"{first} and {last}")
    values = np.asarray(draws, np.float64)
    checks.shape("geweke draws", values, (None, None), "(chain, draw)")
    found = []
    for chain in values:
        parts = chain[: int(first * chain.size)], chain[chain.size - int(last * chain.size) :]
        errors = [standard_error(part[None]) for part in parts]
        found.append((parts[0].mean() - parts[1].mean()) / math.hypot(*errors))
    return np.array(found)


class RafteryLewis(NamedTuple):
    """How long a chain must be for a quantile (Raftery, Lewis 1992).

    Attributes:
        burn_in: draws to leave out.
        draws: draws needed after them.
        least: draws that independent ones would need.
        dependence: (burn_in + draws) / least; above 5 the chain moves slowly.
    """

    burn_in: int
    draws: int
    least: int
    dependence: float


def raftery_lewis(
    draws: Any, quantile: float = 0.025, error: float = 0.005, probability: float = 0.95, distance: float = 0.001
) -> RafteryLewis:
    """Tell how long one chain `(draw,)` must be so that the quantile's probability is within an error with some probability.

    The draws below the quantile, thinned until they are a first-order two-state chain (by BIC), give the rates a and b of leaving each
    state; the burn-in is log(distance (a + b) / max(a, b)) / log|1 - a - b|.

    Raises:
        MotesError: the chain is shorter than independent draws would have to be, or does not move.
    """
    values = np.asarray(draws, np.float64)
    checks.shape("raftery_lewis draws", values, (None,), "(one chain)")
    wanted = (ndtri((1 + probability) / 2) / error) ** 2
    least = math.ceil(quantile * (1 - quantile) * wanted)
    if values.size < max(least, SHORTEST):
        checks.refuse("raftery_lewis draws", f"at least {max(least, SHORTEST)} draws", values.size)
    below = (values <= np.quantile(values, quantile)).astype(int)
    for thin in range(1, values.size // 100):
        states = below[::thin]
        triples = np.zeros((2, 2, 2))
        np.add.at(triples, (states[:-2], states[1:-1], states[2:]), 1)
        middle = np.maximum(triples.sum(axis=(0, 2)), 1)[None, :, None]
        expected = triples.sum(axis=2, keepdims=True) * triples.sum(axis=0, keepdims=True) / middle
        seen = triples > 0
        if 2 * np.sum(triples[seen] * np.log(triples[seen] / expected[seen])) - 2 * math.log(states.size - 2) < 0:
            break
    pairs = np.zeros((2, 2))
    np.add.at(pairs, (states[:-1], states[1:]), 1)
    if not pairs[0, 1] or not pairs[1, 0]:
        checks.refuse("raftery_lewis draws", "a chain that crosses its quantile more than once", "one that does not", "Draw more.")
    a, b = pairs[0, 1] / pairs[0].sum(), pairs[1, 0] / pairs[1].sum()
    keeps = abs(1 - a - b)
    burn_in = thin * math.ceil(math.log(distance * (a + b) / max(a, b)) / math.log(keeps)) if keeps > 0 else 0
    needed = thin * math.ceil((2 - a - b) * a * b / (a + b) ** 3 * wanted)
    return RafteryLewis(burn_in, needed, least, (burn_in + needed) / least)
