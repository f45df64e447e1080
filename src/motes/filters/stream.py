"""On-line filtering, one step at a time, with the very numbers that `run` draws."""

from collections import deque
from functools import partial
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from motes.core import checks, random
from motes.core.types import Inputs, KeyLike
from motes.filters.data import checked_data, is_array, refuse_infinite
from motes.filters.history import Carry, History, ask_evidence, measurement_form
from motes.filters.info import Info
from motes.filters.interface import Filter
from motes.filters.late import Past, joined_measurement
from motes.filters.setup import Setup, canonical_parts, carry_like, setup
from motes.io import archive
from motes.io.members import Form
from motes.laws.observed import Observed, nothing_like, value_of
from motes.models.canonical import shape_of
from motes.models.interface import Model
from motes.models.state_space import numbers_of
from motes.native import report
from motes.tracing.compiling import jitted
from motes.tracing.identity import Beside


def _ready(form: Any, parts: list[Any], u: Inputs, y: jax.Array) -> Setup:
    # key, filter and model come as arrays and form: to take them apart anew at each step would cost more than many a filter does
    key, filter, model = jax.tree.unflatten(form[0], parts)
    return setup(key, filter, model, u, y)


def _is_light(form: Any, *rest: Any) -> bool:
    return form[2]


@partial(jitted, few=_is_light, static_argnums=0)
def _start(form: Any, parts: list[Any], u: Inputs, y: jax.Array) -> Carry:
    with report.collected():
        return _ready(form, parts, u, y).start(u, y)


@partial(jitted, few=_is_light, static_argnums=0)
def _move(form: Any, parts: list[Any], carry: Carry, u: Inputs) -> Carry:
    with report.collected():
        return _ready(form, parts, u, carry.y).predict(carry, u)


@partial(jitted, few=_is_light, static_argnums=0)
def _take_in(form: Any, parts: list[Any], carry: Carry, y: jax.Array) -> tuple[Carry, Info]:
    with report.collected() as notes:
        ready = _ready(form, parts, carry.u, y)
        taken = ready.update(carry, y)
        report.complete(notes, type(ready.filter).__name__)
    return taken


@partial(jitted, few=_is_light, static_argnums=0)
def _advance(form: Any, parts: list[Any], carry: Carry, y: jax.Array, u: Inputs) -> tuple[Carry, Info]:
    with report.collected():
        return _ready(form, parts, u, y).step(carry, y, u)


@partial(jax.jit, static_argnames=("what",))
def _moment(state: Any, what: str) -> jax.Array:
    return getattr(state, what)()


