"""Records: frozen dataclasses that JAX can look into.

A record prints, compares and hashes by value. Its fields are of two kinds: *data* (arrays, numbers, other records), which JAX traces,
and *structure* (sizes, names, options, functions), which decides what is compiled. A field is structure when it is declared with
`static()` or when its value is a plain function; everything else is data.
"""

import dataclasses
from collections.abc import Callable
from typing import Any, TypeVar, dataclass_transform

import jax
import numpy as np
from jax.core import Tracer

T = TypeVar("T")


def static(*, default: Any = dataclasses.MISSING, kw_only: bool = False) -> Any:
    """Declare a field of a record as structure: hashable, fixed at compile time."""
    return dataclasses.field(default=default, metadata={"static": True}, kw_only=kw_only)


def is_function(value: object) -> bool:
    """Tell whether a value is a plain function (a callable record or module with arrays inside is data)."""
    return callable(value) and jax.tree_util.all_leaves([value])


@dataclass_transform(frozen_default=True, field_specifiers=(static, dataclasses.field))
def record(cls: type[T]) -> type[T]:
    """Make a class a record: a frozen dataclass registered with JAX as a tree.

    A class that writes its own `__init__` or `__repr__` keeps it. Rebuilding inside JAX bypasses `__init__` and its checks, since JAX may
    put placeholders where arrays were.
    """
    own_init = "__init__" in cls.__dict__
    cls.__eq__ = _equal
    cls.__hash__ = _hash
    if "__repr__" not in cls.__dict__:
        cls.__repr__ = _describe
    if "__str__" in cls.__dict__ and "_repr_markdown_" not in cls.__dict__:
        cls._repr_markdown_ = _in_a_notebook  # type: ignore[attr-defined]
    made = dataclasses.dataclass(frozen=True, init=not own_init, eq=False, repr=False)(cls)
    fields = dataclasses.fields(made)  # type: ignore[arg-type]
    fixed = frozenset(f.name for f in fields if f.metadata.get("static"))
    names = tuple(f.name for f in fields)

    def split(self: Any) -> tuple[list[str], tuple[tuple[str, Any], ...]]:
        data, structure = [], []
        for name in names:
            value = getattr(self, name)
            if name in fixed or is_function(value):
                structure.append((name, value))
            else:
                data.append(name)
        return data, (*structure, ("", tuple(data)))

    def flatten(self: Any) -> tuple[list[Any], Any]:
        data, structure = split(self)
        return [getattr(self, name) for name in data], structure

    def flatten_with_keys(self: Any) -> tuple[list[Any], Any]:
        data, structure = split(self)
        return [(jax.tree_util.GetAttrKey(name), getattr(self, name)) for name in data], structure

    def unflatten(structure: Any, children: Any) -> Any:
        self = object.__new__(made)
        self.__dict__.update(structure[:-1])
        self.__dict__.update(zip(structure[-1][1], children, strict=True))
        return self

    jax.tree_util.register_pytree_with_keys(made, flatten_with_keys, unflatten, flatten)
    return made


def replace(self: T, **changes: Any) -> T:
    """Return a copy of a record with some fields changed (no checks are repeated)."""
    copy = object.__new__(type(self))
    for field in dataclasses.fields(self):  # type: ignore[arg-type]
        object.__setattr__(copy, field.name, changes.pop(field.name, getattr(self, field.name)))
    if changes:
        raise TypeError(f"{type(self).__name__} has no field {', '.join(changes)}")
    return copy


def values(self: Any) -> dict[str, Any]:
    """Return the fields of a record by name."""
    return {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}


def _map_leaves(value: Any, of_array: Callable[[np.ndarray], Any]) -> Any:
    if isinstance(value, Tracer):
        return id(value)
    if isinstance(value, (jax.Array, np.ndarray)):
        return of_array(np.asarray(value))
    if isinstance(value, (list, tuple)):
        return tuple(_map_leaves(item, of_array) for item in value)
    if isinstance(value, dict):
        return tuple((name, _map_leaves(item, of_array)) for name, item in sorted(value.items()))
    return value


def _identity(self: Any) -> tuple[Any, ...]:
    def of_array(array: np.ndarray) -> Any:
        return (array.dtype.str, array.shape, array.tobytes())

    return tuple(_map_leaves(value, of_array) for value in values(self).values())


def _equal(self: Any, other: object) -> Any:
    if type(self) is not type(other):
        return NotImplemented
    return _identity(self) == _identity(other)


def _hash(self: Any) -> int:
    return hash((type(self), _identity(self)))


def _in_a_notebook(self: Any) -> str:
    return f"```text\n{self}\n```"


def described(value: Any) -> str:
    """Return a value, or a tree of them, in one line: arrays of more than eight numbers by type and shape."""
    if isinstance(value, Tracer):
        return str(value.aval)
    if isinstance(value, (jax.Array, np.ndarray)):
        return _of_array(np.asarray(value))
    if is_function(value):
        return getattr(value, "__qualname__", repr(value))
    if type(value) is dict:
        return f"{{{', '.join(f'{name!r}: {described(part)}' for name, part in value.items())}}}"
    if type(value) in (list, tuple):
        inside = ", ".join(map(described, value))
        return f"[{inside}]" if type(value) is list else f"({inside}{',' * (len(value) == 1)})"
    if isinstance(value, tuple) and hasattr(value, "_asdict"):
        return f"{type(value).__name__}({', '.join(f'{name}={described(part)}' for name, part in value._asdict().items())})"  # type: ignore[attr-defined]
    return repr(value)


def _of_array(array: np.ndarray) -> str:
    if array.size <= 8:
        return np.array2string(array, precision=4, separator=", ").replace("\n", "")
    return f"{array.dtype}[{','.join(map(str, array.shape))}]"


def _describe(self: Any) -> str:
    shown = ", ".join(f"{f.name}={described(getattr(self, f.name))}" for f in dataclasses.fields(self))
    return f"{type(self).__name__}({shown})"
