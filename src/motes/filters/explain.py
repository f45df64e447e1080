"""What runs a filter on a model, and why: found by tracing, nothing is run."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from motes.core import checks
from motes.core import engine as engines
from motes.core.record import record, static
from motes.core.types import Inputs
from motes.filters.data import checked_data
from motes.filters.interface import Filter
from motes.filters.setup import canonical_parts, setup
from motes.models.interface import Model
from motes.models.state_space import at_step
from motes.native import report


@record
class Explanation:
    """How a filter runs.

    Attributes:
        engine: the engine in force, "auto", "jax" or "native".
        stages: for each stage of the filter that has native kernels, how it runs and why; where JAX was chosen, how it would by default.
    """

    engine: str = static()
    stages: tuple[tuple[str, str], ...] = static()

    def __str__(self) -> str:
        """Print as a table."""
        lines = [f"engine in force   {self.engine}", *(["by default:"] if self.engine == "jax" else [])]
        return "\n".join([*lines, *(f"  {name:<16}{text}" for name, text in self.stages)])


def explain(filter: Filter, model: Any, inputs: Inputs = None, y: Any = None) -> Explanation:
    """Say which engine runs each stage of a filter on a model, and why.

    Args:
        filter: the filter.
        model: state-space, mixed linear or jump-Markov model.
        inputs: example of the inputs of one step, where the model's functions use them.
        y: example of a measurement `(y,)`, where the sensor is a `Custom` density; or a scan `(plots, z)` with at least one plot.

    Raises:
        MotesError: filter and model do not fit each other.
    """
    size = checks.instance("explain model", model, Model, "a model such as StateSpaceModel").measurement_size(inputs)
    # a scan, or what else is no vector, stands as measurements of one step
    whole = y is not None and any(part.sensor.measures_anything for part in model.each_mode())
    rows = checked_data(model, jax.tree.map(lambda leaf: np.asarray(leaf)[None], y), None)[0] if whole else None
    given = jnp.zeros((size or 1,), model.dtype) if y is None else jnp.asarray(y, model.dtype) if rows is None else at_step(rows, 0)

    def once(key: jax.Array, filter: Filter, model: Any, y: jax.Array, u: Any) -> Any:
        ready = setup(key, filter, model, u, y)
        return ready.step(ready.begin(y, u)[0], y, u)

    known = canonical_parts(filter, model, inputs, given)  # as `run` has them
    chosen = engines.chosen()
    with engines.using("auto" if chosen == "jax" else chosen), report.collected(quiet=True) as notes:
        jax.eval_shape(once, jax.random.key(0), *known, given, inputs)
        report.complete(notes, type(filter).__name__)
    return Explanation(chosen, tuple(sorted(notes.items())))