class Stream:
    """A filter at work: `update(y)`, `predict(u)`, `update(y)`, ... A `predict` without an `update` is a step without measurement.

    A filter with look-ahead (a particle filter with a proposal) moves only when the measurement comes: its `predict` is remembered, and the
    following `update` does the whole step.
    """

    def __init__(self, key: KeyLike, filter: Filter, model: Any, inputs: Inputs = None, lag: int = 0):
        """Stand before the first measurement.

        Args:
            key: JAX key or integer seed.
            filter: the filter.
            model: state-space or mixed linear model.
            inputs: inputs of step 0 (not of the whole run), or None.
            lag: how many steps back `insert` can go; the stream keeps as many laws.
        """
        self._past = Past(lag)
        self.key, self.filter, self.model = random.as_key(key), filter, model
        self._inputs = numbers_of("stream inputs", inputs)
        self._parts: list[Any] = []
        self._form: Any = None
        self._input_shapes: Any = None
        self._carry: Carry | None = None
        self._pending: list[Inputs] = []
        self._updated = False
        self.info: Info | None = None

    def update(self, y: Any) -> Info:
        """Take in the measurement of the present step and return the record of it.

        Args:
            y: `(y,)`, or what the model's `Custom` sensor measures; NaN, masked and NA mean not measured, None that nothing was.

        Raises:
            MotesError: y does not fit the model, or this step has its measurement already.
            CollapseError: all weights vanished and the filter's `on_collapse` is "raise"; the state is as before the call.
        """
        if self._updated:
            checks.refuse("update", "one measurement per step", "a second one", "Call predict(u) first.")
        y = self._checked(y)
        carry = self._opened(y)
        if self._pending:
            carry, info = _advance(self._form, self._parts, carry, y, self._pending[-1])
        else:
            carry, info = _take_in(self._form, self._parts, carry, y)
        self._ask_sound(carry, info)
        self._past.measured(y)
        self._carry, self.info, self._updated, self._pending = carry, info, True, []
        return info

    def _ask_sound(self, carry: Carry, info: Info) -> None:
        if self.filter.on_collapse == "raise" and bool(info.collapsed):
            at_step = jax.tree.map(lambda leaf: leaf[None], info)
            History({}, at_step, carry, carry.step, self.model.names, repr(self.filter), **self.filter.traits).raise_on_collapse()

    def predict(self, u: Inputs = None) -> None:
        """Go to the next step, with its inputs u.

        Raises:
            MotesError: an input is not a finite number.
        """
        u = numbers_of("predict u", u)
        self._settle_pending()
        carry = self._opened(None)
        self._fit(u, carry.y)
        self._past.opened(carry, u, None)
        if self.filter.look_ahead:
            self._pending = [u]
        else:
            self._carry = _move(self._form, self._parts, carry, u)
        self._updated = False

    def insert(self, y: Any, t: int) -> None:
        """Take in a measurement that came late, of a step before the present one.

        The steps since are taken once more, with the numbers that they had: all is as if it had come in time, to the bit.

        Args:
            y: the measurement, or the components of it that were missing, NaN elsewhere.
            t: its step, at most `lag` before the present one.

        Raises:
            MotesError: the step is not kept, or had this measurement already.
        """
        place = self._past.place(t)
        steps, carry, info = list(self._past.steps), self._carry, self.info
        assert carry is not None
        before, u, there = steps[place]
        steps[place] = (before, u, joined_measurement(there, self._checked(y)))
        latest = len(steps) - 1
        for now in range(place, len(steps)):
            before, u, there = steps[now]
            if now > place and now == latest and not self._updated:
                # the present step has no measurement yet
                carry = before if self.filter.look_ahead else _move(self._form, self._parts, before, u)
                break
            y = nothing_like(carry.y) if there is None else there
            if before is None:
                carry, info = _take_in(self._form, self._parts, _start(self._form, self._parts, u, y), y)
            else:
                carry, info = _advance(self._form, self._parts, before, y, u)
            self._ask_sound(carry, info)
            if now < latest:
                steps[now + 1] = (carry, *steps[now + 1][1:])
        if place == latest:
            self._updated, self._pending = True, []
        self._carry, self.info, self._past.steps = carry, info, deque(steps)

    def _settle_pending(self) -> None:
        """A look-ahead step whose measurement never came is a step without measurement."""
        if self._pending:
            carry = self._opened(None)
            self._carry, self.info = _advance(self._form, self._parts, carry, nothing_like(carry.y), self._pending[-1])
            self._pending = []

    def _fit(self, u: Inputs, y: Any) -> None:
        """Find the form under which compiled code is shared with equal filters and models; it holds for inputs of one shape."""
        shapes = None if u is None else jax.tree.map(shape_of, u)
        if self._form is None:
            self.filter.ask(self.model, shapes)
            self._input_shapes = shapes
            self._parts = [jnp.asarray(leaf) for leaf in jax.tree.leaves((self.key, self.filter, self.model))]
            known = canonical_parts(self.filter, self.model, u, y)
        elif shapes != self._input_shapes:
            known = (self.filter, self.model)
        else:
            return
        self._form = (jax.tree.structure((self.key, *known)), Beside(known), self.filter.is_light(self.model))

    def _checked(self, y: Any) -> Any:
        if y is None:
            return self._nothing()
        if self._carry is None or isinstance(self._carry.y, Observed) or not is_array(y):
            if is_array(y):
                rows = np.atleast_1d(checks.as_numbers("y", y))[None]
            else:
                rows = jax.tree.map(lambda leaf: np.asarray(checks.as_numbers("y", leaf))[None], y)
            found = jax.tree.map(lambda leaf: leaf[0], checked_data(self.model, rows, None)[0])
            form, first = (jax.tree.map(shape_of, one) for one in (found, found if self._carry is None else self._carry.y))
            if form != first:
                checks.refuse("y", f"the form of the first one, {_in_short(first)}", _in_short(form))
            return found
        y = np.atleast_1d(checks.as_numbers("y", y))
        checks.shape("y", y, self._carry.y.shape, "(as the first one)")
        refuse_infinite("y", y, self._carry.y.dtype)
        return np.asarray(y, self._carry.y.dtype)

    def _nothing(self) -> Any:
        """Return a measurement that says that nothing was measured."""
        if self._carry is not None:
            return nothing_like(self._carry.y)
        size = self.model.measurement_size(self._inputs)
        if size is None:
            checks.refuse("y", "a first measurement, which shows its form (the sensor is a Custom density)", "None",
                          "Give NaN in its form where nothing was measured.")
        return np.full((size,), np.nan, self.model.dtype)

    def _opened(self, y: Any) -> Carry:
        if self._carry is None:
            if y is None:
                checks.refuse("predict", "a measurement of step 0 first", "none", "Call update(y) with NaN if nothing was measured.")
            self._fit(self._inputs, y)
            self._carry = _start(self._form, self._parts, self._inputs, y)
            self._past.opened(None, self._inputs, None)
        assert self._carry is not None
        return self._carry

    @property
    def t(self) -> int:
        """Index of the present step."""
        return 0 if self._carry is None else int(self._carry.step) + len(self._pending)

    @property
    def state(self) -> Any:
        """The present law."""
        if self._carry is None:
            checks.refuse("stream", "a first measurement", "none yet", "Call update(y).")
        return self._carry.state

    @property
    def mean(self) -> jax.Array:
        """Mean of the present law, `(x,)`."""
        return _moment(self.state, "mean")

    @property
    def cov(self) -> jax.Array:
        """Covariance of the present law, `(x, x)`."""
        return _moment(self.state, "cov")

    @property
    def log_likelihood(self) -> jax.Array:
        """Log density of all measurements so far, `()`."""
        ask_evidence("stream.log_likelihood", self.filter.has_evidence, repr(self.filter))
        return jnp.zeros(()) if self._carry is None else self._carry.evidence.value()

    def save(self, path: str | Path) -> Path:
        """Write a checkpoint (`.npz`), whole or not at all.

        Raises:
            FileError: the file cannot be written.
            MotesError: nothing has been measured yet.
        """
        self._settle_pending()
        texts = {"filter": repr(self.filter), "names": list(self.model.names), "updated": self._updated}
        data = {"carry": self._carry_now(), "key": jax.random.key_data(self.key)}
        return archive.write_tree(Path(path), data, texts, kind="checkpoint")

    def _carry_now(self) -> Carry:
        if self._carry is None:
            checks.refuse("save", "a stream that has begun", "one without a measurement", "Call update(y) first.")
        return self._carry

    @classmethod
    def load(cls, path: str | Path, filter: Filter, model: Any, inputs: Inputs = None) -> "Stream":
        """Read a checkpoint back, for the same filter and model.

        Args:
            path: the file.
            filter: the filter it was saved with.
            model: the model it was saved with.
            inputs: example of the inputs of one step, where they are more than an array or a dictionary of arrays.

        Raises:
            FileError: the file is damaged, no checkpoint, or of another filter or model; the message names the difference.
        """
        path = Path(path)

        def like(carry: dict[str, Any]) -> Carry:
            # what a header says is a tuple, and would be taken apart
            stored = jax.tree.map(_shape, carry.get("u"), is_leaf=lambda leaf: isinstance(leaf, Form))
            u = stored if inputs is None else numbers_of("stream inputs", inputs)
            return carry_like(filter, model, u, _measured(carry["y"], model.dtype))

        def check(forms: dict[str, Any], texts: dict[str, Any]) -> None:
            for name, own in (("filter", repr(filter)), ("names", list(model.names))):
                if texts.get(name) != own:
                    hint = "Give the filter and model it was saved with."
                    checks.refuse(f"{path}: {name}", str(own), str(texts.get(name)), hint, checks.FileError)
            archive.agree(path, forms, {"key": ((2,), "iu"), **measurement_form("carry/y", forms.get("carry", {}).get("y"))})
            archive.fit(path, like(forms["carry"]), forms["carry"])

        tree, texts = archive.read_tree(path, "checkpoint", check)
        stream = cls(jax.random.wrap_key_data(jnp.asarray(tree["key"], jnp.uint32)), filter, model)
        carry: Carry = archive.fill(path, like(tree["carry"]), tree["carry"])
        stream._carry = carry
        stream._fit(carry.u, carry.y)
        stream._updated = bool(texts.get("updated"))
        return stream


def _shape(leaf: Any) -> jax.ShapeDtypeStruct:
    return jax.ShapeDtypeStruct(leaf.shape, leaf.dtype)


def _measured(stored: Any, dtype: Any) -> Any:
    """Return the shapes of a measurement that a file holds."""
    if not isinstance(stored, dict):
        return jax.ShapeDtypeStruct(stored.shape, dtype)
    shapes = jax.tree.map(_shape, stored, is_leaf=lambda leaf: isinstance(leaf, Form))
    return Observed(shapes.get("value"), shapes["there"])


def _in_short(form: Any) -> str:
    return ", ".join(f"{leaf.dtype}{list(leaf.shape)}" for leaf in jax.tree.leaves(value_of(form)))


def stream(key: KeyLike, filter: Filter, model: Model, inputs: Inputs = None, lag: int = 0) -> Stream:
    """Start on-line filtering; see `Stream`."""
    return Stream(key, filter, model, inputs, lag)
