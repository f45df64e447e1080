"""What comes again: seasons, whose period is known in steps, and cycles, whose period may be estimated."""

from typing import Any

import jax.numpy as jnp
import numpy as np

from motes.core import checks, linalg
from motes.models.components import WIDE, Component, as_variance, assembled
from motes.models.state_space import StateSpaceModel


def seasonal(irregular: Any, period: int, variance: Any = 0.0, harmonics: int | None = None, initial: Any = WIDE) -> StateSpaceModel:
    """A seasonal pattern, measured with noise.

    Without `harmonics` the effects of a whole period add up to noise of the given variance: the states are `seasonal` and those of the
    steps before, `seasonal_1` and so on. With `harmonics` it is a sum of waves, each of which turns and has noise in both states: the
    states are `seasonal_cos1`, `seasonal_sin1` and so on; the wave of period two has no sine.

    Source: Harvey 1989, Forecasting, Structural Time Series Models and the Kalman Filter, section 2.3.4.

    Args:
        irregular: variance of the measurement noise, in squared units of y.
        period: steps after which the pattern comes again, at least 2.
        variance: of the pattern's noise in each step, in squared units of y; 0 for a pattern that stays.
        harmonics: number of waves, at most half of the period; None for effects that add up to noise.
        initial: law of the first state, or the variance of each of its components about zero.

    Raises:
        MotesError: an argument cannot be used.
    """
    return assembled([of_season(period, variance, harmonics)], irregular, initial)


def cycle(irregular: Any, period: Any, variance: Any = 0.0, damping: Any = 1.0, initial: Any = WIDE) -> StateSpaceModel:
    """A wave of any period that may be damped, measured with noise: states `cycle`, `cycle_sin`.

        (cycle, cycle_sin)_{t+1} = damping * rotation by 2 pi / period of (cycle, cycle_sin)_t + N(0, variance) in both

    Source: Harvey 1989, Forecasting, Structural Time Series Models and the Kalman Filter, section 2.3.3.

    Args:
        irregular: variance of the measurement noise, in squared units of y.
        period: in steps, any number above 2.
        variance: of the wave's noise in each step, in squared units of y.
        damping: factor of a step, above 0 and at most 1.
        initial: law of the first state, or the variance of both about zero.

    Raises:
        MotesError: an argument cannot be used.
    """
    return assembled([of_cycle(period, variance, damping)], irregular, initial)


def of_season(period: int, variance: Any = 0.0, harmonics: int | None = None, name: str = "seasonal") -> Component:
    """Return a seasonal pattern; see `seasonal`."""
    if isinstance(period, bool) or not isinstance(period, (int, np.integer)) or period < 2:
        checks.refuse(f"{name} period", "a whole number of steps, at least 2", repr(period), "Other periods are those of a cycle.")
    variance = as_variance(f"{name} variance", variance)
    if harmonics is None:
        names = (name, *(f"{name}_{lag}" for lag in range(1, period - 1)))
        A = np.eye(period - 1, k=-1)
        A[0] = -1.0
        return Component(names, A, [variance] + [0.0] * (period - 2), np.eye(period - 1)[0])
    checks.positive_integer(f"{name} harmonics", harmonics)
    if harmonics > period // 2:
        checks.refuse(f"{name} harmonics", f"at most half of the period, {period // 2}", harmonics)
    names, blocks, row = (), [], []
    for wave in range(1, harmonics + 1):
        whole = 2 * wave < period
        names += (f"{name}_cos{wave}", f"{name}_sin{wave}")[: 1 + whole]
        blocks.append(_rotation(2 * np.pi * wave / period, np)[: 1 + whole, : 1 + whole])
        row += [1.0, 0.0][: 1 + whole]
    return Component(names, linalg.block_diagonal(blocks), [variance] * len(row), row)


def of_cycle(period: Any, variance: Any = 0.0, damping: Any = 1.0) -> Component:
    """Return a wave; see `cycle`."""
    if checks.is_concrete(period) and not (np.ndim(period) == 0 and 2 < float(period) < np.inf):
        checks.refuse("cycle period", "a number of steps above 2", period)
    checks.above_zero("cycle damping", damping, 1)
    variance = as_variance("cycle variance", variance)
    return Component(("cycle", "cycle_sin"), damping * _rotation(2 * np.pi / period, jnp), [variance, variance], [1.0, 0.0])


def _rotation(angle: Any, numbers: Any) -> Any:
    """Return the matrix `(2, 2)` that turns by an angle in radians."""
    cos, sin = numbers.cos(angle), numbers.sin(angle)
    return numbers.stack([numbers.stack([cos, sin]), numbers.stack([-sin, cos])])
