"""A message: what was measured at one time, and the inputs of the step that ends there; and how text becomes one."""

import json
import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from motes.core import checks
from motes.io.archive import path_names
from motes.io.columns import number_of

LONGEST = 1 << 16
"""Bytes of a line of text."""
TIME, MEASURED, INPUTS = "time", "y", "u"
"""What is in a message, where nobody gave it another name."""
STEP = "dt"
"""Input that is the time since the step before where a message does not bring it."""


class Message(NamedTuple):
    """What came, in the form that a stream takes.

    Attributes:
        content: the same as JSON can hold it; `Source.message` makes the message of it again.
        y: tree of arrays; None where inputs alone came.
        u: tree of inputs, without `dt` where the message did not bring it; None where the model takes none.
        time: seconds; None where it has none.
        number: of the message; None where it has none.
        arrived: seconds of this machine's clock; None where that says nothing of when it was sent.
        position: where its source goes on after it; None where that cannot be said.
    """

    content: Any
    y: Any
    u: Any = None
    time: float | None = None
    number: int | None = None
    arrived: float | None = None
    position: int | None = None


class Unreadable(Exception):
    """A message that cannot be used; the text says why."""


class Early(Unreadable):
    """A message that came before the first inputs."""


class Names(NamedTuple):
    """What is called how in messages.

    Attributes:
        columns: what is measured; all of it is "y" if not given, or has the names of an example.
        inputs: inputs of the model.
        time: the time stamps, seconds; "time" if not given.
        number: the number of a message; "" for none.
        fields: the numbers of a line that is no JSON, in order; number, time, columns and inputs if not given.
    """

    columns: tuple[str, ...] = ()
    inputs: tuple[str, ...] = ()
    time: str = ""
    number: str = ""
    fields: tuple[str, ...] = ()


