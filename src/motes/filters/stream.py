"""On-line filtering, one step at a time, with the very numbers that `run` draws."""

from collections import deque
from functools import partial
from pathlib import Path
from typing import Any, Generic

import jax
import jax.numpy as jnp
import numpy as np

from motes.core import checks, markdown, random
from motes.core.packed import Packed
from motes.core.record import replace
from motes.core.types import Inputs, KeyLike
from motes.filters.data import checked_data, is_array, of_one_step, refuse_infinite
from motes.filters.frames import stream_facts
from motes.filters.history import Carry, History, ask_evidence
from motes.filters.history_files import measured_shapes, measurement_form, stored_shapes
from motes.filters.info import Info
from motes.filters.interface import Filter
from motes.filters.late import Past, joined_measurement
from motes.filters.pair import Pair, pair
from motes.filters.resized import resized
from motes.filters.setup import carry_like
from motes.filters.stream_steps import advance, handed_on, move, start, take_in
from motes.io import archive
from motes.laws.law import LawT
from motes.laws.observed import Observed, nothing_like, value_of
from motes.models.canonical import shape_of
from motes.models.interface import Model
from motes.models.state_space import numbers_of


@partial(jax.jit, static_argnames=("what",))
def _moment(state: Any, what: str) -> jax.Array:
    return getattr(state, what)()


