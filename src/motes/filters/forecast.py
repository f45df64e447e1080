"""Forecasts: the laws of states and measurements in the steps after the last measurement.

1. Run the filter on, with nothing measured: its laws are those of the states given all measurements. A Kalman filter's are exact.
2. Moments of a measurement: those of the line that the sensor is in the states, where tracing finds it to be one, which are exact given
   the law; else those of draws.
3. Where the law is no Gaussian, or the sensor no line with Gaussian noise, quantiles come from draws: of the law, and of the sensor given
   each.
"""

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from motes.core import checks, random
from motes.core.record import replace
from motes.core.types import Inputs, KeyLike
from motes.filters import keep
from motes.filters.data import agree_inputs
from motes.filters.frames import ask_one_run
from motes.filters.history import History
from motes.filters.interface import Filter
from motes.filters.predictive import Forecast, Predictive
from motes.filters.run import run
from motes.gaussian.modes import expected
from motes.gaussian.taylor import Taylor, affine, is_affine
from motes.io.labels import Labels
from motes.laws.carried import Carried
from motes.laws.circular import gathered
from motes.laws.cloud import draw, weighted_moments
from motes.laws.conditional import AdditiveGaussian
from motes.laws.factored import FactoredGaussian
from motes.laws.gaussian import Gaussian
from motes.laws.law import Law
from motes.laws.mixture import Mixture
from motes.laws.mode_mixture import ModeMixture
from motes.laws.observed import Observed, nothing_like
from motes.models.canonical import canonical, one_of
from motes.models.interface import Model
from motes.models.jump_markov import as_jump_markov
from motes.models.state_space import at_step, checked_inputs
from motes.tracing.compiling import jitted
from motes.tracing.identity import Beside

ONE, EACH, CURVED = "one line", "a line for each mode", "no line"
"""What a sensor is in the states."""
DRAWS = 4_000
"""Draws of each step for quantiles: 0.025 and 0.975 are then known to about 0.07 standard deviations."""


def forecast(  # noqa: PLR0913 (a history knows filter and model, but one of a file does not)
    history: History,
    steps: int,
    inputs: Inputs = None,
    *,
    key: KeyLike = 0,
    filter: Filter | None = None,
    model: Model | None = None,
    draws: int = DRAWS,
) -> Forecast:
    """Predict states and measurements of the steps after a run.

    Exact for Kalman filters of linear models. A cloud goes on by simulation, as many particles as it has; mixtures as their filter has
    them. Pure: it can be jitted and vmapped, over histories too.

    Example:
        >>> model = mo.textbook.constant_velocity()
        >>> xs, ys = mo.simulate(0, model, 50)
        >>> mo.forecast(mo.run(1, mo.KalmanFilter(), model, ys), 10).mean.shape
        (10, 2)

    Args:
        history: of a run to its last measurement, or read from a file.
        steps: how many steps ahead, h.
        inputs: of these steps, with the time axis first, where the model takes inputs; times of their own must be those of the steps ahead.
        key: JAX key or integer seed of what is drawn; nothing is where all laws are Gaussians.
        filter: the filter of the run, where the history does not know it: one of a file.
        model: likewise the model.
        draws: m of each step from which quantiles are taken of laws that are no Gaussians.

    Raises:
        MotesError: the history holds many runs, steps is not a positive whole number, inputs are missing, too many or of other times, or
            the history knows no filter and model.
    """
    checks.instance("forecast history", history, History, "what mo.run gave, or History.load")
    checks.positive_integer("forecast steps", steps)
    checks.positive_integer("forecast draws", draws)
    ask_one_run("forecast", history, "Write jax.vmap(lambda history: mo.forecast(history, steps))(histories).")
    filter, model = _made_by(history, filter, model)
    inputs = _inputs_ahead(history, model, steps, inputs)
    last = history.last.y
    ys = jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, (steps, *jnp.shape(leaf))), nothing_like(last))
    key = random.as_key(key)
    ahead = run(key, filter, model, ys, inputs, keep.laws, history)
    labels = None if history.labels is None else _continued(history.labels, inputs, steps)
    laws = ahead.law.law if isinstance(ahead.law, Carried) else ahead.law
    given = (jax.random.fold_in(key, history.last.step), laws, inputs, ahead.start + jnp.arange(steps, dtype=jnp.int32))
    gaussian = isinstance(laws, (Gaussian, FactoredGaussian))
    drawn = None if gaussian else _states_drawn(*given[:2], draws)
    states = Predictive(ahead.mean, ahead.cov, drawn, history.names, labels, ahead.start)
    measured = None if isinstance(last, Observed) or filter.adds_inputs else _of_sensor(model, given, draws)
    if measured is not None:
        measured = Predictive(*measured, _names_measured(history, model, measured[0].shape[-1]), labels, ahead.start)
    return Forecast(states, measured, history)


def _made_by(history: History, filter: Filter | None, model: Model | None) -> tuple[Filter, Model]:
    """Return the filter and the model that were given, or those of the run."""
    known = history.made_by
    if filter is not None and model is not None:
        return filter, model
    if known is None:
        checks.refuse("forecast history", "one that knows its filter and model", "one from a file or from compiled code",
                      "Give both: mo.forecast(history, steps, filter=..., model=...).")  # fmt: skip
    return filter or known.filter, model or known.model


def _names_measured(history: History, model: Model, size: int) -> tuple[str, ...]:
    """Return the names of the measured components: of the columns that were given, of several sensors, or y0, y1, ..."""
    sensors = model.each_mode()[0].sensor.sensors
    of_sensors = tuple(name if count == 1 else f"{name}{place}" for name, count in sensors for place in range(count))
    columns = () if history.labels is None else history.labels.columns
    numbered = ("y",) if size == 1 else tuple(f"y{place}" for place in range(size))
    return next(names for names in (of_sensors, columns, numbered) if len(names) == size)


