"""Forecasts: the laws of states and measurements in the steps after the last measurement.

1. Run the filter on, with nothing measured: its laws are those of the states given all measurements. A Kalman filter's are exact.
2. Moments of a measurement: those of the line that the sensor is in the states, where tracing finds it to be one, which are exact given
   the law; else means over draws of E[y | x] and E[y y' | x].
3. Where the law is no Gaussian, or the sensor no line with Gaussian noise, quantiles come from draws: of the law, and of the sensor given
   each.
"""

from functools import partial
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike

from motes.core import checks, random
from motes.core.record import record, replace, static
from motes.core.types import Inputs, KeyLike
from motes.filters import frames, keep
from motes.filters.history import History
from motes.filters.interface import Filter
from motes.filters.run import run
from motes.gaussian.taylor import affine
from motes.io.labels import Labels, in_words
from motes.io.result_table import Table
from motes.laws.carried import Carried
from motes.laws.circular import gathered
from motes.laws.cloud import draw, weighted_moments
from motes.laws.conditional import AdditiveGaussian, Conditional
from motes.laws.factored import FactoredGaussian
from motes.laws.gaussian import Gaussian
from motes.laws.law import Law
from motes.laws.mode_mixture import ModeMixture
from motes.laws.observed import Observed, nothing_like
from motes.models.canonical import canonical, one_of
from motes.models.interface import Model
from motes.models.state_space import at_step, checked_inputs
from motes.tracing.affinity import dependence
from motes.tracing.compiling import jitted
from motes.tracing.identity import Beside

if TYPE_CHECKING:
    from pandas import DataFrame

DRAWS = 4_000
"""Draws of each step for quantiles: 0.025 and 0.975 are then known to about 0.07 standard deviations."""


@record
class Predictive:
    """Predictive laws of k quantities in the next steps.

    Attributes:
        mean: `(h, k)`.
        cov: `(h, k, k)`.
        draws: m of each step, `(h, k, m)`, where the laws are no Gaussians; None where they are.
        names: of the quantities.
        labels: times of the steps, as those of the measurements go on; None where they had none, or no regular ones.
        start: number of the first step.
    """

    mean: jax.Array
    cov: jax.Array
    draws: jax.Array | None
    names: tuple[str, ...] = static()
    labels: Labels | None = static()
    start: jax.Array

    @property
    def sd(self) -> jax.Array:
        """Standard deviations, `(h, k)`."""
        return jnp.sqrt(jnp.maximum(jnp.diagonal(self.cov, axis1=-2, axis2=-1), 0))

    def quantile(self, probability: ArrayLike) -> jax.Array:
        """Quantiles `(*p, h, k)` of each quantity at one or several probabilities `(*p)`.

        Raises:
            MotesError: a probability does not lie between 0 and 1.
        """
        given = checks.as_float("quantile probability", probability)
        if checks.is_concrete(given) and not bool(((given > 0) & (given < 1)).all()):
            checks.refuse("quantile probability", "numbers between 0 and 1", np.asarray(given).tolist())
        given = given.astype(self.mean.dtype)
        if self.draws is not None:
            return jnp.quantile(self.draws, given, axis=-1)
        return self.mean + jax.scipy.special.ndtri(given)[..., None, None] * self.sd

    def interval(self, level: float = 0.95) -> tuple[jax.Array, jax.Array]:
        """Lower and upper ends `(h, k)` of the intervals that leave out equal tails.

        Args:
            level: probability of what lies within.

        Raises:
            MotesError: the level does not lie between 0 and 1.
        """
        checks.probability("interval level", level)
        lower, upper = self.quantile(np.array([(1 - level) / 2, (1 + level) / 2]))
        return lower, upper

    def to_pandas(self, level: float = 0.95) -> "DataFrame":
        """Return a `pandas.DataFrame` with a row for each step, indexed as the measurements go on (extra `results`).

        Columns: mean, standard deviation and ends of the interval of each quantity: `y`, `y_sd`, `y_lower`, `y_upper`.

        Args:
            level: probability of the interval.
        """
        columns = frames.moments(self.names, self.mean, self.cov)
        for place, name in enumerate(self.names):
            for end, values in zip(("lower", "upper"), self.interval(level), strict=True):
                columns[frames.unused(f"{name}_{end}", columns)] = np.asarray(values)[..., place]
        return frames.table(columns, self.labels, int(np.ravel(self.start)[0]))

    def table(self, level: float = 0.95) -> Table:
        """Return the same as a `Table`, which prints."""
        lower, upper = self.interval(level)
        index = None if self.labels is None else self.labels.index
        of_rows = int(np.ravel(self.start)[0]) + np.arange(self.mean.shape[0]) if index is None else index
        values = np.stack([np.asarray(one, np.float64) for one in (self.mean, self.sd, lower, upper)], axis=-1)
        columns = [f"{name}{end}" for name in self.names for end in ("", " sd", f" {50 - 50 * level:g} %", f" {50 + 50 * level:g} %")]
        rows = [(in_words(moment), *map(float, row.ravel())) for moment, row in zip(of_rows, values, strict=True)]
        return Table(("step" if index is None else self.labels.name or "time", *columns), tuple(rows))  # type: ignore[union-attr]

    def __str__(self) -> str:
        """Print as a table."""
        return str(self.table()) if self.mean.ndim == 2 and checks.is_concrete(self.mean) else repr(self)

    def _repr_markdown_(self) -> str:
        return self.table().to_markdown() if self.mean.ndim == 2 and checks.is_concrete(self.mean) else repr(self)


