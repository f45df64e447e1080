"""Whether errors and innovations have the size that the filter claims (Bar-Shalom, Li, Kirubarajan 2001, section 5.4)."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax.typing import ArrayLike
from scipy.special import gammaincinv, ndtri

from motes.core import checks, linalg
from motes.filters.history import History
from motes.io.tabular import by_columns
from motes.laws.circular import wrap


def normalized_errors(errors: jax.Array, covs: jax.Array) -> jax.Array:
    """Return e' P^-1 e, `(t,)`, for errors `(x, t)` and covariances `(x, x, t)`; infinite where an error has no variance."""
    lower = linalg.cholesky(covs)
    scaled = linalg.solve_lower(lower, errors)
    unexplained = jnp.abs(errors - linalg.times_vector(lower, scaled))
    size = jnp.abs(errors) + jnp.sqrt(jnp.sum(lower**2, axis=1))
    wrong = jnp.any(unexplained > 1e3 * jnp.finfo(errors.dtype).eps * size, axis=0)
    return jnp.where(wrong, jnp.inf, jnp.sum(scaled**2, axis=0))


class Band(NamedTuple):
    """Where the average of a squared normalized error lies, with the probability asked for, if the claims are right."""

    low: float
    high: float


def chi_square_band(dimension: int, runs: int = 1, level: float = 0.99) -> Band:
    """Return the band of an average over runs, each chi-square with as many degrees of freedom as the error has dimensions.

    Args:
        dimension: of the error.
        runs: independent ones over which the average is taken.
        level: probability within the band.

    Raises:
        MotesError: a number is not a positive whole one, or the level does not lie between 0 and 1.
    """
    checks.positive_integer("chi_square_band dimension", dimension)
    checks.positive_integer("chi_square_band runs", runs)
    checks.probability("chi_square_band level", level)
    # the quantile of a chi-square law, without the slow import of all laws
    low, high = (2 * gammaincinv(dimension * runs / 2, 0.5 + side * level / 2) / runs for side in (-1, 1))
    return Band(float(low), float(high))


def nees(history: History, truth: ArrayLike, angles: tuple[int, ...] = ()) -> jax.Array:
    """Normalized estimation error squared of each step, `(t,)`: about the number of states if the covariances are right.

    Args:
        history: with means and covariances.
        truth: true states `(t, x)`, an array or a table.
        angles: states that are angles in radians, beside those that the dynamics of the run declare.

    Raises:
        MotesError: truth has another shape.
    """
    return normalized_errors(_errors("nees truth", history, truth, angles).T, jnp.moveaxis(history.cov, 0, -1))


def nis(history: History) -> jax.Array:
    """Normalized innovation squared of each step, `(t,)`: about the number of measured components if the model is right; 0 without any.

    Raises:
        MotesError: the filter's law has weights (its innovation is no one number).
    """
    if history.state.weighted:
        checks.refuse("nis history", "a run of a Kalman filter of some kind", type(history.state).__name__, "mo.diagnose looks at any run.")
    return 2 * history.info.shortfall


def coverage(history: History, truth: ArrayLike, level: float = 0.95) -> jax.Array:
    """Share of steps at which each true state lies within its central interval, `(x,)`; about the level if the claims are right.

    Args:
        history: with means and covariances; intervals are those of Gaussians with these moments.
        truth: true states `(t, x)`, an array or a table; missing ones (NaN) do not count.
        level: probability of the intervals.

    Raises:
        MotesError: truth has another shape, or the level does not lie between 0 and 1.
    """
    checks.probability("coverage level", level)
    widest = float(ndtri(0.5 + level / 2)) * jnp.sqrt(jnp.diagonal(history.cov, axis1=1, axis2=2))
    off = jnp.abs(_errors("coverage truth", history, truth))
    return jnp.nanmean(jnp.where(jnp.isnan(off), jnp.nan, off <= widest), axis=0)


def _errors(argument: str, history: History, truth: ArrayLike, angles: tuple[int, ...] = ()) -> jax.Array:
    """Truth less means `(t, x)`, the short way round in angles; a truth of another shape is refused."""
    truth = by_columns(argument, truth, history.names)
    checks.shape(argument, truth, history.mean.shape, "(steps, states)")
    return wrap((checks.as_float(argument, truth) - history.mean).T, (*history.circular, *angles)).T