def _inputs_ahead(history: History, model: Model, steps: int, inputs: Inputs) -> Inputs:
    """Return inputs of the steps ahead, in the form of those of the run."""
    before = history.last.u
    if (before is None) != (inputs is None):
        wanted = f"inputs of the {steps} steps ahead, as the run had some" if inputs is None else "none, as the run had none"
        checks.refuse("forecast inputs", wanted, "None" if inputs is None else type(inputs).__name__)
    if history.labels is not None and history.labels.index is not None:
        ahead = replace(history.labels, index=history.labels.continued(steps))
        hint = "They begin one step after the last measurement."
        agree_inputs("forecast inputs", "the times of the steps ahead", ahead, inputs, hint)
    return checked_inputs(inputs, steps, "forecast steps", "forecast inputs", model.input_names)


def _continued(labels: Labels, inputs: Inputs, steps: int) -> Labels | None:
    """Return the times of the steps ahead: by the seconds between them where these are an input, or as a regular index goes on."""
    index = labels.continued(steps)
    if labels.are_times and isinstance(inputs, dict) and "dt" in inputs and checks.is_concrete(inputs["dt"]):
        since = np.cumsum(np.asarray(inputs["dt"], np.float64))
        index = labels.index[-1] + np.round(since * 1e9).astype("timedelta64[ns]")  # type: ignore[index]
    return replace(labels, index=index)


@partial(jitted, static_argnames=("draws",))
def _states_drawn(key: jax.Array, laws: Law, draws: int) -> jax.Array:
    """Draw states of each step, `(h, x, m)`."""
    keys = jax.random.split(random.child(key, random.INITIAL), jax.tree.leaves(laws)[0].shape[0])
    return jax.lax.map(lambda now: now[1].sample(now[0], draws), (keys, laws))


def _of_sensor(model: Model, given: Any, draws: int) -> tuple[jax.Array, jax.Array, jax.Array | None] | None:
    """Return mean, covariance and draws of the measurement of each step; None where the sensor cannot be drawn from."""
    _, laws, inputs, _ = given
    if not all(part.sensor.draws for part in model.each_mode()):
        return None
    known = canonical(model, jax.tree.map(one_of, inputs))
    line = _form_of(known, laws, at_step(inputs, 0))
    gaussian = line == ONE and isinstance(laws, (Gaussian, FactoredGaussian)) and isinstance(known.each_mode()[0].sensor, AdditiveGaussian)
    return _of_each_step(*given, known, draws, line, gaussian, Beside(known))


def _form_of(model: Model, laws: Law, u: Any) -> str:
    """Tell whether the sensor is a line in the states with noise that does not depend on them: one for all modes, or each its own."""
    sensors = [part.sensor for part in model.each_mode()]
    if model.as_state_space().modes > len(sensors):  # a function of the mode, too
        return CURVED
    x, t = jax.ShapeDtypeStruct((model.size,), model.dtype), jax.ShapeDtypeStruct((), jnp.int32)
    if not all(sensor.has_moments and is_affine(sensor, x, u, t) for sensor in sensors):
        return CURVED
    return ONE if all(sensor == sensors[0] for sensor in sensors) else EACH if isinstance(laws, ModeMixture) else CURVED


@partial(jitted, static_argnames=("draws", "line", "gaussian"))
def _of_each_step(  # noqa: PLR0913 (what a step is given, and what is known of sensor and laws)
    key: jax.Array, laws: Law, inputs: Inputs, steps: jax.Array, model: Model, draws: int, line: str, gaussian: bool, beside: Beside
) -> tuple[jax.Array, jax.Array, jax.Array | None]:
    joined = model.as_state_space()
    whole, with_mode = joined.sensor, joined.size > model.size

    def at(now: Any) -> Any:
        key, law, u, t = now
        if line == ONE:
            near = affine(model.each_mode()[0].sensor, law.mean(), u, t)
            mean, cov = near.prediction, near.slope @ law.cov() @ near.slope.T + near.noise
        elif line == EACH:
            system = as_jump_markov(model)
            components = jnp.arange(law.log_weights.shape[0] // system.count)
            of_all = Mixture(expected(Taylor(), system, law, components, u, t), law.log_weights)
            mean, cov = of_all.mean(), of_all.cov()
        if gaussian:
            return mean, cov, None
        ys = whole.sample(random.child(key, 1), _points_drawn(random.child(key, 0), law, draws, with_mode), u, t)
        equal = jnp.full((draws,), -np.log(draws), ys.dtype)
        ys = gathered(ys, equal, whole.angles) if whole.angles else ys
        return *(weighted_moments(equal, ys) if line == CURVED else (mean, cov)), ys

    keys = jax.random.split(random.child(key, random.MEASURE), steps.shape[0])
    return jax.lax.map(at, (keys, laws, inputs, steps))


def _points_drawn(key: jax.Array, law: Law, n: int, with_mode: bool) -> jax.Array:
    """Draw n states, `(x, n)`, with the mode as one more where the sensor is to be told."""
    if not (with_mode and isinstance(law, ModeMixture)):
        return law.sample(key, n)
    chosen = law.resampled(draw(random.child(key, 0), law.log_weights, n))
    X = chosen.parts.sample(random.child(key, 1), n)
    return jnp.concatenate([X, chosen.part_modes.astype(X.dtype)[None]])
