"""The form of laws, and of trees of them, in words that JSON can hold, so that a file gives back laws and not dictionaries.

Only the laws of this room can be named: a file is data and makes nothing else.
"""

import importlib
import pkgutil
from collections.abc import Mapping
from dataclasses import fields
from functools import cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from motes.core.record import is_function
from motes.laws.law import Law

ARRAY = "array"


class UnspelledError(Exception):
    """A tree holds what cannot be spelled, or words do not spell a tree of these arrays."""


@cache
def _laws() -> dict[str, type]:
    package = __name__.rpartition(".")[0]
    there = importlib.import_module(package)
    parts = [vars(importlib.import_module(f"{package}.{module.name}")).values() for module in pkgutil.iter_modules(there.__path__)]
    known = {kind.__name__: kind for values in parts for kind in values if isinstance(kind, type) and issubclass(kind, Law)}
    return {name: kind for name, kind in known.items() if hasattr(kind, "__dataclass_fields__")}


def spelled(tree: Any) -> Any:
    """Return the form of a tree of laws, dictionaries, tuples and arrays.

    Raises:
        UnspelledError: it holds something else.
    """
    if tree is None:
        return None
    if isinstance(tree, (jax.Array, np.ndarray, np.generic, bool, int, float)):
        return ARRAY
    if isinstance(tree, dict) and all(isinstance(name, str) and "/" not in name for name in tree):
        return {"dict": {name: spelled(part) for name, part in tree.items()}}
    if isinstance(tree, (tuple, list)):
        return {"tuple": [spelled(part) for part in tree]}
    if _laws().get(type(tree).__name__) is not type(tree):
        raise UnspelledError(type(tree).__name__)
    parts, fixed = {}, {}
    for field in fields(_laws()[type(tree).__name__]):
        value = getattr(tree, field.name)
        if field.metadata.get("static"):
            fixed[field.name] = _constant(value)
        elif is_function(value):
            raise UnspelledError(f"{type(tree).__name__} {field.name}")
        else:
            parts[field.name] = spelled(value)
    return {"law": type(tree).__name__, "parts": parts, "fixed": fixed}


def _constant(value: Any) -> Any:
    if isinstance(value, (tuple, list)):
        return [_constant(item) for item in value]
    if value is None or isinstance(value, (bool, int, float, str)):
        return value
    raise UnspelledError(type(value).__name__)


def _hashable(value: Any) -> Any:
    return tuple(map(_hashable, value)) if isinstance(value, list) else _constant(value)


def restored(form: Any, arrays: Any) -> Any:
    """Return the tree of a form with its arrays, which come as nested dictionaries by name or place.

    Raises:
        UnspelledError: form and arrays do not fit each other.
    """
    if form is None:
        return None
    if form == ARRAY:
        if arrays is None or isinstance(arrays, Mapping):
            raise UnspelledError("an array is missing")
        return jnp.asarray(arrays)
    there = arrays if isinstance(arrays, Mapping) else {}
    try:
        if "dict" in form:
            return {name: restored(part, there.get(name)) for name, part in form["dict"].items()}
        if "tuple" in form:
            return tuple(restored(part, there.get(str(place))) for place, part in enumerate(form["tuple"]))
        kind, parts, fixed = _laws()[form["law"]], form["parts"], form["fixed"]
        made = object.__new__(kind)
        for field in fields(kind):
            held = _hashable(fixed[field.name]) if field.metadata.get("static") else restored(parts[field.name], there.get(field.name))
            object.__setattr__(made, field.name, held)
        return made
    except (KeyError, TypeError, AttributeError) as reason:
        raise UnspelledError(f"{type(reason).__name__}: {reason}") from None
