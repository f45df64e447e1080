"""The way up a log likelihood that is a smooth function: quasi-Newton steps, then Newton's, and what to make of where they end.

1. Climb by BFGS in coordinates without bounds (Nocedal, Wright 2006, Numerical Optimization, algorithm 6.1), with exact slopes.
2. Take Newton's steps with the exact curvature until nothing is left to gain.
3. Where a parameter went to its bound and the likelihood is largest there, hold it there and climb once more.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import numpy as np
from scipy.optimize import minimize

from motes.core import checks
from motes.core.record import replace
from motes.parameters.likelihood import Likelihood, curvature, height, heights, slope
from motes.parameters.named import Parameters
from motes.tracing.identity import Beside

GAINED = 1e-4
"""So many nats may be left to gain where a fit counts as converged: an estimate is then off by a seventieth of its standard error."""
FLAT = 1e-2
"""Information of a coordinate on which the likelihood hardly depends: a parameter that is positive is then known up to a factor of e^10."""
_WORST = 1e10
_SINGULAR = 1e-9
_POLISH = 12
_AWAY = tuple(2.0**power for power in range(1, 10))
"""Steps of a coordinate by which to look whether the likelihood is larger away from a bound."""


class Summit(NamedTuple):
    """Where a climb ended.

    Attributes:
        given: the likelihood, with what is held by now.
        z: coordinates `(p,)`.
        log_likelihood: there.
        slope: there, `(p,)`.
        information: the negative second derivatives there, `(p, p)`.
        rounds: evaluations of slope and curvature.
    """

    given: Likelihood
    z: np.ndarray
    log_likelihood: float
    slope: np.ndarray
    information: np.ndarray
    rounds: int

    @property
    def free(self) -> np.ndarray:
        """Which parameters are not held, `(p,)`."""
        return self.given.parameters.free


class Ascent:
    """A likelihood whose random numbers are fixed, as optimizers ask for it."""

    def __init__(self, keys: jax.Array, given: Likelihood, told: Callable[[float], object]):
        """Take keys `(k,)`, over which it is averaged, a likelihood, and who is told each log likelihood that was found."""
        self.keys, self.given, self.beside, self.told, self.rounds = keys, given, Beside(given), told, 0

    def height(self, z: np.ndarray) -> float:
        """Return the log likelihood."""
        found = float(height(self.keys, self.given, np.asarray(z, np.float64), self.beside))
        self.told(found)
        return found

    def heights(self, z: np.ndarray) -> np.ndarray:
        """Return the log likelihood by each key, `(k,)`."""
        found = np.asarray(heights(self.keys, self.given, np.asarray(z, np.float64), self.beside))
        self.told(float(found.mean()))
        return found

    def slope(self, z: np.ndarray) -> tuple[float, np.ndarray]:
        """Return log likelihood and slope."""
        self.rounds += 1
        found, up = slope(self.keys, self.given, np.asarray(z, np.float64), self.beside)
        self.told(float(found))
        return float(found), np.asarray(up)

    def information(self, z: np.ndarray) -> np.ndarray:
        """Return the negative second derivatives."""
        self.rounds += 1
        found = -np.asarray(curvature(self.keys, self.given, np.asarray(z, np.float64), self.beside))
        return 0.5 * (found + found.T)


def climbed(ascent: Ascent, z: np.ndarray, rounds: int) -> Summit:
    """Climb from coordinates `(p,)`.

    Args:
        ascent: the likelihood.
        z: first coordinates.
        rounds: iterations of BFGS, at most.
    """
    for _ in range(8):
        z = _polished(ascent, quasi_newton(ascent, z, rounds))
        top = looked_around(ascent, z)
        held, pushed = _at_bounds(ascent, top)
        if pushed is not None:
            z = pushed
        elif held is not None:
            ascent.given = held
        else:
            break
    return top


def looked_around(ascent: Ascent, z: np.ndarray) -> Summit:
    """Return height, slope and information at coordinates `(p,)`."""
    height, up = ascent.slope(z)
    return Summit(ascent.given, z, height, up, ascent.information(z), ascent.rounds)


def quasi_newton(ascent: Ascent, z: np.ndarray, rounds: int, least: float = 0.0) -> np.ndarray:
    """Climb from coordinates `(p,)` by BFGS alone (step 1).

    Args:
        ascent: the likelihood.
        z: first coordinates.
        rounds: iterations, at most.
        least: nats that an iteration must gain, or it is the last.
    """
    last = [-np.inf]

    def gained(intermediate_result: Any) -> None:
        before, last[0] = last[0], -float(intermediate_result.fun)
        if last[0] - before < least:
            raise StopIteration

    return bfgs(ascent.slope, z, ascent.given.parameters.free, 1e-4, rounds, gained)


def bfgs(
    slope: Callable[[np.ndarray], tuple[Any, Any]], z: np.ndarray, free: np.ndarray, flat: float, rounds: int, callback: Any = None
) -> np.ndarray:
    """Climb a function from coordinates `(p,)` by BFGS.

    Args:
        slope: returns height `()` and slope `(p,)`.
        z: first coordinates.
        free: which of them move, `(p,)`.
        flat: slope that counts as none.
        rounds: iterations, at most.
        callback: as SciPy's `minimize` takes it.
    """

    def downward(part: np.ndarray) -> tuple[float, np.ndarray]:
        height, up = map(np.asarray, slope(_with_part(z, free, part)))
        usable = np.isfinite(height) and np.isfinite(up).all()
        return (-float(height), -up[free]) if usable else (_WORST, np.zeros(part.size))

    options = {"gtol": flat, "maxiter": rounds}
    return _with_part(z, free, minimize(downward, z[free], jac=True, method="BFGS", callback=callback, options=options).x)


def _with_part(z: np.ndarray, free: np.ndarray, part: np.ndarray) -> np.ndarray:
    z = z.copy()
    z[free] = part
    return z


def stepped(z: np.ndarray, free: np.ndarray, step: np.ndarray) -> np.ndarray:
    """Return coordinates `(p,)` with a step of some of them."""
    return _with_part(z, free, z[free] + step)


def _polished(ascent: Ascent, z: np.ndarray) -> np.ndarray:
    """Step 2."""
    free = ascent.given.parameters.free
    height, up = ascent.slope(z)
    for _ in range(_POLISH):
        step = _newton(ascent.information(z)[np.ix_(free, free)], up[free])
        if step is None or up[free] @ step < 1e-13 * max(1.0, abs(height)):
            break
        for share in (1.0, 0.5, 0.25, 0.1, 0.01):
            there = stepped(z, free, share * step)
            found, slopes = ascent.slope(there)
            if found >= height:
                z, height, up = there, found, slopes
                break
        else:
            break
    return z


def _newton(information: np.ndarray, up: np.ndarray) -> np.ndarray | None:
    """Return Newton's step, no longer than two in any coordinate; None where the information is not positive definite."""
    if lacking(information) is not None:
        return None
    step = np.linalg.solve(information, up)
    return step / max(1.0, float(np.abs(step).max()) / 2)