@record
class Forecast:
    """What `forecast` gives: `mean`, `sd`, `quantile`, `interval` and `to_pandas` are those of the measurements.

    Attributes:
        states: predictive laws of the states.
        measured: predictive laws of the measurements; None where these are no vectors, or their law is not known.
        history: the run that goes on.
    """

    states: Predictive
    measured: Predictive | None
    history: History

    @property
    def measurements(self) -> Predictive:
        """Predictive laws of the measurements.

        Raises:
            MotesError: measurements are no vectors, or cannot be drawn.
        """
        if self.measured is None:
            checks.refuse("forecast measurements", "a model whose sensor measures vectors and can be drawn from",
                          "one of another kind", "forecast.states has the states.")
        return self.measured

    @property
    def mean(self) -> jax.Array:
        """Means of the measurements, `(h, y)`."""
        return self.measurements.mean

    @property
    def cov(self) -> jax.Array:
        """Covariances of the measurements, `(h, y, y)`."""
        return self.measurements.cov

    @property
    def sd(self) -> jax.Array:
        """Standard deviations of the measurements, `(h, y)`."""
        return self.measurements.sd

    def quantile(self, probability: ArrayLike) -> jax.Array:
        """Quantiles of the measurements; see `Predictive`."""
        return self.measurements.quantile(probability)

    def interval(self, level: float = 0.95) -> tuple[jax.Array, jax.Array]:
        """Intervals of the measurements; see `Predictive`."""
        return self.measurements.interval(level)

    def to_pandas(self, level: float = 0.95) -> "DataFrame":
        """Table of the measurements; see `Predictive`."""
        return self.measurements.to_pandas(level)

    def __str__(self) -> str:
        """Print what is predicted of the measurements, or of the states where these are no vectors."""
        return str(self._shown)

    def _repr_markdown_(self) -> str:
        return self._shown._repr_markdown_()

    @property
    def _shown(self) -> Predictive:
        return self.states if self.measured is None else self.measured


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
        inputs: of these steps, with the time axis first, where the model takes inputs.
        key: JAX key or integer seed of what is drawn; nothing is where all laws are Gaussians.
        filter: the filter of the run, where the history does not know it: one of a file.
        model: likewise the model.
        draws: m of each step from which quantiles are taken of laws that are no Gaussians.

    Raises:
        MotesError: the history holds many runs, steps is not a positive whole number, inputs are missing or too many, or the history knows
            no filter and model.
    """
    checks.instance("forecast history", history, History, "what mo.run gave, or History.load")
    checks.positive_integer("forecast steps", steps)
    checks.positive_integer("forecast draws", draws)
    if np.ndim(history.info.ess) != 1:
        checks.refuse("forecast history", "one run", f"{np.shape(history.info.ess)[0]} of them",
                      "Write jax.vmap(lambda history: mo.forecast(history, steps))(histories).")  # fmt: skip
    known = history.made_by
    if (filter is None or model is None) and known is None:
        checks.refuse("forecast history", "one that knows its filter and model", "one from a file or from compiled code",
                      "Give both: mo.forecast(history, steps, filter=..., model=...).")  # fmt: skip
    filter, model = filter or known.filter, model or known.model  # type: ignore[union-attr]
    inputs = _inputs_ahead(history, steps, inputs)
    last = history.last.y
    ys = jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, (steps, *jnp.shape(leaf))), nothing_like(last))
    key = random.as_key(key)
    ahead = run(key, filter, model, ys, inputs, keep.laws, history)
    labels = None if history.labels is None else _continued(history.labels, inputs, steps)
    laws = ahead.law.law if isinstance(ahead.law, Carried) else ahead.law
    given = (jax.random.fold_in(key, history.last.step), laws, inputs, ahead.start + jnp.arange(steps, dtype=jnp.int32))
    gaussian = isinstance(laws, (Gaussian, FactoredGaussian))
    drawn = None if gaussian else _drawn(*given[:2], draws)
    states = Predictive(ahead.mean, ahead.cov, drawn, history.names, labels, ahead.start)
    measured = None if isinstance(last, Observed) or filter.adds_inputs else _of_sensor(model, given, draws)
    if measured is not None:
        measured = Predictive(*measured, _names_measured(history, model, measured[0].shape[-1]), labels, ahead.start)
    return Forecast(states, measured, history)


def _names_measured(history: History, model: Model, size: int) -> tuple[str, ...]:
    """Return the names of the measured components: of the columns that were given, of several sensors, or y0, y1, ..."""
    sensors = model.each_mode()[0].sensor.sensors
    of_sensors = tuple(name if count == 1 else f"{name}{place}" for name, count in sensors for place in range(count))
    columns = () if history.labels is None else history.labels.columns
    numbered = ("y",) if size == 1 else tuple(f"y{place}" for place in range(size))
    return next(names for names in (of_sensors, columns, numbered) if len(names) == size)


def _inputs_ahead(history: History, steps: int, inputs: Inputs) -> Inputs:
    """Return inputs of the steps ahead, in the form of those of the run."""
    before = history.last.u
    if (before is None) != (inputs is None):
        wanted = f"inputs of the {steps} steps ahead, as the run had some" if inputs is None else "none, as the run had none"
        checks.refuse("forecast inputs", wanted, "None" if inputs is None else type(inputs).__name__)
    return checked_inputs(inputs, steps, "forecast steps", "forecast inputs")


def _continued(labels: Labels, inputs: Inputs, steps: int) -> Labels | None:
    """Return the times of the steps ahead: by the seconds between them where these are an input, or as a regular index goes on."""
    index = labels.continued(steps)
    if labels.are_times and isinstance(inputs, dict) and "dt" in inputs and checks.is_concrete(inputs["dt"]):
        since = np.cumsum(np.asarray(inputs["dt"], np.float64))
        index = labels.index[-1] + np.round(since * 1e9).astype("timedelta64[ns]")  # type: ignore[index]
    return replace(labels, index=index)


@partial(jitted, static_argnames=("draws",))
def _drawn(key: jax.Array, laws: Law, draws: int) -> jax.Array:
    """Draw states of each step, `(h, x, m)`."""
    keys = jax.random.split(random.child(key, random.INITIAL), jax.tree.leaves(laws)[0].shape[0])
    return jax.lax.map(lambda now: now[1].sample(now[0], draws), (keys, laws))


def _of_sensor(model: Model, given: Any, draws: int) -> tuple[jax.Array, jax.Array, jax.Array | None] | None:
    """Return mean, covariance and draws of the measurement of each step; None where the sensor cannot be drawn from."""
    _, laws, inputs, _ = given
    if not all(part.sensor.draws for part in model.each_mode()):
        return None
    known = canonical(model, jax.tree.map(one_of, inputs))
    line = _line(known, at_step(inputs, 0))
    gaussian = line and isinstance(laws, (Gaussian, FactoredGaussian)) and isinstance(known.each_mode()[0].sensor, AdditiveGaussian)
    return _measured(*given, known, draws, line, gaussian, Beside(known))


def _line(model: Model, u: Any) -> bool:
    """Tell whether the sensor, of all modes one, is a line in the states with noise that does not depend on them."""
    sensors, size = [part.sensor for part in model.each_mode()], model.size
    if model.as_state_space().modes > len(sensors) or not sensors[0].has_moments or any(sensor != sensors[0] for sensor in sensors):
        return False

    def moments(sensor: Conditional, x: jax.Array, u: Any, t: Any) -> Any:
        return sensor.mean(x, u, t), sensor.cov(x, u, t)

    given = (sensors[0], jax.ShapeDtypeStruct((size,), model.dtype), u, jax.ShapeDtypeStruct((), jnp.int32))
    mean, cov = dependence(moments, given, ("fixed", "elements", "whole", "whole"))
    return not mean.pairs[..., :size, :size].any() and not cov.uses.reshape(-1, size + 2)[:, :size].any()


@partial(jitted, static_argnames=("draws", "line", "gaussian"))
def _measured(  # noqa: PLR0913 (what a step is given, and what is known of sensor and laws)
    key: jax.Array, laws: Law, inputs: Inputs, steps: jax.Array, model: Model, draws: int, line: bool, gaussian: bool, beside: Beside
) -> tuple[jax.Array, jax.Array, jax.Array | None]:
    joined = model.as_state_space()
    whole, with_mode = joined.sensor, joined.size > model.size

    def at(now: Any) -> Any:
        key, law, u, t = now
        mean, cov, ys = None, None, None
        if line:
            there = affine(model.each_mode()[0].sensor, law.mean(), u, t)
            mean, cov = there.prediction, there.slope @ law.cov() @ there.slope.T + there.noise
        if not gaussian:
            X = _points(random.child(key, 0), law, draws, with_mode)
            ys = whole.sample(random.child(key, 1), X, u, t)
            equal = jnp.full((draws,), -np.log(draws), X.dtype)
            ys = gathered(ys, equal, whole.angles) if whole.angles else ys
            if mean is None:
                mean, cov = weighted_moments(equal, ys)
        return mean, cov, ys

    keys = jax.random.split(random.child(key, random.MEASURE), steps.shape[0])
    return jax.lax.map(at, (keys, laws, inputs, steps))


def _points(key: jax.Array, law: Law, n: int, with_mode: bool) -> jax.Array:
    """Draw n states, `(x, n)`, with the mode as one more where the sensor is to be told."""
    if not (with_mode and isinstance(law, ModeMixture)):
        return law.sample(key, n)
    chosen = law.resampled(draw(random.child(key, 0), law.log_weights, n))
    X = chosen.parts.sample(random.child(key, 1), n)
    return jnp.concatenate([X, chosen.part_modes.astype(X.dtype)[None]])