class Form:
    """Makes messages of text: JSON objects, or numbers between commas.

    Inputs that a message does not bring are those of the last one that did.

    Attributes:
        time: name of the time stamps.
        number: name of the numbers; "" for none.
        columns: names of what is measured.
        inputs: names of the inputs.
    """

    def __init__(self, names: Names, y: Any = None, u: Any = None, timed: bool = False):
        """Say what a message has.

        Args:
            names: what is called how.
            y: example of a measurement: an array, or a dictionary of arrays, which the model then gets; None where the first one shows its
                form.
            u: example of inputs: a tree of arrays; None where there are none but those that are named, which the model gets in a
                dictionary.
            timed: whether a model without an example of inputs gets the time since the step before as u["dt"].
        """
        self.timed = timed
        self._y, self.by_name = y, isinstance(y, Mapping)
        self.columns = names.columns or (tuple(y) if isinstance(y, Mapping) else (MEASURED,))
        self._paths = jax.tree_util.tree_flatten_with_path(u)[0] if u is not None else []
        self._structure = None if u is None else jax.tree.structure(u)
        paths = tuple(".".join(path_names(path)) or INPUTS for path, _ in self._paths)
        self.inputs = paths if u is not None else names.inputs
        self._shapes = [np.shape(leaf) for _, leaf in self._paths]
        self.time, self.number = names.time or TIME, names.number
        self.needed = tuple(name for name in self.inputs if name != STEP)
        self.fields = names.fields or (*([self.number] if self.number else []), self.time, *self.columns, *self.needed)
        self.held: dict[str, Any] = {}
        self._kind = jnp.result_type(float)

    def read(self, text: bytes, position: int | None = None, arrived: float | None = None) -> Message:
        """Make a message of a line.

        Raises:
            Unreadable: it is none.
        """
        if len(text) > LONGEST:
            raise Unreadable(f"a message of {len(text)} bytes, expected at most {LONGEST}")
        content = _parsed(text)
        return self.message(self._of_numbers(text) if content is None else content)._replace(position=position, arrived=arrived)

    def message(self, content: dict[str, Any]) -> Message:
        """Make a message of an object.

        Raises:
            Unreadable: it lacks something, or something is no number.
        """
        content = {name: value for name, value in content.items() if value is not None or name not in self.needed}
        self.held.update((name, content[name]) for name in self.needed if name in content)
        lacking = [name for name in self.needed if name not in self.held]
        measured = any(name in content for name in self.columns)
        if lacking and measured:
            raise Early(f"the input {lacking[0]!r} has not come yet")
        if not measured and not any(name in content for name in self.needed):
            raise Unreadable(f"none of {', '.join((*self.columns, *self.needed))[:120]} in it, but {', '.join(content)[:120] or 'nothing'}")
        time = _number(content, self.time)
        number = _number(content, self.number) if self.number else None
        if number is not None and number % 1:
            raise Unreadable(f"{self.number!r} is no whole number: {number!r}")
        # a checkpoint that has this needs nothing else
        whole = self.held | content
        if not measured:
            return Message(whole, None, None, time)
        return Message(whole, self._measured(content), self._inputs(whole), time, None if number is None else int(number))

    def _measured(self, content: dict[str, Any]) -> Any:
        parts = {name: _values(name, content.get(name), missing=True) for name in self.columns}
        if self.by_name:
            return {name: np.full(np.shape(self._y[name]), np.nan) if content.get(name) is None else part for name, part in parts.items()}
        if len(parts) == 1 and self._y is not None and content.get(self.columns[0]) is None:
            return np.full(np.shape(self._y), np.nan)
        y = next(iter(parts.values())) if len(parts) == 1 else np.concatenate([np.atleast_1d(part) for part in parts.values()])
        y = np.atleast_1d(y)
        if self._y is None:
            self._y = y
        if y.shape != np.shape(self._y):
            raise Unreadable(f"measurements of shape {y.shape}, expected {np.shape(self._y)}")
        return y

    def _inputs(self, content: dict[str, Any]) -> Any:
        if not self.inputs:
            return {} if self._structure is None else None
        values = {name: _values(name, content[name]) for name in self.inputs if name in content}
        if self._structure is None:
            return values
        for name, shape in zip(self.inputs, self._shapes, strict=True):
            if name in values and values[name].shape != shape:
                raise Unreadable(f"the input {name!r} of shape {values[name].shape}, expected {shape}")
        return jax.tree.unflatten(self._structure, [values.get(name) for name in self.inputs])

    def with_step(self, u: Any, seconds: float | None) -> Any:
        """Return inputs with the time since the step before, where they have a place for it and the message did not bring it."""
        if u is None:
            return None
        if self._structure is None:
            if self.timed and seconds is None:
                raise Unreadable(f"no {self.time!r} in it")
            return ({STEP: np.asarray(seconds, self._kind), **u} if self.timed else u) or None
        leaves = jax.tree.leaves(u, is_leaf=lambda leaf: leaf is None)
        if not any(leaf is None for leaf in leaves):
            return u
        if seconds is None:
            raise Unreadable(f"neither {STEP!r} nor {self.time!r} in it")
        return jax.tree.unflatten(self._structure, [np.asarray(seconds, self._kind) if leaf is None else leaf for leaf in leaves])

    def example(self) -> str:
        """Return what a message may look like."""
        def shown(like: Any) -> Any:
            return np.round(np.zeros(np.shape(like)), 1).tolist()

        y = self._y
        parts = {name: shown(y[name] if isinstance(y, Mapping) else y if len(self.columns) == 1 and y is not None else 0.0)
                 for name in self.columns}  # fmt: skip
        u = {name: shown(leaf) for name, (_, leaf) in zip(self.inputs, self._paths, strict=False)} or dict.fromkeys(self.inputs, 0.0)
        u.pop(STEP, None)
        return json.dumps({**({self.number: 0} if self.number else {}), self.time: 0.0, **parts, **u})

    def _of_numbers(self, text: bytes) -> dict[str, Any]:
        try:
            cells = [cell.strip() for cell in text.decode("ascii").split(",")]
            numbers: list[float | None] = [number_of(cell) if cell else None for cell in cells]
        except ValueError:
            raise Unreadable(f"neither a JSON object nor numbers between commas: {text[:60]!r}") from None
        if self.columns == (MEASURED,) and MEASURED in self.fields and self._y is not None:
            # all of the measurement under one name
            at, size = self.fields.index(MEASURED), int(np.size(self._y))
            if len(numbers) == len(self.fields) - 1 + size:
                rest = numbers[:at] + numbers[at + size :]
                names = [name for name in self.fields if name != MEASURED]
                return {**dict(zip(names, rest, strict=True)), MEASURED: numbers[at : at + size]}
        if len(numbers) != len(self.fields):
            raise Unreadable(f"{len(numbers)} numbers, expected {len(self.fields)}: {', '.join(self.fields)[:160]}")
        return dict(zip(self.fields, numbers, strict=True))


def _parsed(text: bytes) -> dict[str, Any] | None:
    """Return an object of JSON; None of what is none."""
    if not text.lstrip().startswith(b"{"):
        return None
    try:
        found = json.loads(text)
    except (ValueError, RecursionError) as reason:
        raise Unreadable(f"no JSON: {type(reason).__name__} in {text[:60]!r}") from None
    return found if isinstance(found, dict) else None


def _number(content: dict[str, Any], name: str) -> float | None:
    found = content.get(name)
    if found is None:
        return None
    if isinstance(found, bool) or not isinstance(found, (int, float)) or not math.isfinite(found):
        raise Unreadable(f"{name!r} is no finite number: {found!r:.60}")
    return found


def _values(name: str, found: Any, missing: bool = False) -> np.ndarray:
    """Return numbers of JSON as an array; null is NaN in what may be missing."""
    try:
        array = np.asarray(checks.as_numbers(name, found), np.float64)
    except (checks.MotesError, ValueError, OverflowError):
        raise Unreadable(f"{name!r} is no number or list of numbers: {found!r:.60}") from None
    if np.isinf(array).any() or (not missing and np.isnan(array).any()):
        raise Unreadable(f"{name!r} is not finite: {found!r:.60}")
    return array
