"""Seconds: the one place where times are taken, and a line through them, which predicts what a number of particles costs.

The least of several times is kept, since whatever disturbs a run makes it longer. Times hold for the engine in force, the device and the
load of the machine at that moment.
"""

import time
from collections.abc import Callable
from typing import Any

import jax
import numpy as np

from motes.core import checks
from motes.core.record import record, replace, values
from motes.core.types import Inputs, Measurements
from motes.filters.data import checked_data, steps_of
from motes.filters.interface import Filter
from motes.filters.run import run
from motes.models.interface import Model

REPEATS = 7
SPAN = 0.2
"""Seconds over which a call is repeated at least: a neighbor on the machine that disturbs for a moment does not spoil all of its times."""
PARTICLES = (1_000, 4_000, 12_000)


@record
class StepTime:
    """Seconds of one step of a filter: a fixed part, and a part for each particle.

    Attributes:
        fixed: seconds that a step takes however many particles there are.
        per_particle: seconds for each particle.
        measured: pairs of a number of particles and the seconds measured for it.
    """

    fixed: float
    per_particle: float
    measured: tuple[tuple[int, float], ...]

    def seconds(self, n: float) -> float:
        """Predict the seconds of a step with n particles."""
        return self.fixed + self.per_particle * n

    def particles(self, budget: float) -> int:
        """Return the largest number of particles whose step fits into so many seconds.

        Raises:
            MotesError: not even one fits.
        """
        n = int((budget - self.fixed) / self.per_particle)
        if n < 1:
            checks.refuse("particles budget", f"at least {self.seconds(1):.3g} s, what a step with one particle takes", f"{budget:.3g} s")
        return n

    @property
    def residuals(self) -> tuple[float, ...]:
        """Prediction over measurement, minus one, for each measured number of particles."""
        return tuple(self.seconds(n) / seconds - 1 for n, seconds in self.measured)

    @classmethod
    def fitted(cls, measured: tuple[tuple[int, float], ...]) -> "StepTime":
        """Draw the line with the least squares of relative errors; neither part is negative.

        Args:
            measured: at least two pairs of a number of particles and its seconds.
        """
        n, seconds = np.array(measured, float).T
        rows = np.stack([1 / seconds, n / seconds], axis=1)
        fixed, per_particle = np.linalg.lstsq(rows, np.ones_like(n), rcond=None)[0]
        if fixed < 0:
            fixed, per_particle = 0.0, np.sum(rows[:, 1]) / np.sum(rows[:, 1] ** 2)
        if per_particle <= 0:
            checks.refuse("fit_step_time", "times that grow with the number of particles", ", ".join(f"{s:.3g} s" for s in seconds),
                          "Measure again when the machine is idle.")
        return cls(float(fixed), float(per_particle), measured)


def least_seconds(call: Callable[[], Any], repeats: int = REPEATS, span: float = SPAN) -> float:
    """Return the least time that a call takes, results waited for, of so many calls and seconds or more; one before compiles and warms."""
    jax.block_until_ready(call())
    times = []
    while len(times) < repeats or sum(times) < span:
        began = time.perf_counter()
        jax.block_until_ready(call())
        times.append(time.perf_counter() - began)
    return min(times)


def whole_run(filter: Filter, model: Model, ys: Measurements, inputs: Inputs = None) -> Callable[[], Any]:
    """Return the call that is timed; where all weights vanish it goes on, which takes the same time."""
    going_on = replace(filter, on_collapse="predict")
    return lambda: run(0, going_on, model, ys, inputs)


def seconds_per_step(
    filter: Filter, model: Model, ys: Measurements, inputs: Inputs = None, repeats: int = REPEATS, span: float = SPAN
) -> float:
    """Time one step of a filter within a compiled run over measurements.

    A run of one step is timed too and taken away, with all that happens once a run: the first particles, the call itself.

    Args:
        filter: the filter.
        model: state-space or mixed linear model.
        ys: measurements `(t, y)`, at least two; the more, the less the clock matters.
        inputs: tree with the time axis first, or None.
        repeats: runs of which the fastest counts, at least.
        span: seconds over which they are repeated, at least; the longer, the less a neighbor on the machine disturbs.

    Raises:
        MotesError: there are too few measurements, or `run` refuses something.
    """
    checks.positive_integer("seconds_per_step repeats", repeats)
    rows, inputs = checked_data(model, ys, inputs)
    steps = steps_of(rows)
    if steps < 2:
        checks.refuse("seconds_per_step ys", "at least two measurements", f"{steps}")

    def seconds(count: int) -> float:
        piece = jax.tree.map(lambda leaf: leaf[:count], (rows, inputs))
        return least_seconds(whole_run(filter, model, *piece), repeats, span)

    return (seconds(steps) - seconds(1)) / (steps - 1)


def fit_step_time(
    filter: Filter, model: Model, ys: Measurements, inputs: Inputs = None, particles: tuple[int, ...] = PARTICLES, repeats: int = REPEATS
) -> StepTime:
    """Time a filter with a few numbers of particles and draw a line through the times.

    Steps on vector hardware do not cost exactly a line: with few particles something fixed, with many the caches make a particle dearer.
    Three points that span the numbers of interest keep predictions between them within some ten percent in the median (docs/costs.md).

    Args:
        filter: a filter with a number of particles n, which is changed.
        model: state-space or mixed linear model.
        ys: measurements `(t, y)`, at least two.
        inputs: tree with the time axis first, or None.
        particles: different numbers of particles, at least two.
        repeats: runs of which the fastest counts, at least, each time.

    Raises:
        MotesError: the filter has no particles, or what `seconds_per_step` raises.
    """
    if "n" not in values(filter):
        checks.refuse("fit_step_time filter", "a filter with a number of particles n", type(filter).__name__)
    for n in particles:
        checks.positive_integer("fit_step_time particles", n)
    if len(set(particles)) < max(2, len(particles)):
        checks.refuse("fit_step_time particles", "different numbers, at least two", list(particles))
    return StepTime.fitted(tuple((n, seconds_per_step(replace(filter, n=n), model, ys, inputs, repeats)) for n in particles))
