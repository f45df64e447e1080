"""Levels of a series that walk at random, alone or with a slope."""

from typing import Any

import jax.numpy as jnp

from motes.models.components import WIDE, Component, as_variance, assembled
from motes.models.state_space import StateSpaceModel


def local_level(irregular: Any, level: Any, initial: Any = WIDE) -> StateSpaceModel:
    """A level that walks at random, measured with noise: states `level`.

        y_t = level_t + N(0, irregular),   level_{t+1} = level_t + N(0, level)

    Source: Harvey 1989, Forecasting, Structural Time Series Models and the Kalman Filter, section 2.3.

    Example:
        >>> model = mo.models.local_level(irregular=15_099.0, level=1_469.0)

    Args:
        irregular: variance of the measurement noise, in squared units of y.
        level: variance of a step of the level, likewise.
        initial: law of the first level, or its variance about zero.

    Raises:
        MotesError: a variance is none.
    """
    return assembled([of_level(level, None)], irregular, initial)


def local_linear_trend(irregular: Any, level: Any, trend: Any, initial: Any = WIDE) -> StateSpaceModel:
    """A level with a slope, both of which walk at random, measured with noise: states `level`, `slope`.

        level_{t+1} = level_t + slope_t + N(0, level),   slope_{t+1} = slope_t + N(0, trend)

    With `level=0` the trend is smooth; with `trend=0` the slope stays.

    Source: Harvey 1989, Forecasting, Structural Time Series Models and the Kalman Filter, section 2.3.

    Args:
        irregular: variance of the measurement noise, in squared units of y.
        level: variance of a step of the level, likewise.
        trend: variance of a step of the slope, in squared units of y for each step.
        initial: law of the first state, or the variance of both about zero.

    Raises:
        MotesError: a variance is none.
    """
    return assembled([of_level(level, trend)], irregular, initial)


def of_level(level: Any, trend: Any) -> Component:
    """Return a level, with a slope where its variance is not None."""
    variances = [as_variance("level", level)]
    if trend is None:
        return Component(("level",), jnp.eye(1), variances, [1.0])
    return Component(("level", "slope"), [[1.0, 1.0], [0.0, 1.0]], [*variances, as_variance("trend", trend)], [1.0, 0.0])
