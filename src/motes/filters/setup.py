"""One filter made ready for one model: checked, brought together and told how to step, once for each compiled program."""

from typing import Any

import jax
import jax.numpy as jnp

from motes.core import checks, random
from motes.core.logspace import RunningSum
from motes.core.record import record, replace, static, values
from motes.core.types import Inputs
from motes.filters import alarm, gated
from motes.filters.history import Carry
from motes.filters.info import Info
from motes.filters.interface import Filter
from motes.laws.conditional import Conditional
from motes.laws.observed import Observed, nothing_like, value_of
from motes.models.canonical import canonical, canonical_conditional, shape_of
from motes.models.correlated import Drive
from motes.models.interface import Model
from motes.models.structure import looked_at


@record
class Setup:
    """A filter and a model that are ready: the single place that gives each step its key, its inputs and its number.

    Attributes:
        key: of the run, or one for each step `(t,)`.
        filter: the filter.
        given: the user's model.
        model: the same in the filter's own form, its noises independent.
        drive: what makes the inputs of that form of the user's.
        gates: of several sensors, each with its place in the measurement; see `gated`.
    """

    key: jax.Array
    filter: Filter
    given: Model
    model: Any
    drive: Drive
    gates: gated.Gates = static(default=())

    def start(self, u: Inputs, y: Any) -> Carry:
        """Return the law before y_0; of y only shape and type matter."""
        state = self.filter.init(random.child(random.step_key(self.key, 0), random.INITIAL), self.model)
        dtype = self.given.dtype
        return Carry(self._gathered(state), RunningSum.zero(dtype), jnp.zeros((), dtype), nothing_like(y), u, jnp.int32(0))

    def update(self, carry: Carry, y: Any) -> tuple[Carry, Info]:
        """Take in a measurement of the present step."""
        u = self.drive.of(carry.u, carry.u, carry.y)
        key = random.child(random.step_key(self.key, carry.step), random.UPDATE)
        t = carry.step
        state, info = gated.taken(self.filter, self.gates, y, lambda filter, y: filter.update(key, self.model, carry.state, y, u, t))
        return self._handed_on(carry, state, info, y, carry.u, t)

    def begin(self, y: Any, u: Inputs) -> tuple[Carry, Info]:
        """Take step 0."""
        return self.update(_apart(self.start(u, y)), y)

    def predict(self, carry: Carry, u: Inputs) -> Carry:
        """Go to the next step; its measurement counts as missing until it is taken in."""
        t = carry.step + 1
        key = random.child(random.step_key(self.key, t), random.PREDICT)
        state = self.filter.predict(key, self.model, carry.state, self.drive.of(u, carry.u, carry.y), t)  # type: ignore[attr-defined]
        return replace(carry, state=self._gathered(state), y=nothing_like(carry.y), u=u, step=t)

    def step(self, carry: Carry, y: Any, u: Inputs) -> tuple[Carry, Info]:
        """Go to the next step and take in its measurement."""
        carry, y, u = _apart((carry, y, u))
        t = carry.step + 1
        key, driven = random.step_key(self.key, t), self.drive.of(u, carry.u, carry.y)
        state, info = gated.taken(self.filter, self.gates, y, lambda filter, y: filter.step(key, self.model, carry.state, y, driven, t))
        return _apart(self._handed_on(carry, state, info, y, u, t))

    def _handed_on(self, carry: Carry, state: Any, info: Info, y: Any, u: Inputs, t: jax.Array) -> tuple[Carry, Info]:
        suspicion, rings = alarm.advanced(carry.suspicion, info.nis, info.freedom, y)
        evidence = carry.evidence.add(info.log_evidence)
        return Carry(self._gathered(state), evidence, suspicion, y, u, t), replace(info, alarm=rings)

    def _gathered(self, state: Any) -> Any:
        return state.gathered(self.given.circular)


def setup(key: jax.Array, filter: Filter, model: Model, u: Inputs, y: Any) -> Setup:
    """Check that filter, model, inputs and measurements fit each other, and prepare the model for the filter.

    Args:
        key: of the run, or one for each step `(t,)`.
        filter: the filter.
        model: the user's model.
        u: inputs of one step.
        y: one measurement; of both only shapes and types matter.

    Raises:
        MotesError: they do not; the message says what, where, and what to use instead.
    """
    u = filter.seen_inputs(u)
    model.check(u)
    if not isinstance(y, Observed) and model.measurement_size(u) not in (None, y.shape[0]):
        checks.refuse("ys", f"shape (t, {model.measurement_size(u)}), as the sensor measures", f"{y.shape[0]} components")
    independent, drive = model.independent()
    driven = drive.of(u, u, nothing_like(y))
    return Setup(key, filter, model, filter.prepare(looked_at(independent, driven, y), driven), drive, gated.gates_of(filter, model))


def carry_like(filter: Filter, model: Model, u: Inputs, y: Any) -> Carry:
    """Return the shapes of what a run of a filter on a model hands from step to step; u and y are one step's, or their shapes.

    Raises:
        MotesError: they do not fit each other.
    """
    return jax.eval_shape(lambda u, y: setup(random.as_key(0), filter, model, u, y).start(u, y), u, y)


def canonical_parts(filter: Filter, model: Model, u: Inputs, y: Any) -> tuple[Filter, Model]:
    """Return filter and model such that code compiled for equal ones is used again; u and y are one step's, or their shapes."""
    u, y = jax.tree.map(shape_of, (filter.seen_inputs(u), y))
    model = canonical(model, u, y)
    x = jax.ShapeDtypeStruct((model.size,), model.dtype)
    # a conditional among the parameters is a proposal: its functions see the pair of inputs and measurement
    proposals = {name: canonical_conditional(f"{type(filter).__name__} {name}", parameter, x, (u, value_of(y)), x)
                 for name, parameter in values(filter).items() if isinstance(parameter, Conditional)}  # fmt: skip
    return replace(filter, **proposals) if proposals else filter, model


def _apart(tree: Any) -> Any:
    """Keep the compiler from fusing across a border between steps, so that a step computes the same bits wherever it stands."""
    return jax.lax.optimization_barrier(tree)
