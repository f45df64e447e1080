"""The constants of this machine: seconds of a flop, and the three costs that Karlsson et al. (2005, Table I) cannot count, by regression.

1. Seconds of a flop: least times of the matrix products that occur in a step, of several sizes and numbers of particles, on their flops.
2. Seconds of a likelihood, of resampling, of a normal number: least times of these operations on the number of particles.
3. c1, c2, c3: the times of step 2 in flops of step 1.

Each operation is timed on its own, as a compiled program that reads its arrays from memory and writes them back. Within a filter compilers
fuse operations, above all on the native engine, so that a step costs less than its parts; `fit_step_time` predicts seconds better.
"""

import dataclasses
import hashlib
import platform
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from scipy.special import stdtrit

from motes.core import checks, engine, linalg, random
from motes.core.kept import private_folder
from motes.core.progress import tracked
from motes.core.record import record, replace, static
from motes.core.types import Inputs
from motes.costs.flops import Costs
from motes.costs.measure import least_seconds
from motes.filters.data import checked_data
from motes.filters.particle import ParticleFilter
from motes.io import archive
from motes.laws.cloud import Cloud
from motes.models.simulate import simulate
from motes.models.state_space import StateSpaceModel, as_state_space, at_step
from motes.models.structure import structure
from motes.models.textbook import radar_tracking
from motes.native.compile import processor
from motes.resampling.policy import Always, resample
from motes.resampling.schemes import Systematic

PARTICLES = (2_000, 5_000, 8_000, 12_000, 16_000, 20_000)
ROUNDS = 50
CONFIDENCE = 0.95
PARTS = ("flop", "likelihood", "resampling", "normal")


class Operation(NamedTuple):
    """One operation on a number of particles.

    Attributes:
        function: what is compiled.
        args: its arguments, with the particle axis last, for the largest number of particles.
        units: how many units it does for one particle.
    """

    function: Callable[..., Any]
    args: tuple[Any, ...]
    units: int


@record
class Slope:
    """What one unit costs.

    Attributes:
        value: the slope of a regression line with intercept.
        low: lower end of its 95% confidence interval.
        high: upper end.
        r_squared: share of the variance of the times that the line explains.
    """

    value: float
    low: float
    high: float
    r_squared: float

    @classmethod
    def fitted(cls, units: Any, seconds: Any) -> "Slope":
        """Fit a line to at least three times, by least squares."""
        x, y = np.asarray(units, float), np.asarray(seconds, float)
        off = x - x.mean()
        value = off @ y / (off @ off)
        rest = y - y.mean() - value * off
        half = stdtrit(x.size - 2, (1 + CONFIDENCE) / 2) * np.sqrt(rest @ rest / (x.size - 2) / (off @ off))
        share = 1 - rest @ rest / np.sum((y - y.mean()) ** 2)
        return cls(float(value), float(value - half), float(value + half), float(share))

    def over(self, unit: "Slope") -> "Slope":
        """Return this cost in units of another; relative errors add in squares."""
        value = self.value / unit.value
        half = abs(value) * np.hypot((self.high - self.value) / self.value, (unit.high - unit.value) / unit.value)
        return Slope(value, float(value - half), float(value + half), self.r_squared)


@record
class Calibration:
    """The constants of one machine, device and engine, for one model.

    Attributes:
        flop: seconds of one flop.
        likelihood: seconds per particle to weigh particles by a measurement.
        resampling: seconds per particle to resample.
        normal: seconds of one normal number.
        engine: the engine that was in force.
        device: processor or accelerator.
    """

    flop: Slope
    likelihood: Slope
    resampling: Slope
    normal: Slope
    engine: str = static()
    device: str = static()

    @property
    def equivalent_flops(self) -> dict[str, Slope]:
        """The constants c1, c2, c3 with their confidence intervals."""
        timed = {"c1": self.likelihood, "c2": self.resampling, "c3": self.normal}
        return {name: slope.over(self.flop) for name, slope in timed.items()}

    @property
    def costs(self) -> Costs:
        """The constants as `complexity` wants them."""
        return Costs(*(slope.value for slope in self.equivalent_flops.values()))


