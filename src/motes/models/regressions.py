"""Regression on inputs, with coefficients that stay or walk at random."""

from collections.abc import Mapping
from typing import Any

import jax.numpy as jnp
import numpy as np

from motes.core import checks
from motes.models.components import WIDE, Component, as_variance, assembled
from motes.models.state_space import StateSpaceModel


def regression(irregular: Any, regressors: Any, initial: Any = WIDE) -> StateSpaceModel:
    """A linear regression on the inputs, whose coefficients are the states.

        y_t = u_t' coefficients_t + N(0, irregular),   coefficients_{t+1} = coefficients_t + N(0, variances)

    The inputs are the regressors, an array `(t, k)`, or a table, of which columns are taken by name where regressors have names; one that
    is 1 everywhere gives an intercept.

    Source: Harvey 1989, Forecasting, Structural Time Series Models and the Kalman Filter, section 7.2.

    Args:
        irregular: variance of the measurement noise, in squared units of y.
        regressors: how many there are, k, where coefficients stay; or the variance of a step of each coefficient, `(k,)`, 0 for one that
            stays; or such variances by name. Without names the states are `coefficient0` and so on.
        initial: law of the first coefficients, or the variance of each about zero.

    Raises:
        MotesError: an argument cannot be used.
    """
    return assembled([of_regressors(regressors)], irregular, initial)


def of_regressors(regressors: Any) -> Component:
    """Return coefficients of regressors, which the inputs give; see `regression`."""
    names = tuple(regressors) if isinstance(regressors, Mapping) else None
    values = list(regressors.values()) if isinstance(regressors, Mapping) else regressors
    if any(isinstance(value, str) for value in (values if isinstance(values, (list, tuple)) else [values])):
        checks.refuse("regressors", "how many there are, or the variance of each one's step", repr(regressors),
                      "Names stand before variances: {'price': 0.0} has a coefficient that stays.")  # fmt: skip
    if isinstance(values, (int, np.integer)):
        checks.positive_integer("regressors", values)
        values = [0.0] * int(values)
    try:
        variances = [as_variance(f"regressors[{place}]", value) for place, value in enumerate(values)]
    except TypeError:
        checks.refuse("regressors", "how many there are, or the variance of each one's step", repr(regressors))
    if not variances:
        checks.refuse("regressors", "at least one", "none")
    states = names or tuple(f"coefficient{i}" for i in range(len(variances)))
    return Component(states, jnp.eye(len(variances)), variances, None, names or ())