class Stream(Generic[LawT]):
    """A filter at work: `update(y)`, `predict(u)`, `update(y)`, ... A `predict` without an `update` is a step without measurement.

    `predict` only remembers the step: the following `update` does it whole, in one program. Where the law is asked for in between, it is
    moved first; that of a filter with look-ahead (a particle filter with a proposal) moves only when the measurement comes.
    """

    def __init__(self, key: KeyLike, filter: Filter[LawT], model: Any, inputs: Inputs = None, lag: int = 0):
        """Stand before the first measurement.

        Args:
            key: JAX key or integer seed.
            filter: the filter.
            model: state-space or mixed linear model.
            inputs: inputs of step 0 (not of the whole run), or None.
            lag: how many steps back `insert` and `back` can go; the stream keeps as many laws.
        """
        self._past = Past(lag)
        self.key, self.filter, self.model = random.as_key(key), filter, model
        self._inputs = numbers_of("stream inputs", inputs)
        self._parts: list[Any] = []
        self._form: Any = None
        self._input_shapes: Any = None
        self._held: Packed | None = None
        self._like: Any = None
        self._pending: list[Inputs] = []
        self._updated, self._t = False, 0  # the law has its step, too, but there it would have to be waited for
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
        held = self._opened(y)
        if self._pending:
            held, kept = advance(self._form, self._parts, held, y, self._pending[-1])
        else:
            held, kept = take_in(self._form, self._parts, held, y)
        info = self._sound(held, kept)
        self._past.measured(y)
        self._held, self.info, self._updated, self._pending = held, info, True, []
        return info

    def _sound(self, held: Packed, kept: Packed) -> Info:
        """Return the record of a step, unless it is one that the filter is to stop at."""
        info: Info = kept.whole()
        if self.filter.on_collapse == "raise" and bool(info.collapsed):
            at_step, carry = jax.tree.map(lambda leaf: leaf[None], info), held.whole()
            History({}, at_step, carry, carry.step, self.model.names, repr(self.filter), **self.filter.traits).raise_on_collapse()
        return info

    def predict(self, u: Inputs = None) -> None:
        """Go to the next step, with its inputs u.

        Raises:
            MotesError: an input is not a finite number.
        """
        u = numbers_of("predict u", u)
        self._settle()
        held = self._opened(None)
        self._fit(u, self._like)
        self._past.opened(held, u, None)
        self._pending, self._updated = [u], False
        self._t += 1

    def back(self, steps: int) -> None:
        """Go back so many steps, at most `lag`, as if they had never been taken: they can be taken again, others before them.

        Raises:
            MotesError: so many are not kept.
        """
        if steps:
            self._held = self._past.taken_back(steps)
            self.info, self._updated, self._pending = None, self._held is not None, []
            self._t = max(self._t - steps, 0)

    def resize(self, filter: Filter) -> None:
        """Go on with the same filter of another number of particles, drawn from the present law; steps before cannot be gone back to.

        Args:
            filter: that other one, such as `stream.filter.with_particles(500)`.

        Raises:
            MotesError: the law has no particles that can be drawn.
        """
        carry = self._moved().whole()
        drawn = resized(random.step_key(self.key, carry.step), carry.state, filter)
        self.filter, self._form, self._past = filter, None, Past(self._past.lag)
        self._fit(carry.u, carry.y)
        self._held = handed_on(replace(carry, state=drawn))

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
        steps, held, info = list(self._past.steps), self._held, self.info
        assert held is not None
        before, u, there = steps[place]
        steps[place] = (before, u, joined_measurement(there, self._checked(y)))
        latest = len(steps) - 1
        for now in range(place, len(steps)):
            before, u, there = steps[now]
            if now > place and now == latest and not self._updated:
                # the present step has no measurement yet
                held, self._pending = before, [u]
                break
            y = self._nothing() if there is None else there
            if before is None:
                held, kept = take_in(self._form, self._parts, start(self._form, self._parts, u, y), y)
            else:
                held, kept = advance(self._form, self._parts, before, y, u)
            info = self._sound(held, kept)
            if now < latest:
                steps[now + 1] = (held, *steps[now + 1][1:])
        if place == latest:
            self._updated, self._pending = True, []
        self._held, self.info, self._past.steps = held, info, deque(steps)

    def _moved(self) -> Packed:
        """Move to the present step, where the filter can without a measurement."""
        if self._pending and not self.filter.look_ahead:
            self._held, self._pending = move(self._form, self._parts, self._opened(None), self._pending[-1]), []
        return self._opened(None)

    def _settle(self) -> None:
        """A step whose measurement never came is a step without measurement, at the latest where the next one begins."""
        if self._pending and self.filter.look_ahead:
            self._held, kept = advance(self._form, self._parts, self._held, self._nothing(), self._pending[-1])
            self.info, self._pending = kept.whole(), []
        else:
            self._moved()

    def _fit(self, u: Inputs, y: Any) -> None:
        """Find the form under which compiled code is shared with equal filters and models; it holds for inputs of one shape."""
        shapes = None if u is None else jax.tree.map(shape_of, u)
        if self._form is None:
            known = pair(self.filter, self.model, shapes, jax.tree.map(shape_of, y))
            self._input_shapes = shapes
            self._parts = [self.key, *map(jnp.asarray, known.parts)]
        elif shapes != self._input_shapes:
            known = Pair(self.filter, self.model, shapes, y, alike=False)
        else:
            return
        self._form = known.form

    def _checked(self, y: Any) -> Any:
        if y is None:
            return self._nothing()
        if self._held is None or isinstance(self._like, Observed) or not is_array(y):
            found = jax.tree.map(lambda leaf: leaf[0], checked_data(self.model, of_one_step(self.model, y), None)[0])
            form, first = (jax.tree.map(shape_of, one) for one in (found, found if self._held is None else self._like))
            if form != first:
                checks.refuse("y", f"the form of the first one, {_in_short(first)}", _in_short(form))
            return found
        y = np.atleast_1d(checks.as_numbers("y", y))
        checks.shape("y", y, self._like.shape, "(as the first one)")
        refuse_infinite("y", y, self._like.dtype)
        return np.asarray(y, self._like.dtype)

    def _nothing(self) -> Any:
        """Return a measurement that says that nothing was measured."""
        if self._held is not None:
            return nothing_like(self._like)
        size = self.model.measurement_size(self._inputs)
        if size is None:
            silent = checked_data(self.model, self.model.each_mode()[0].sensor.silence(1), None)[0]
            return jax.tree.map(lambda leaf: leaf[0], silent)
        return np.full((size,), np.nan, self.model.dtype)

    def _opened(self, y: Any) -> Any:
        if self._held is None:
            if y is None:
                checks.refuse("predict", "a measurement of step 0 first", "none", "Call update(y) with NaN if nothing was measured.")
            self._fit(self._inputs, y)
            self._like, self._held = y, start(self._form, self._parts, self._inputs, y)
            self._past.opened(None, self._inputs, None)
        return self._held

    def __repr__(self) -> str:
        """Return where the stream stands, in one line."""
        return f"Stream({', '.join(f'{what} {text}' for what, text in stream_facts(self))})"

    def _repr_markdown_(self) -> str:
        return markdown.table(("", "stream"), stream_facts(self))

    @property
    def has_begun(self) -> bool:
        """Whether anything was measured."""
        return self._held is not None

    @property
    def held(self) -> Packed | None:
        """What the last `update` left, a packed `Carry` that never changes: other threads may look at it; None before the first."""
        return self._held

    @property
    def t(self) -> int:
        """Index of the present step."""
        return self._t

    @property
    def state(self) -> LawT:
        """The present law."""
        if self._held is None:
            checks.refuse("stream", "a first measurement", "none yet", "Call update(y).")
        return self._moved().whole().state

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
        return jnp.zeros(()) if self._held is None else self._held.whole().evidence.value()

    def save(self, path: str | Path, beside: dict[str, Any] | None = None, back: int = 0) -> Path:
        """Write a checkpoint (`.npz`), whole or not at all.

        Args:
            path: the file.
            beside: what JSON can hold, to be kept with it; `motes.io.archive.read_tree` gives it back.
            back: write it as it was so many steps ago.

        Raises:
            FileError: the file cannot be written.
            MotesError: nothing has been measured yet, or then.
        """
        if self._held is None:
            checks.refuse("save", "a stream that has begun", "one without a measurement", "Call update(y) first.")
        self._settle()
        held, updated = (self._past.before(back), True) if back else (self._held, self._updated)
        texts = {"filter": repr(self.filter), "names": list(self.model.names), "updated": updated, "beside": beside}
        data = {"carry": held.whole(), "key": jax.random.key_data(self.key)}
        return archive.write_tree(Path(path), data, texts, kind="checkpoint")

    @classmethod
    def load(cls, path: str | Path, filter: Filter[LawT], model: Any, inputs: Inputs = None, lag: int = 0) -> "Stream[LawT]":
        """Read a checkpoint back, for the same filter and model.

        Args:
            path: the file.
            filter: the filter it was saved with.
            model: the model it was saved with.
            inputs: example of the inputs of one step, where they are more than an array or a dictionary of arrays.
            lag: how many steps back `insert` and `back` can go, of those that come.

        Raises:
            FileError: the file is damaged, no checkpoint, or of another filter or model; the message names the difference.
        """
        path = Path(path)

        def like(carry: dict[str, Any]) -> Carry:
            # what a header says is a tuple, and would be taken apart
            stored = stored_shapes(carry.get("u"))
            u = stored if inputs is None else numbers_of("stream inputs", inputs)
            return carry_like(filter, model, u, measured_shapes(carry["y"], model.dtype))

        def check(forms: dict[str, Any], texts: dict[str, Any]) -> None:
            for name, own in (("filter", repr(filter)), ("names", list(model.names))):
                if texts.get(name) != own:
                    hint = "Give the filter and model it was saved with."
                    checks.refuse(f"{path}: {name}", str(own), str(texts.get(name)), hint, checks.FileError)
            archive.agree(path, forms, {"key": ((2,), "iu"), **measurement_form("carry/y", forms.get("carry", {}).get("y"))})
            archive.fit(path, like(forms["carry"]), forms["carry"])

        tree, texts = archive.read_tree(path, "checkpoint", check)
        stream = cls(jax.random.wrap_key_data(jnp.asarray(tree["key"], jnp.uint32)), filter, model, lag=lag)
        carry: Carry = archive.fill(path, like(tree["carry"]), tree["carry"])
        stream._like, stream._held = carry.y, handed_on(carry)
        stream._fit(carry.u, carry.y)
        stream._updated, stream._t = bool(texts.get("updated")), int(carry.step)
        return stream


def _in_short(form: Any) -> str:
    return ", ".join(f"{leaf.dtype}{list(leaf.shape)}" for leaf in jax.tree.leaves(value_of(form)))


def stream(key: KeyLike, filter: Filter[LawT], model: Model, inputs: Inputs = None, lag: int = 0) -> Stream[LawT]:
    """Start on-line filtering; see `Stream`."""
    return Stream(key, filter, model, inputs, lag)
