"""Expectation maximization of linear-Gaussian models (Shumway, Stoffer 1982): a climb in which every round gains.

1. Expect: the exact smoother gives mean and covariance of each state, and of each with the one before, at the parameters so far.
2. Maximize: the expected log density of states and measurements together, a function of the parameters without any loop over time, is
   climbed by BFGS with its exact slope, whatever the parameters stand in.

Near the top the gain of a round falls by a constant factor, which can be close to one: a round that gains little may be far from the top.
Rounds go on until what is left, by Newton's reckoning with the exact curvature, is little too.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from motes.core import checks, linalg, random
from motes.filters import keep
from motes.filters.kalman import KalmanFilter
from motes.filters.run import run
from motes.gaussian.taylor import affine
from motes.laws.density import LOG_2PI, among, measured_in, zeroed
from motes.laws.gaussian import Gaussian
from motes.models.state_space import StateSpaceModel, as_state_space, at_step
from motes.parameters.climbing import GAINED, Ascent, bfgs, lacking
from motes.parameters.likelihood import Likelihood
from motes.smoothers.rauch_tung_striebel import RauchTungStriebelSmoother
from motes.smoothers.smooth import smooth
from motes.tracing.compiling import jitted
from motes.tracing.identity import Beside

_LITTLE = 1e-7
_LOOKED = 25


class Expected(NamedTuple):
    """Moments of the states of one sequence given all its measurements.

    Attributes:
        mean: `(t, x)`.
        cov: `(t, x, x)`.
        with_next: covariance of each state with the one after it, `(t - 1, x, x)`.
    """

    mean: jax.Array
    cov: jax.Array
    with_next: jax.Array


def ask_linear(given: Likelihood) -> None:
    """Refuse what expectation maximization cannot do.

    Raises:
        MotesError: the model is not linear with Gaussian noises (`KalmanFilter` is then not the filter), or some steps do not count.
    """
    if not isinstance(given.filter, KalmanFilter):
        checks.refuse("fit by='em'", "a linear model with Gaussian noises, and KalmanFilter", type(given.filter).__name__,
                      "Use by='likelihood', or mo.parameters.iterated_filtering.")
    if given.burn:
        checks.refuse("fit by='em'", "burn=0: expectations are of all steps", f"burn={given.burn}", "Use by='likelihood'.")


def maximized(ascent: Ascent, z: np.ndarray, rounds: int) -> np.ndarray:
    """Return coordinates `(p,)` after rounds of expectation and maximization from some.

    Args:
        ascent: the likelihood.
        z: first coordinates.
        rounds: at most.
    """
    given, free = ascent.given, ascent.given.parameters.free
    before = ascent.height(z)
    for turn in range(1, rounds + 1):
        moments = _smoothed(given, z, ascent.beside)

        def slope(z: np.ndarray, moments: Any = moments) -> tuple[jax.Array, jax.Array]:
            return _complete(given, z, moments, ascent.beside)

        z = bfgs(slope, z, free, 1e-6, 50)
        ascent.rounds += 1
        now = ascent.height(z)
        if now - before < _LITTLE or turn % _LOOKED == 0:
            up, information = ascent.slope(z)[1][free], ascent.information(z)[np.ix_(free, free)]
            if lacking(information) is not None or 0.5 * up @ np.linalg.solve(information, up) < 1e-4 * GAINED or now <= before:
                break
        before = now
    return z


@jitted
def _smoothed(given: Likelihood, z: Any, beside: Beside) -> list[Expected]:
    """Step 1, of all sequences, which are the first axis."""
    model, key = given.at(z), random.as_key(0)

    def of_one(ys: Any, inputs: Any) -> Expected:
        history = run(key, given.filter, model, ys, inputs, keep.moments)
        smoothed = smooth(key, RauchTungStriebelSmoother(), model, history, ys, inputs)
        plain, driven = _independent(model, ys, inputs)

        def gain(t: jax.Array) -> jax.Array:
            there = affine(plain.dynamics, history.mean[t], at_step(driven, t + 1), t + 1)
            ahead = linalg.symmetric(linalg.sandwich(there.slope, history.cov[t]) + there.noise)
            return linalg.transpose(linalg.solve(linalg.cholesky(ahead), linalg.product(there.slope, history.cov[t])))

        gains = jax.vmap(gain)(jnp.arange(ys.shape[0] - 1))
        return Expected(smoothed.mean, smoothed.cov, jax.vmap(linalg.product)(gains, smoothed.cov[1:]))

    return [jax.vmap(of_one)(*one) for one in given.series]


@jitted
def _complete(given: Likelihood, z: Any, moments: list[Expected], beside: Beside) -> tuple[jax.Array, jax.Array]:
    """Return the expected log density of states and measurements together, and its slope: what step 2 climbs."""

    def total(z: jax.Array) -> jax.Array:
        model = given.at(z)
        each = [jnp.sum(jax.vmap(lambda ys, inputs, found: _of_one(model, ys, inputs, found))(one.ys, one.inputs, found))
                for one, found in zip(given.series, moments, strict=True)]  # fmt: skip
        return jnp.sum(jnp.stack(each))

    return jax.value_and_grad(total)(z)


def _independent(model: Any, ys: Any, inputs: Any) -> tuple[StateSpaceModel, Any]:
    plain, drive = as_state_space("fit", model).independent()
    return plain, drive.over(inputs, ys)


def _of_one(model: Any, ys: jax.Array, inputs: Any, found: Expected) -> jax.Array:
    """Return the expected log density of one sequence."""
    model, driven = _independent(model, ys, inputs)

    def moved(t: jax.Array) -> jax.Array:
        there = affine(model.dynamics, found.mean[t], at_step(driven, t + 1), t + 1)
        off = found.mean[t + 1] - there.prediction
        across = linalg.product(there.slope, found.with_next[t])
        spread = found.cov[t + 1] - across - linalg.transpose(across) + linalg.sandwich(there.slope, found.cov[t])
        return _expected_log_density(jnp.outer(off, off) + spread, there.noise, jnp.ones(off.size, bool))

    def measured(t: jax.Array) -> jax.Array:
        there = affine(model.sensor, found.mean[t], at_step(driven, t), t)
        seen = measured_in(ys[t], there.noise)
        off = zeroed(model.sensor.residual(jnp.where(seen, ys[t], there.prediction), there.prediction), seen)
        spread = linalg.sandwich(zeroed(there.slope, seen, 2), found.cov[t])
        return _expected_log_density(jnp.outer(off, off) + spread, among(there.noise, seen), seen)

    first: Gaussian = model.initial  # type: ignore[assignment]
    off = found.mean[0] - first.mean()
    start = _expected_log_density(jnp.outer(off, off) + found.cov[0], first.cov(), jnp.ones(off.size, bool))
    steps = jnp.arange(ys.shape[0])
    return start + jnp.sum(jax.vmap(moved)(steps[:-1])) + jnp.sum(jax.vmap(measured)(steps))


def _expected_log_density(square: jax.Array, cov: jax.Array, counted: jax.Array) -> jax.Array:
    """Return the expected log density of a centered Gaussian, on its span, of the expected square `(k, k)` of its value."""
    factor = linalg.cholesky(cov)
    half = linalg.solve_lower(factor, square)
    alive = counted & (linalg.diagonal_of(factor) > 0)
    distance = jnp.sum(jnp.where(alive, linalg.diagonal_of(linalg.solve_lower(factor, linalg.transpose(half))), 0))
    return -0.5 * (linalg.log_determinant(factor) + LOG_2PI * jnp.sum(alive) + distance)
