"""Seconds: the one place where times are taken, and a line through them, which predicts what a number of particles costs.

The least of several times is kept, since whatever disturbs a run makes it longer. Times hold for the engine in force, the device and the
load of the machine at that moment.
"""

import time
from collections.abc import Callable
from typing import Any

import jax
import numpy as np
from scipy.optimize import nnls

from motes.core import checks, devices
from motes.core.record import record, replace
from motes.core.types import Inputs, Measurements
from motes.filters.data import checked_data, steps_of
from motes.filters.distributed import Distributed
from motes.filters.interface import Filter
from motes.filters.run import run
from motes.models.interface import Model

REPEATS = 7
SPAN = 0.2
"""Seconds over which a call is repeated at least: a neighbor on the machine that disturbs for a moment does not spoil all of its times."""
PARTICLES = (1_000, 4_000, 12_000)
ELEMENTS = (2, 8)


@record
class StepTime:
    """Seconds of one step of a filter: a fixed part, and parts for each particle, each element, and each byte that elements exchange.

    Attributes:
        fixed: seconds that a step takes however many particles there are.
        per_particle: seconds for each particle of a device.
        measured: numbers of particles and the seconds measured for them, in pairs; of a `Distributed` filter particles and elements of a
            device, bytes that it sends, and seconds.
        per_element: seconds for each element of a device.
        per_byte: seconds for each byte that a device sends.
    """

    fixed: float
    per_particle: float
    measured: tuple[tuple[float, ...], ...]
    per_element: float = 0.0
    per_byte: float = 0.0

    def seconds(self, n: float, elements: float = 0, sent: float = 0) -> float:
        """Predict the seconds of a step with n particles in so many elements on a device that sends so many bytes."""
        return self.fixed + self.per_particle * n + self.per_element * elements + self.per_byte * sent

    def particles(self, budget: float, elements: float = 0, sent: float = 0) -> int:
        """Return the largest number of particles whose step fits into so many seconds.

        Raises:
            MotesError: not even one fits.
        """
        n = int((budget - self.seconds(0, elements, sent)) / self.per_particle)
        if n < 1:
            least = self.seconds(1, elements, sent)
            checks.refuse("particles budget", f"at least {least:.3g} s, what a step with one particle takes", f"{budget:.3g} s")
        return n

    @property
    def residuals(self) -> tuple[float, ...]:
        """Prediction over measurement, minus one, for each measured number of particles."""
        return tuple(self.seconds(*sizes) / seconds - 1 for *sizes, seconds in self.measured)

    @classmethod
    def fitted(cls, measured: tuple[tuple[float, ...], ...]) -> "StepTime":
        """Draw the line, or plane, with the least squares of relative errors; no part is negative.

        Args:
            measured: at least two, of different numbers; see the attribute.
        """
        *sizes, seconds = np.array(measured, float).T
        rows = np.stack([1 / seconds, *(size / seconds for size in sizes)], axis=1)
        scale = np.maximum(np.max(np.abs(rows), axis=0), np.finfo(float).tiny)
        parts = nnls(rows / scale, np.ones_like(seconds))[0] / scale
        fixed, per_particle, per_element, per_byte = [*map(float, parts), 0.0, 0.0][:4]
        if per_particle <= 0:
            checks.refuse("fit_step_time", "times that grow with the number of particles", ", ".join(f"{s:.3g} s" for s in seconds),
                          "Measure again when the machine is idle.")
        return cls(fixed, per_particle, measured, per_element, per_byte)


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


def fit_step_time(  # noqa: PLR0913 (those of a run, and what is varied)
    filter: Filter,
    model: Model,
    ys: Measurements,
    inputs: Inputs = None,
    particles: tuple[int, ...] = PARTICLES,
    repeats: int = REPEATS,
    elements: tuple[int, ...] = ELEMENTS,
) -> StepTime:
    """Time a filter with a few numbers of particles and draw a line through the times; of a `Distributed` one, a plane.

    Steps on vector hardware do not cost exactly a line: with few particles something fixed, with many the caches make a particle dearer.
    Three points that span the numbers of interest keep predictions between them within some ten percent in the median (docs/costs.md).

    Args:
        filter: a filter with a number of particles n, which is changed.
        model: state-space or mixed linear model.
        ys: measurements `(t, y)`, at least two.
        inputs: tree with the time axis first, or None.
        particles: different numbers of particles, at least two.
        repeats: runs of which the fastest counts, at least, each time.
        elements: different numbers of elements of a `Distributed` filter, whose numbers of particles they divide; others have none. What is
            sent is known where devices are shared out (`devices`).

    Raises:
        MotesError: the filter has no particles, or what `seconds_per_step` raises.
    """
    if isinstance(filter, Distributed):
        _different("particles", particles)
        _different("elements", elements)
        count = devices.chosen()
        return StepTime.fitted(tuple(
            (n / count, k / count, one.sent(model, count), seconds_per_step(one, model, ys, inputs, repeats))
            for n in particles for k in elements
            for one in [replace(filter, filter=filter.filter.with_particles(n), elements=k)]
        ))  # fmt: skip
    if filter.particle_count is None:
        checks.refuse("fit_step_time filter", "a filter with a number of particles n", type(filter).__name__)
    _different("particles", particles)
    return StepTime.fitted(tuple((n, seconds_per_step(filter.with_particles(n), model, ys, inputs, repeats)) for n in particles))


def _different(name: str, numbers: tuple[int, ...]) -> None:
    """Refuse what are no different numbers."""
    for n in numbers:
        checks.positive_integer(f"fit_step_time {name}", n)
    if len(set(numbers)) < max(2, len(numbers)):
        checks.refuse(f"fit_step_time {name}", "different numbers, at least two", list(numbers))
