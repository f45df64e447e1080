"""What structural models of series are put together from: components, each with its states, which add up to what is measured.

    y_t = sum over components of h' x_t + e_t,   x_{t+1} = A x_t + w_t

(Harvey 1989, Forecasting, Structural Time Series Models and the Kalman Filter). All noises are independent: one variance for each state.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from motes.core import checks, linalg
from motes.laws.conditional import LinearGaussian
from motes.laws.gaussian import Gaussian
from motes.laws.law import Law
from motes.models.state_space import StateSpaceModel

WIDE = 1e6
"""Variance of a first state of which nothing is known, as statsmodels has it (its approximate diffuse initialization)."""


class Component(NamedTuple):
    """Some of the states of a structural model.

    Attributes:
        names: of its k states.
        A: how they move, `(k, k)`.
        variances: of their noises, `(k,)`.
        row: by how much each adds to the measurement, `(k,)`; None where the inputs say so.
        inputs: names of these inputs, where they have some.
    """

    names: tuple[str, ...]
    A: Any
    variances: Sequence[Any]
    row: Any
    inputs: tuple[str, ...] = ()


def assembled(components: Sequence[Component], irregular: Any, initial: Any) -> StateSpaceModel:
    """Return the model of which the components are parts.

    Args:
        components: at least one; one whose row the inputs say is the last.
        irregular: variance of the measurement noise.
        initial: law of the first state, or the variance of each of its components about zero.

    Raises:
        MotesError: the initial law has another number of states, or a variance is none.
    """
    names = tuple(name for part in components for name in part.names)
    variances = jnp.stack([jnp.asarray(value, jnp.result_type(float)) for part in components for value in part.variances])
    A = linalg.block_diagonal([jnp.asarray(part.A, variances.dtype) for part in components])
    known = jnp.concatenate([jnp.asarray(part.row, variances.dtype) for part in components if part.row is not None] or [variances[:0]])
    sensor = LinearGaussian(known[None], as_variance("irregular", irregular)[None, None])
    if len(known) < len(names):
        sensor = LinearGaussian(lambda x, u, t: jnp.concatenate([known, _regressors(u, len(names) - len(known))])[None], sensor.Q)
    if not isinstance(initial, Law):
        wide = as_variance("initial", initial)
        initial = Gaussian(jnp.zeros(len(names), variances.dtype), wide * jnp.eye(len(names), dtype=variances.dtype))
    return StateSpaceModel(initial, LinearGaussian(A, jnp.diag(variances)), sensor, names, input_names=components[-1].inputs)


def _regressors(u: Any, count: int) -> jax.Array:
    """Return the regressors of one step, `(k,)`."""
    if u is None:
        checks.refuse("inputs", f"{count} regressors at each step, an array (t, {count})", "none", "Give inputs=.")
    value = jnp.asarray(u)
    if value.size != count:
        checks.refuse("inputs", f"{count} regressors at each step, an array (t, {count})", f"shape {value.shape} at a step")
    return value.reshape(count)


def as_variance(argument: str, value: Any) -> jax.Array:
    """Return a variance, `()`.

    Raises:
        MotesError: it is no number, or, as far as it is known, negative or not finite.
    """
    found = checks.as_float(argument, value)
    checks.shape(argument, found, (), "(a variance)")
    if checks.is_concrete(found) and not (np.isfinite(found) and found >= 0):
        checks.refuse(argument, "a variance, a number of at least 0", f"{float(found):g}")
    return found
