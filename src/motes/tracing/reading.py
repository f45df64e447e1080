"""What a Python function reads besides its arguments: told apart by value, so that code compiled for it is not used once that has changed.

A function reads what it closes over, its defaults, globals by name, attributes of modules, classes and objects; the functions it calls
read further. All of it is walked and spelled out: numbers, words and NumPy arrays by value; arrays of JAX, which cannot change, by
identity; containers, objects and classes by all that they hold, whether it is read or not, which costs at most a tracing too many.
Libraries are taken to be constant. What cannot be seen through (an iterator, a generator of random numbers, `eval`, a module's attribute
by a computed name, more than `MOST` things) makes the reading unknown.
"""

import builtins
import dis
import functools
import hashlib
import itertools
import sys
import types
import weakref
from collections import deque
from collections.abc import Mapping
from typing import Any

import jax
import numpy as np
from jax.core import Tracer

from motes.tracing.internals import JITTED

MOST = 5_000
"""So many things are looked at for one function."""
SHORT = 100
"""Letters up to which a part is spelled out, not digested."""

_CONSTANT = (bool, int, float, complex, str, bytes, range, slice, type(None), type(Ellipsis), type(NotImplemented))
_LIBRARIES = (frozenset(sys.stdlib_module_names) - {"__main__"}) | {"jax", "jaxlib", "numpy", "scipy", "ml_dtypes", "motes", "blackjax"}
_UNSEEN = ("globals", "locals", "vars", "eval", "exec", "open", "getattr", "__import__", "input", "environ", "getenv")
"""Names through which a function may read anything."""
_BY_VALUE = ("decimal", "fractions", "datetime", "uuid", "pathlib", "re", "zoneinfo")
_BLIND = ("typing", "logging", "threading", "_thread")
"""Libraries whose objects hold no numbers."""
_OF_CLASSES = ("__dict__", "__weakref__", "__doc__", "__module__", "__qualname__", "__annotations__", "__annotate_func__", "__match_args__",
               "__abstractmethods__", "_abc_impl", "__slots__", "__firstlineno__", "__static_attributes__", "__orig_bases__",
               "__parameters__", "__annotations_cache__")  # fmt: skip
_DESCRIPTORS = (types.MethodDescriptorType, types.WrapperDescriptorType, types.ClassMethodDescriptorType, types.GetSetDescriptorType,
                types.MemberDescriptorType)  # fmt: skip
_IMPORT = dis.opmap["IMPORT_NAME"]

_serials: dict[int, tuple[weakref.ref[Any], int]] = {}
_numbers = itertools.count()
_names: dict[int, tuple[str, ...]] = {}
_last: weakref.WeakKeyDictionary[Any, str] = weakref.WeakKeyDictionary()
changes = [0]
"""How often a function that others call was seen to read something else than before: JAX may hold traces of its own of it."""


class _Unknown(Exception):
    """Something cannot be seen through."""


