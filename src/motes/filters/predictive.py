"""What a forecast gives: predictive laws of several quantities in the next steps, their quantiles and tables."""

from typing import TYPE_CHECKING

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike

from motes.core import checks
from motes.core.record import record, static
from motes.filters import frames
from motes.filters.history import History
from motes.io.labels import Labels, in_words
from motes.io.result_table import Table

if TYPE_CHECKING:
    from pandas import DataFrame


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

        Raises:
            MotesError: the level does not lie between 0 and 1.
            MissingExtraError: pandas is not installed.
        """
        columns = frames.mean_and_sd(self.names, self.mean, self.cov)
        lower, upper = map(np.asarray, self.interval(level))
        for place, name in enumerate(self.names):
            for end, values in (("lower", lower), ("upper", upper)):
                columns[frames.unused(f"{name}_{end}", columns)] = values[..., place]
        return frames.as_frame(columns, self.labels, frames.first_step(self))

    def table(self, level: float = 0.95) -> Table:
        """Return the same as a `Table`, which prints."""
        lower, upper = self.interval(level)
        index = None if self.labels is None else self.labels.index
        of_rows = frames.first_step(self) + np.arange(self.mean.shape[0]) if index is None else index
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