def calibrate(model: Any = None, refresh: bool = False, inputs: Inputs = None) -> Calibration:
    """Measure the constants c1, c2, c3 of this machine, or recall them from an earlier call.

    They are kept in the user's folder, for each machine, device, engine, precision and model; a file that is damaged is replaced, with a
    warning.

    Args:
        model: state-space or mixed linear model whose sensor can be drawn from; None for the paper's radar model.
        refresh: measure even if there is an earlier result.
        inputs: inputs of one step, where the model's functions use them.

    Raises:
        MotesError: the model cannot be timed, or the machine was too busy for times that grow with the number of particles.
    """
    model = as_state_space("calibrate", radar_tracking() if model is None else model)
    device = f"{jax.devices()[0].platform} {jax.devices()[0].device_kind}"
    operations = _operations(model, inputs)
    place = _file_of(operations, device)
    table = None if refresh or place is None else _recalled(place)
    if table is None:
        table = np.array([dataclasses.astuple(_regressed(name, operations[name])) for name in tracked(PARTS, "timing", None)])
        if place is not None:
            archive.write_tree(place, {"table": table}, {"engine": engine.chosen(), "device": device}, kind="calibration")
    return Calibration(*(Slope(*row) for row in table.tolist()), engine=engine.chosen(), device=device)


def _operations(model: StateSpaceModel, inputs: Inputs) -> dict[str, list[Operation]]:
    """Return what is timed for each of `PARTS`."""
    most, dtype, key = max(PARTICLES), model.dtype, random.as_key(0)
    _, ys = simulate(key, model, 1, jax.tree.map(lambda leaf: jnp.asarray(leaf)[None], inputs))
    y = at_step(checked_data(model, ys, None)[0], 0)
    particles = model.initial.sample(random.child(key, random.INITIAL), most)
    log_weights = jax.nn.log_softmax(random.normal(random.child(key, random.NOISE), (1, most), dtype)[0])

    def weigh(particles: jax.Array, log_weights: jax.Array) -> Any:
        cloud = replace(Cloud.equal(particles), log_weights=log_weights)
        return ParticleFilter(n=particles.shape[-1]).correct(key, model, cloud, y, inputs, jnp.int32(0))

    def choose(particles: jax.Array, log_weights: jax.Array) -> Any:
        return resample(key, Systematic(), Always(), replace(Cloud.equal(particles), log_weights=log_weights))

    def draw(like: jax.Array) -> jax.Array:
        return random.normal(key, like.shape, dtype)

    def multiply(A: jax.Array, B: jax.Array, X: jax.Array) -> jax.Array:
        # one product is over before the clock notices
        return jax.lax.fori_loop(0, ROUNDS, lambda _, X: linalg.times_vector(B, linalg.times_vector(A, X)), X)

    def products(i: int, j: int) -> Operation:
        flops = ROUNDS * (i * (2 * j - 1) + j * (2 * i - 1))
        # means of means: numbers neither grow nor vanish
        return Operation(multiply, (jnp.full((i, j), 1 / j, dtype), jnp.full((j, i), 1 / i, dtype), particles[:j]), flops)

    k = len(structure(model, inputs).linear)
    p = model.size - k
    return {
        "flop": [products(i, j) for i, j in sorted({(p, p), (p, k), (k, k)}) if i and j],
        "likelihood": [Operation(weigh, (particles, log_weights), 1)],
        "resampling": [Operation(choose, (particles, log_weights), 1)],
        "normal": [Operation(draw, (particles,), model.size)],
    }


def _regressed(name: str, operations: list[Operation]) -> Slope:
    units, seconds = [], []
    for operation in operations:
        compiled = jax.jit(operation.function)
        for n in PARTICLES:
            args = [jnp.asarray(np.asarray(arg)[..., :n]) if arg.shape[-1] == max(PARTICLES) else arg for arg in operation.args]
            units.append(n * operation.units)
            seconds.append(least_seconds(lambda compiled=compiled, args=args: compiled(*args)))
    slope = Slope.fitted(units, seconds)
    if slope.value <= 0:
        checks.refuse(f"calibrate {name}", "times that grow with the number of particles", f"a slope of {slope.value:.3g} s",
                      "Measure again when the machine is idle.")
    return slope


def _file_of(operations: dict[str, list[Operation]], device: str) -> Path | None:
    """Return the file for these operations on this machine, or None where nothing can be kept."""
    folder = private_folder("calibrations")
    if folder is None:
        return None
    marks = [engine.chosen(), device, platform.node(), str(PARTICLES), jax.__version__]
    with engine.using("jax"):
        marks += [jax.jit(one.function).lower(*one.args).as_text() for name in PARTS for one in operations[name]]
    digest = hashlib.sha256(processor() + "\0".join(marks).encode()).hexdigest()
    return folder / f"{digest[:32]}.npz"


def _recalled(place: Path) -> np.ndarray | None:
    """Return the table of an earlier call, or None where there is none or it is damaged."""
    if not place.exists():
        return None
    try:
        table = np.asarray(archive.read_tree(place, kind="calibration")[0].get("table", ()))
        if table.shape == (len(PARTS), 4) and np.isfinite(table).all():
            return table
        reason = f"{place}: expected a table of {len(PARTS)} constants"
    except checks.FileError as error:
        reason = str(error)
    warnings.warn(f"{reason} The constants are measured again.", stacklevel=3)
    return None