class Reading:
    """What was found.

    Attributes:
        text: all that is read, spelled out; equal texts mean equal behavior. None where it is not known.
        helpers: names of the functions of the user's that are called.
    """

    def __init__(self, value: Any):
        """Look at a function, or at anything else."""
        self.helpers: set[str] = set()
        self._top = value
        self._known: dict[int, str] = {}
        self._held: list[Any] = []
        try:
            self.text: str | None = self._of(value)
        except (_Unknown, RecursionError):
            self.text = None

    def _of(self, value: Any) -> str:
        """Spell a value."""
        if isinstance(value, Tracer):
            raise _Unknown
        value = getattr(value, "read_as", value) if type(value).__name__ == "Program" else value
        if type(value) in _CONSTANT:
            return _short(f"{type(value).__name__} {value!r}")
        if isinstance(value, np.ma.MaskedArray):
            return self._of((value.data, np.ma.getmaskarray(value)))
        if isinstance(value, (np.ndarray, np.generic)) and not value.dtype.hasobject:
            return f"{value.dtype}{value.shape}{hashlib.sha256(np.ascontiguousarray(value).tobytes()).hexdigest()}"
        if isinstance(value, (jax.Array, types.CodeType)):
            return f"{type(value).__name__} {_serial(value)}"
        if isinstance(value, types.ModuleType):
            if not _is_library(value.__name__):
                raise _Unknown  # which of its names are read is not known here
            return f"module {value.__name__}"
        if id(value) in self._known:
            return self._known[id(value)]
        if len(self._held) >= MOST:
            raise _Unknown
        self._held.append(value)  # an id may be used again once its object is gone
        self._known[id(value)] = f"again {type(value).__qualname__}"
        text = _short(f"{type(value).__name__}({','.join(self._parts(value))})")
        self._known[id(value)] = text
        return text

    def _parts(self, value: Any) -> list[str]:
        """Spell what a value is made of."""
        if isinstance(value, types.FunctionType):
            return self._function(value)
        if isinstance(value, (types.BuiltinFunctionType, types.MethodType)):
            return [value.__name__, self._of(value.__self__)] + ([self._of(value.__func__)] if isinstance(value, types.MethodType) else [])
        if isinstance(value, _DESCRIPTORS):
            return [value.__qualname__]
        if isinstance(value, functools.partial):
            return self._all(value.func, value.args, value.keywords)
        if isinstance(value, type):
            return self._class(value)
        if isinstance(value, (staticmethod, classmethod)):
            return [self._of(value.__func__)]
        if isinstance(value, property):
            return self._all(value.fget)
        if isinstance(value, JITTED):
            return self._all(value.__wrapped__)
        if isinstance(value, types.CellType):
            return self._all(value.cell_contents) if _has_contents(value) else []
        return self._object(value)

    def _all(self, *values: Any) -> list[str]:
        return [self._of(value) for value in values]

    def _object(self, value: Any) -> list[str]:
        library = type(value).__module__.partition(".")[0]
        if library in _BY_VALUE:
            return [repr(value)]
        if library in _BLIND or isinstance(value, (np.ufunc, np.dtype)):
            return [f"{library} {_serial(value)}" if library in _BLIND else str(value)]
        found = [self._of(type(value))]
        inside = False
        if isinstance(value, (int, float, complex, str, bytes)):
            found, inside = [*found, repr(value)], True
        elif isinstance(value, Mapping):
            found, inside = found + [text for pair in value.items() for text in self._all(*pair)], True
        elif isinstance(value, (list, tuple, deque)) or (isinstance(value, np.ndarray) and value.dtype == object):
            found, inside = found + self._all(*np.ravel(value) if isinstance(value, np.ndarray) else value), True
        elif isinstance(value, (set, frozenset)):
            found, inside = found + sorted(self._all(*value)), True
        slots = [name for kind in type(value).__mro__ for name in _slots(kind) if hasattr(value, name)]
        state = {**getattr(value, "__dict__", {}), **{name: getattr(value, name) for name in slots}}
        if not (inside or state or hasattr(value, "__dict__") or type(value) is object or slots):
            raise _Unknown
        return found + [text for name, part in state.items() for text in (name, self._of(part))]

    def _class(self, kind: type) -> list[str]:
        if _is_library(kind.__module__):
            return [f"{kind.__module__}.{kind.__qualname__}"]
        held = {name: part for name, part in vars(kind).items() if name not in _OF_CLASSES and not name.startswith("__dataclass_")}
        slots = [name for name, part in held.items() if isinstance(part, (types.MemberDescriptorType, types.GetSetDescriptorType))]
        parts = [text for name, part in held.items() if name not in slots for text in (name, self._of(part))]
        return [kind.__qualname__, *parts, *self._all(*kind.__bases__, type(kind))]

    def _function(self, function: types.FunctionType) -> list[str]:
        own = self._all(function.__code__, function.__defaults__, function.__kwdefaults__, *function.__closure__ or ())
        if _is_library(function.__globals__.get("__name__", "")):
            return own  # such as jax.vmap makes of a function that it closes over
        own += [text for name, part in vars(function).items() for text in (name, self._of(part))]
        text = _short(",".join(own + self._named(function.__globals__, _names_of(function.__code__))))
        if function is not self._top:
            self.helpers.add(function.__name__)
            if _last.setdefault(function, text) != text:
                _last[function] = text
                changes[0] += 1
        return [text]

    def _named(self, there: dict[str, Any], names: tuple[str, ...]) -> list[str]:
        """Spell what names stand for among globals."""
        found = []
        for name in names:
            if name in there:
                value = there[name]
            elif name in vars(builtins) or name not in sys.modules:
                if name in _UNSEEN or name == "":
                    raise _Unknown
                continue
            else:
                value = sys.modules[name]  # perhaps imported by the function itself
            found += [name, *(self._module(value, names) if isinstance(value, types.ModuleType) else [self._of(value)])]
        return found

    def _module(self, module: types.ModuleType, names: tuple[str, ...]) -> list[str]:
        """Spell what a function may read of a module: whatever has a name that it uses."""
        if _is_library(module.__name__) or id(module) in self._known:
            return [module.__name__]
        if "__getattr__" in vars(module):
            raise _Unknown
        self._held.append(module)
        self._known[id(module)] = module.__name__
        there = {name: vars(module)[name] for name in names if name in vars(module)}
        found = self._named(there, tuple(there))
        del self._known[id(module)]
        return [module.__name__, *found]


def _short(text: str) -> str:
    return text if len(text) <= SHORT else hashlib.sha256(text.encode(errors="surrogatepass")).hexdigest()


def _is_library(module: str) -> bool:
    return module.partition(".")[0] in _LIBRARIES


def _has_contents(cell: types.CellType) -> bool:
    try:
        return cell.cell_contents is not cell
    except ValueError:
        return False


def _slots(kind: type) -> tuple[str, ...]:
    slots = vars(kind).get("__slots__", ())
    return tuple(name for name in ((slots,) if isinstance(slots, str) else slots) if name not in ("__dict__", "__weakref__"))


def _serial(value: Any) -> int:
    """Return a number that no other object of this process has, as long as it lives."""
    there = _serials.get(id(value))
    if there is None or there[0]() is not value:
        place = id(value)
        try:
            there = _serials[place] = (weakref.ref(value, lambda gone: _forget(place, gone)), next(_numbers))
        except TypeError:
            raise _Unknown from None
    return there[1]


def _forget(place: int, gone: Any) -> None:
    if place in _serials and _serials[place][0] is gone:
        _names.pop(_serials.pop(place)[1], None)


def _names_of(code: types.CodeType) -> tuple[str, ...]:
    """Return all names that a code and those within it use, imported modules by their full names; an empty one for what is not known."""
    serial = _serial(code)
    if serial not in _names:
        inner = [part for part in code.co_consts if isinstance(part, types.CodeType)]
        imports = [""] if _IMPORT in code.co_code[::2] and not all(name in sys.modules for name in _imported(code)) else []
        _names[serial] = tuple(dict.fromkeys([*code.co_names, *imports, *(name for part in inner for name in _names_of(part))]))
    return _names[serial]


def _imported(code: types.CodeType) -> list[str]:
    return [str(line.argval) for line in dis.get_instructions(code) if line.opcode == _IMPORT]
