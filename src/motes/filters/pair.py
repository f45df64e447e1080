"""A filter and a model as compiled programs take them: their arrays, and what decides which program it is.

To find that out takes as long as a short run. It is remembered for two objects, as long as they live, of which nothing can change but what
the user's functions read: that is asked each time.
"""

import weakref
from typing import Any

import jax
import jax.numpy as jnp

from motes.core.types import Inputs
from motes.filters.interface import Filter
from motes.filters.setup import canonical_parts
from motes.models.interface import Model
from motes.tracing.identity import Beside, settings
from motes.tracing.internals import at_top
from motes.tracing.reading import Reading

_MOST = 32
"""So many pairs are remembered; the oldest goes."""


class Form:
    """What decides which compiled program runs: a static argument, whose hash is worked out once.

    Attributes:
        structure: of filter and model as a tree, their functions in a form that compares by program.
        beside: what else is read.
        light: whether programs are of few numbers.
    """

    __slots__ = ("_hash", "beside", "light", "structure")

    def __init__(self, structure: Any, beside: Beside, light: bool):
        """Take what decides."""
        self.structure, self.beside, self.light = structure, beside, light
        self._hash = hash((structure, beside, light))

    def __eq__(self, other: object) -> bool:
        """Compare by all of it."""
        if self is other or not isinstance(other, Form):
            return self is other
        return (self.light, self.beside, self.structure) == (other.light, other.beside, other.structure)

    def __hash__(self) -> int:
        """Hash by all of it."""
        return self._hash


class Pair:
    """A filter and a model, brought together for inputs and measurements of one shape.

    Attributes:
        form: what decides which compiled program runs.
        parts: the arrays of both.
        label: the filter, as it prints.
    """

    __slots__ = ("_read", "_seen", "form", "label", "parts")

    def __init__(self, filter: Filter, model: Model, u: Inputs, y: Any, alike: bool = True):
        """Bring them together; `pair` remembers.

        Args:
            filter: the filter.
            model: the user's model.
            u: inputs of one step, or their shapes.
            y: one measurement, or its shapes.
            alike: whether all inputs that the program will see are of these shapes: functions that are equal for them then count as equal.
        """
        known = canonical_parts(filter, model, u, y) if alike else (filter, model)
        self.parts: list[Any]
        self.parts, structure = jax.tree.flatten(known)
        beside = Beside(known)
        self.form, self.label = Form(structure, beside, filter.is_light(model)), repr(filter)
        self._seen = (u, y, settings(jax.config))
        functions = beside.functions if alike and at_top() else None
        self._read = None if functions is None else [(function, Reading(function).text) for function in functions]

    @property
    def lasts(self) -> bool:
        """Whether it can be told later that it still holds."""
        return self._read is not None and all(text is not None for _, text in self._read)

    def holds(self, u: Inputs, y: Any) -> bool:
        """Tell whether it holds for inputs and measurements of some shapes, and what functions read is what it was."""
        same = self._seen == (u, y, settings(jax.config)) and at_top()
        return same and all(Reading(function).text == text for function, text in self._read)  # type: ignore[union-attr]


_known: dict[tuple[int, int], tuple[weakref.ref[Any], weakref.ref[Any], Pair]] = {}


def pair(filter: Filter, model: Model, u: Inputs, y: Any, alike: bool = True) -> Pair:
    """Return filter and model brought together, after the filter has asked whether it can use the model.

    Args:
        filter: the filter.
        model: the user's model.
        u: shapes of the inputs of one step.
        y: shapes of one measurement.
        alike: see `Pair`.

    Raises:
        MotesError: they do not fit each other.
    """
    place = (id(filter), id(model))
    there = _known.get(place)
    if alike and there is not None and there[0]() is filter and there[1]() is model and there[2].holds(u, y):
        return there[2]
    filter.ask(model, u)
    found = Pair(filter, model, u, y, alike)
    _known.pop(place, None)
    if found.lasts:
        # numbers of Python would be made arrays at each call
        found.parts = [jnp.asarray(part) for part in found.parts]
        for oldest in list(_known)[: len(_known) + 1 - _MOST]:
            _known.pop(oldest, None)
        _known[place] = (*(weakref.ref(one, lambda gone: _forget(place, gone)) for one in (filter, model)), found)  # type: ignore[assignment]
    return found


def _forget(place: tuple[int, int], gone: Any) -> None:
    there = _known.get(place)
    if there is not None and any(one is gone for one in there[:2]):
        _known.pop(place, None)
