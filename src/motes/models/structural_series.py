"""Structural models of a series: level, slope, seasons, cycle and regressors in any selection."""

from typing import Any

from motes.core import checks
from motes.models.components import WIDE, Component, assembled
from motes.models.levels import of_level
from motes.models.regressions import of_regressors
from motes.models.seasons import of_cycle, of_season
from motes.models.state_space import StateSpaceModel


def structural(
    irregular: Any = 0.0,
    level: Any = None,
    trend: Any = None,
    seasonal: Any = None,
    cycle: Any = None,
    regressors: Any = None,
    initial: Any = WIDE,
) -> StateSpaceModel:
    """A series as the sum of a level, a season, a cycle, regressors and noise: `UnobservedComponents` of statsmodels.

    Each variance may be a number or a parameter to be estimated (`mo.fit`). A variance of 0 makes what it belongs to stay as it is.

    Source: Harvey 1989, Forecasting, Structural Time Series Models and the Kalman Filter.

    Example:
        >>> model = mo.models.structural(irregular=1.0, level=0.1, trend=0.01, seasonal=(12, 0.05))
        >>> xs, ys = mo.simulate(0, model, 48)

    Args:
        irregular: variance of the measurement noise, in squared units of y.
        level: variance of a step of the level; None for no level. State `level`.
        trend: variance of a step of the slope; None for no slope. State `slope`.
        seasonal: its period, `(period, variance)` or `(period, variance, harmonics)`, as `mo.models.seasonal` takes them, or a list of
            several seasons, whose states are then called `seasonal12` and so on.
        cycle: its period, `(period, variance)` or `(period, variance, damping)`, as `mo.models.cycle` takes them.
        regressors: how many, or variances, as `mo.models.regression` takes them; the inputs are the regressors, `(t, k)`,
            or a table with columns of their names.
        initial: law of the first state, or the variance of each of its components about zero.

    Raises:
        MotesError: an argument cannot be used, or there is no component at all.
    """
    parts: list[Component] = []
    if trend is not None and level is None:
        checks.refuse("structural level", "a variance, since there is a slope", "None", "Say level=0.0 for a smooth trend.")
    if level is not None:
        parts.append(of_level(level, trend))
    seasons = seasonal if isinstance(seasonal, list) else [] if seasonal is None else [seasonal]
    for one in seasons:
        words = _words("seasonal", one)
        parts.append(of_season(*words, name=f"seasonal{words[0]}" if len(seasons) > 1 else "seasonal"))
    if cycle is not None:
        parts.append(of_cycle(*_words("cycle", cycle)))
    if regressors is not None:
        parts.append(of_regressors(regressors))
    if not parts:
        checks.refuse("structural", "a level, a season, a cycle or regressors", "none of them", "Such as level=1.0.")
    return assembled(parts, irregular, initial)


def _words(component: str, value: Any) -> tuple[Any, ...]:
    """Return a period with what may follow it."""
    words = value if isinstance(value, tuple) else (value,)
    if not 1 <= len(words) <= 3:
        third = "harmonics" if component == "seasonal" else "damping"
        checks.refuse(f"structural {component}", f"a period, (period, variance) or (period, variance, {third})", repr(value))
    return words