def lacking(information: np.ndarray) -> np.ndarray | None:
    """Return a direction `(p,)` of which the information says nothing, with its largest component 1; None where there is none."""
    if not np.isfinite(information).all():
        return np.ones(len(information))
    diagonal = np.diag(information)
    if not (diagonal > 0).all():
        return (diagonal <= 0).astype(float)
    scale = np.sqrt(diagonal)
    shares, directions = np.linalg.eigh(information / np.outer(scale, scale))
    if shares[0] > _SINGULAR:
        return None
    found = np.abs(directions[:, 0])
    return found / found.max()


def _at_bounds(ascent: Ascent, top: Summit) -> tuple[Likelihood | None, np.ndarray | None]:
    """Return the likelihood with what went to its bound held there; or coordinates away from a bound at which a climb got stuck."""
    given = top.given.parameters
    values, held = np.asarray(given.natural(top.z)), np.asarray(given.held)
    for i in np.flatnonzero(~held & (np.diag(top.information) < FLAT)):
        low, high, this = given.lower[i], given.upper[i], np.arange(values.size) == i
        if np.isinf(low) and np.isinf(high):
            continue
        at_low = np.isinf(high) or (np.isfinite(low) and values[i] - low < high - values[i])
        # a coordinate grows with the parameter, but where there is an upper bound alone
        away = (1.0 if at_low else -1.0) * (1.0 if np.isfinite(low) else -1.0)
        tried = {step: ascent.height(top.z + away * step * this) for step in _AWAY}
        best = max(tried, key=lambda step: tried[step] if np.isfinite(tried[step]) else -np.inf)
        if tried[best] > top.log_likelihood + GAINED:
            return None, top.z + away * best * this
        there = replace(given, values=np.where(this, low if at_low else high, values), held=held | this)
        bounded = replace(top.given, parameters=there)
        if Ascent(ascent.keys, bounded, ascent.told).height(top.z) >= top.log_likelihood - GAINED:
            return bounded, None
    return None, None


