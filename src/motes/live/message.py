"""A message: what was measured at one time, and the inputs of the step that ends there; and how text becomes one."""

import json
import math
import zlib
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
DEEPEST = 32
"""Levels of lists within lists, of what a message says."""
FARTHEST = 1e12
"""Seconds beyond which there is no time: such are milliseconds or nanoseconds, whose steps would be taken for seconds."""
HIGHEST = 1 << 63
"""Number of a message that none reaches."""
MARK = b"\xef\xbb\xbf"
"""What some programs write in front of text to say that it is UTF-8."""
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
        digest: tells it from another one of the same number or time: of what came, without inputs that only held.
    """

    content: Any
    y: Any
    u: Any = None
    time: float | None = None
    number: int | None = None
    arrived: float | None = None
    digest: int = 0


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
        self._y: Any = y
        self.by_name = isinstance(y, Mapping)
        self.columns: tuple[str, ...] = names.columns or (tuple(map(str, y)) if isinstance(y, Mapping) else (MEASURED,))
        self._paths = jax.tree_util.tree_flatten_with_path(u)[0] if u is not None else []
        self._structure = None if u is None else jax.tree.structure(u)
        paths = tuple(".".join(path_names(path)) or INPUTS for path, _ in self._paths)
        self.inputs = paths if u is not None else names.inputs
        shapes: dict[str, tuple[int, ...]] = {name: np.shape(leaf) for name, (_, leaf) in zip(paths, self._paths, strict=True)}
        self._example = (y, shapes)
        self._shapes = dict(shapes)
        self.time, self.number = names.time or TIME, names.number
        self.needed = tuple(name for name in self.inputs if name != STEP)
        self.fields = names.fields or (*([self.number] if self.number else []), self.time, *self.columns, *self.needed)
        self._kept: dict[str, None] = dict.fromkeys((*([self.number] if self.number else []), self.time, *self.columns, *self.inputs))
        self.held: dict[str, Any] = {}
        self._kind = jnp.result_type(float)

    def forget(self) -> None:
        """Know the form of nothing but the examples: where the message that showed it could not be used."""
        self._y, self._shapes = self._example[0], dict(self._example[1])

    def read(self, text: bytes, arrived: float | None = None) -> Message:
        """Make a message of a line.

        Raises:
            Unreadable: it is none.
        """
        if len(text) > LONGEST:
            raise Unreadable(f"a message of {len(text)} bytes, expected at most {LONGEST}")
        text = text.removeprefix(MARK)
        content = parsed(text)
        return self.message(self._of_numbers(text) if content is None else content)._replace(arrived=arrived)

    def message(self, content: dict[str, Any]) -> Message:
        """Make a message of an object.

        Raises:
            Unreadable: it lacks something, or something is no number.
        """
        # what nobody asked for takes no memory, and is in no checkpoint
        own = {name: content[name] for name in self._kept if name in content and (content[name] is not None or name not in self.needed)}
        _check_depth(own)
        measured = any(name in own for name in self.columns)
        if not measured and not any(name in own for name in self.needed):
            keys = ascii(", ".join(content)[:120]) if content else "nothing"
            raise Unreadable(f"none of {', '.join((*self.columns, *self.needed))[:120]} in it, but {keys}")
        time = _number(own, self.time, FARTHEST)
        number = _number(own, self.number, HIGHEST) if self.number else None
        if number is not None and number % 1:
            raise Unreadable(f"{self.number!r} is no whole number: {number!r}")
        # a checkpoint that has this needs nothing else
        whole = self.held | own
        values = self._values_of_inputs(whole)
        y = self._measured(own) if measured else None
        self.held = {name: whole[name] for name in self.needed if name in whole}
        if not measured:
            return Message(whole, None, None, time)
        lacking = [name for name in self.needed if name not in self.held]
        if lacking:
            raise Early(f"the input {lacking[0]!r} has not come yet")
        self._y = y if self._y is None else self._y
        self._shapes |= {name: value.shape for name, value in values.items()}
        digest = zlib.crc32(repr(own).encode())
        return Message(whole, y, self._inputs(values), time, None if number is None else int(number), digest=digest)

    def _measured(self, content: dict[str, Any]) -> Any:
        parts = {name: _values(name, content.get(name)) for name in self.columns}
        if self.by_name:
            return {name: _in_form(name, None if content.get(name) is None else part, np.shape(self._y[name]))
                    for name, part in parts.items()}  # fmt: skip
        if len(parts) == 1:
            y = np.atleast_1d(next(iter(parts.values())))
            if self._y is not None and content.get(self.columns[0]) is None:
                return np.full(np.shape(self._y), np.nan)
        else:
            for name, part in parts.items():
                if part.ndim > 1:
                    raise Unreadable(f"{name!r} is no number or list of numbers: {content[name]!a:.60}")
            y = np.concatenate([np.atleast_1d(part) for part in parts.values()])
        if self._y is not None and y.shape != np.shape(self._y):
            raise Unreadable(f"measurements of shape {y.shape}, expected {np.shape(self._y)}")
        return y

    def _values_of_inputs(self, content: dict[str, Any]) -> dict[str, np.ndarray]:
        values = {name: _held_values(name, content[name], self._kind) for name in self.inputs if content.get(name) is not None}
        for name, value in values.items():
            if value.shape != self._shapes.get(name, value.shape):
                raise Unreadable(f"the input {name!r} of shape {value.shape}, expected {self._shapes[name]}")
        if STEP in values and (values[STEP] < 0).any():
            raise Unreadable(f"{STEP!r} is less than nothing: {content[STEP]!a:.60}")
        return values

    def _inputs(self, values: dict[str, np.ndarray]) -> Any:
        if not self.inputs:
            return {} if self._structure is None else None
        if self._structure is None:
            return values
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


def parsed(text: bytes) -> dict[str, Any] | None:
    """Return an object of JSON; None of what is none."""
    if not text.lstrip().startswith(b"{"):
        return None
    try:
        found = json.loads(text)
    except (ValueError, RecursionError) as reason:
        raise Unreadable(f"no JSON: {type(reason).__name__} in {text[:60]!r}") from None
    return found if isinstance(found, dict) else None


def _check_depth(content: dict[str, Any]) -> None:
    level = list(content.values())
    for _ in range(DEEPEST):
        level = [inner for one in level if isinstance(one, (list, dict)) for inner in one]
        if not level:
            return
    raise Unreadable(f"nested deeper than {DEEPEST} levels")


def _number(content: dict[str, Any], name: str, end: float) -> float | None:
    found = content.get(name)
    if found is None:
        return None
    # whole numbers of any length compare with floats; they do not become floats
    if isinstance(found, bool) or not isinstance(found, (int, float)) or not -math.inf < found < math.inf:
        raise Unreadable(f"{name!r} is no finite number: {found!a:.60}")
    if not -end < found < end:
        raise Unreadable(f"{name!r} is beyond {end:.3g}: {found!a:.60}")
    return found


def _in_form(name: str, found: np.ndarray | None, shape: tuple[int, ...]) -> np.ndarray:
    """Return a measurement in the shape of its example; NaN for none."""
    if found is None:
        return np.full(shape, np.nan)
    if found.shape != shape and found.size == math.prod(shape) == 1:
        found = found.reshape(shape)
    if found.shape != shape:
        raise Unreadable(f"{name!r} of shape {found.shape}, expected {shape}")
    return found


def _values(name: str, found: Any) -> np.ndarray:
    """Return numbers of JSON as an array; null is NaN."""
    try:
        array = np.asarray(checks.as_numbers(name, found), np.float64)
    except (checks.MotesError, ValueError, OverflowError):
        raise Unreadable(f"{name!r} is no number or list of numbers: {found!a:.60}") from None
    if np.isinf(array).any():
        raise Unreadable(f"{name!r} is not finite: {found!a:.60}")
    return array


def _held_values(name: str, found: Any, kind: Any) -> np.ndarray:
    """Return numbers of JSON as an array of what the filter computes with; nothing is missing.

    An input that it cannot hold would hold all the same, for all that follow.
    """
    array = _values(name, found)
    if array.dtype != kind:
        with np.errstate(over="ignore"):
            array = array.astype(kind)
    if not np.isfinite(array).all():
        raise Unreadable(f"{name!r} is not finite: {found!a:.60}")
    return array