def started(ascent: Ascent, z: np.ndarray) -> np.ndarray:
    """Return coordinates to begin at: those given or, where nothing explains a measurement, some with larger positive parameters.

    Raises:
        MotesError: the likelihood is no number there, or parameters change nothing; the message names them.
    """
    given = ascent.given.parameters
    growing = given.free & np.isfinite(given.lower) & np.isinf(given.upper)
    height, up = ascent.slope(z)
    for step in _AWAY[:4] if growing.any() and not np.isfinite(height) else ():
        height, up = ascent.slope(z + step * growing)
        if np.isfinite(height):
            z = z + step * growing
            break
    if not np.isfinite(height):
        checks.refuse("fit init", "parameters that explain the measurements", f"a log likelihood of {height}",
                      "Begin with larger variances, or nearer to the data.")
    if not np.isfinite(up).all():
        wrong = ", ".join(np.array(given.names)[~np.isfinite(up)])
        checks.refuse("fit init", "parameters at which the likelihood has a slope", f"none in {wrong}",
                      "Look for roots and logarithms of zero in model_of, or begin elsewhere.")
    still = (up == 0) & given.free
    if still.any():
        still &= ascent.slope(z + np.where(still, 0.1, 0.0))[1] == 0
    if still.any():
        checks.refuse("fit init", "parameters on which the likelihood depends",
                      f"{', '.join(np.array(given.names)[still])}, on which nothing does", "Leave them out, or hold them by fixed=.")
    return z


def verdict(top: Summit, first: Parameters) -> tuple[bool, str, Any]:
    """Say whether a climb came to a maximum, in words, and return the covariance of the free coordinates, None where there is none.

    Args:
        top: where it ended.
        first: the parameters as they were where it began.
    """
    free, names = top.free, np.array(top.given.parameters.names)
    information, up = top.information[np.ix_(free, free)], top.slope[free]
    silent = lacking(information)
    if silent is not None:
        which = ", ".join(names[free][silent > 0.3])
        return False, f"the data do not tell {which}: the log likelihood has no curvature along it", None
    covariance = np.linalg.inv(information)
    left = 0.5 * float(up @ covariance @ up)
    if left > GAINED:
        return False, f"stopped where about {left:.2g} nats are left to gain; more rounds= or another init may help", covariance
    at = [f"{name} at {value:g}" for name, value in _bounded(top, np.asarray(first.held))]
    bounded = f"; {' and '.join(at)}, its bound, where the likelihood is largest, and held there" if at else ""
    return True, f"a maximum: about {left:.1g} nats are left to gain{bounded}", covariance


def _bounded(top: Summit, first: np.ndarray) -> list[tuple[str, float]]:
    """Return the parameters that are held by now and were not at first, with their values."""
    now = top.given.parameters
    new = np.flatnonzero(np.asarray(now.held) & ~first)
    return [(now.names[i], float(np.asarray(now.values)[i])) for i in new]
