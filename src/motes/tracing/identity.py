"""A user function as its traced program: two are equal when their programs are.

A program is all of a function's operations with their parameters, closed-over numbers by type, shape and bytes, inputs and outputs. Each
function is traced once on the shapes of its arguments, and again when what it reads has changed since (`reading.py`), or where that is
not known. A function that cannot be compared in this way (it closes over tracers, calls back into Python, has effects) is compared by its
identity and by what it reads.
"""

import hashlib
from collections.abc import Callable
from itertools import count
from operator import attrgetter
from types import FunctionType
from typing import Any
from weakref import WeakKeyDictionary, WeakValueDictionary

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer

from motes.core import user_functions
from motes.core.checks import MotesError
from motes.core.record import is_function
from motes.tracing.internals import PROGRAMS, called, jitted_name, keeps_traces, parameters, without_constants
from motes.tracing.program import walk
from motes.tracing.reading import Reading, changes

settings = attrgetter("jax_enable_x64", "jax_default_matmul_precision", "jax_numpy_dtype_promotion", "jax_numpy_rank_promotion",
                       "jax_default_prng_impl", "jax_threefry_partitionable", "jax_softmax_custom_jvp", "jax_disable_jit")
"""Switches of JAX that change what tracing gives."""

_MOST_SHAPES = 32
"""So many shapes of arguments are remembered per function; the oldest goes."""

_SMALL = 64
"""Bytes up to which numbers are compared themselves, not by their digest."""


class Program:
    """A user function that equals another when their traced programs are equal; calling it calls the function."""

    __slots__ = ("function", "identity", "role")

    def __init__(self, function: Callable[..., Any], identity: "_Identity", role: str):
        """Take a function, what stands for its program, and what it is called in messages."""
        self.function, self.identity, self.role = function, identity, role

    @property
    def read_as(self) -> Any:
        """What `reading.py` looks at."""
        return self.function

    def __call__(self, *args: Any) -> Any:
        """Call the function; see `user_functions.called`."""
        return user_functions.called(self.role, self.function, *args)

    def __eq__(self, other: object) -> bool:
        """Compare by program."""
        return isinstance(other, Program) and self.identity is other.identity

    def __hash__(self) -> int:
        """Hash by program."""
        return hash(self.identity)


class _Identity:
    """Stands for one program on arguments of certain shapes, as long as a function with that program lives."""

    __slots__ = ("__weakref__", "program")

    def __init__(self, program: Any):
        """Take all that the program is, as nested tuples; None where it cannot be compared."""
        self.program = program


class Rule(tuple[Any, ...]):
    """A function inside a program: its name with a digest of its code, and a number that no other function of this process has."""


class _IncomparableError(Exception):
    """Something in a program cannot be compared by value."""


# weak tables: neither functions nor what they close over live longer than without them
_found: WeakKeyDictionary[Any, dict[Any, tuple[str | None, _Identity]]] = WeakKeyDictionary()
_programs: WeakValueDictionary[Any, _Identity] = WeakValueDictionary()
_numbers: WeakKeyDictionary[FunctionType, int] = WeakKeyDictionary()
_count = count()


def canonical_function(function: Any, args: tuple[Any, ...], role: str = "function") -> Any:
    """Wrap a function so that it compares by its program, unless it is none (an array, a record, None).

    Args:
        function: of the user's.
        args: shapes of its arguments.
        role: what it is, with its arguments, for messages.

    Raises:
        MotesError: it cannot be traced; the message names it, its file and line.
    """
    if isinstance(function, Program) or not is_function(function):
        return function
    leaves, tree = jax.tree.flatten(args)
    signature = (tuple((leaf.shape, leaf.dtype, leaf.weak_type) for leaf in leaves), tree, settings(jax.config))
    identity = _known(function, signature, lambda reading: _traced(function, args, (signature, role), reading))
    return Program(function, identity, role)


def _known(function: Any, signature: Any, found: Callable[[Reading], "_Identity"]) -> "_Identity":
    """Return what stands for a function, found anew where what it reads has changed since it was last found."""
    reading = Reading(function)
    try:
        known = _found.setdefault(function, {})
    except TypeError:
        known = {}  # neither hashable nor weakly referable
    there = known.pop(signature, None)
    if there is None or reading.text is None or there[0] != reading.text:
        identity = found(reading)
        # a function that counts its calls, say, has changed what it reads by being traced
        there = (Reading(function).text, identity)
    if len(known) >= _MOST_SHAPES:
        known.pop(next(iter(known)), None)
    known[signature] = there
    return there[1]


def _traced(function: Any, args: tuple[Any, ...], about: tuple[Any, str], reading: Reading) -> "_Identity":
    signature, role = about

    def program() -> tuple[Any, Any]:
        try:
            # a function of its own: JAX would give the trace that it keeps of the user's
            return jax.make_jaxpr(lambda *args: user_functions.called(role, function, *args), return_shape=True)(*args)
        except MotesError as reason:
            # without what JAX adds about its frames
            raise type(reason)(str(reason)) from None

    made, shapes = program()
    changed = reading.helpers and changes[0] > _forgotten[0] and _Kept.traces(made, reading.helpers)
    if changed and not isinstance(jnp.zeros(()), Tracer):
        # JAX keeps traces of functions that are jitted or are bodies of loops by identity, whatever they read
        _forgotten[0] = changes[0]
        jax.clear_caches()
        made, shapes = program()
    try:
        key = (signature, jax.tree.structure(shapes), _program(made))
        return _programs.setdefault(key, _Identity(key))
    except Exception:  # the program holds what cannot be compared
        return _Identity(None)


class _Kept:
    """Rules that look for functions of which JAX keeps traces, other than the library's own."""

    def __init__(self, names: set[str]):
        self.names, self.found = names, False

    @classmethod
    def traces(cls, program: Any, names: set[str]) -> bool:
        """Tell whether there are some in a program, where jitted ones have one of the names."""
        kept = cls(names)
        walk(program, [None] * len(without_constants(program)[0].invars), kept)
        return kept.found

    def literal(self, atom: Any) -> None:
        pass

    def constant(self, variable: Any, value: Any) -> None:
        pass

    def step(self, equation: Any, operands: list[None]) -> list[None]:
        self.found |= keeps_traces(equation) or jitted_name(equation) in self.names
        if not self.found and called(equation) is not None:
            walk(called(equation), operands, self)
        return [None] * len(equation.outvars)


_forgotten = [0]
"""How many changes of what helpers read there were when JAX last forgot its traces."""


@jax.tree_util.register_static
class Beside:
    """What decides, beside the structure that JAX knows of a tree, what code compiled for it does: one more argument of such code.

    That is what functions and foreign classes in it read which are not wrapped here. Where it is not known it equals nothing else.

    Attributes:
        reads: what is read.
        functions: of the user's in the tree, where nothing else in it can change while it lives; otherwise None.
    """

    __slots__ = ("functions", "reads")

    def __init__(self, tree: Any):
        """Look at a tree of records, functions, arrays."""
        found = _Gathered()
        known = found.look(tree)
        self.reads: Any = tuple(found.texts) if known else object()
        self.functions = None if found.texts or found.changes or not known else tuple(found.functions)

    def __eq__(self, other: object) -> bool:
        """Compare by what is read."""
        return isinstance(other, Beside) and self.reads == other.reads

    def __hash__(self) -> int:
        """Hash by what is read."""
        return hash(self.reads)


_PLAIN = (Program, jax.Array, np.ndarray, np.generic, bool, int, float, str, type(None))


class _Gathered:
    """What was found in a tree.

    Attributes:
        texts: what functions and foreign classes read that are not wrapped.
        functions: those of the user's that are wrapped.
        changes: whether something in it can change where it stands.
    """

    def __init__(self) -> None:
        self.texts: list[str] = []
        self.functions: list[Any] = []
        self.changes = False

    def look(self, value: Any) -> bool:
        """Look at a value; False where it is not known what is read."""
        if type(value) in _PLAIN or isinstance(value, _PLAIN):
            if isinstance(value, Program):
                self.functions.append(value.function)
            self.changes |= isinstance(value, (np.ndarray, Tracer))
            return True
        library = type(value).__module__.partition(".")[0] in ("motes", "builtins", "collections")
        if isinstance(value, (list, tuple, dict)) and library:
            self.changes |= not isinstance(value, tuple)
            return all([self.look(item) for item in (value.values() if isinstance(value, dict) else value)])
        if isinstance(value, FunctionType):
            return _of_library(value) or self._tell(value)
        if library and hasattr(value, "__dataclass_fields__"):
            return all([self.look(item) for item in vars(value).values()])
        if jax.tree_util.all_leaves([value]):
            return self._tell(value)
        if not library and not self._tell(type(value)):
            return False
        children, structure = jax.tree_util.default_registry.flatten_one_level(value)
        return self.look(list(children)) and self.look(structure)

    def _tell(self, value: Any) -> bool:
        text = Reading(value).text
        self.texts.append(text or "")
        return text is not None


def _of_library(function: FunctionType) -> bool:
    return (function.__module__ or "").partition(".")[0] == "motes" and function.__closure__ is None


def _program(program: Any) -> tuple[Any, ...]:
    """Return all that a program is, as nested tuples: variables numbered in order of appearance, everything else by value.

    Raises:
        _IncomparableError: the program holds something that has no value to compare, or has effects.
    """
    jaxpr, consts = without_constants(program)
    if jaxpr.effects:
        raise _IncomparableError
    spelled = _Spelled(len(jaxpr.constvars), len(jaxpr.invars))
    results = walk(program, spelled.inputs, spelled)
    return (_avals(jaxpr.constvars), _avals(jaxpr.invars)), tuple(spelled.lines), tuple(results), tuple(map(_value, consts))


class _Spelled:
    """Rules that write down each equation; a number stands for each variable."""

    def __init__(self, constants: int, inputs: int):
        self.lines: list[Any] = []
        self.constants, self.inputs, self.results = iter(range(constants)), range(constants, constants + inputs), count(constants + inputs)

    def literal(self, atom: Any) -> Any:
        return atom.aval, _value(atom.val)

    def constant(self, variable: Any, value: Any) -> Any:
        return next(self.constants)

    def step(self, equation: Any, operands: list[Any]) -> list[Any]:
        held = parameters(equation)
        if held is None:
            raise _IncomparableError
        spelled = tuple((name, _value(held[name])) for name in sorted(held))
        self.lines.append((equation.primitive, equation.ctx, tuple(operands), spelled, _avals(equation.outvars)))
        return [next(self.results) for _ in equation.outvars]


def _avals(variables: Any) -> tuple[Any, ...]:
    return tuple(variable.aval for variable in variables)


def _value(value: Any) -> Any:
    """Return what stands for a parameter or constant: equal only when the value is the same."""
    if isinstance(value, (jax.Array, np.ndarray, np.generic)):
        return _tell_array(value)
    if isinstance(value, PROGRAMS):
        return _program(value)
    if isinstance(value, (float, complex)):
        return type(value), repr(value)  # 0.0 equals -0.0, and NaN not itself
    if isinstance(value, (tuple, list)):
        return type(value), tuple(map(_value, value))
    if isinstance(value, dict):
        return dict, tuple((_value(name), _value(item)) for name, item in value.items())
    if isinstance(value, FunctionType):
        code = hashlib.sha256(value.__code__.co_code).hexdigest()
        return Rule((f"{value.__module__}.{value.__qualname__} {code}", _numbers.setdefault(value, next(_count))))
    if type(value).__module__.partition(".")[0] not in ("builtins", "jax", "jaxlib", "numpy", "ml_dtypes"):
        raise _IncomparableError
    hash(value)
    return type(value), value


def _tell_array(value: Any) -> tuple[Any, ...]:
    if isinstance(value, Tracer):
        raise _IncomparableError
    if jnp.issubdtype(value.dtype, jax.dtypes.prng_key):
        return "key", str(jax.random.key_impl(value)), _tell_array(jax.random.key_data(value))
    raw = np.ascontiguousarray(value).reshape(-1).view(np.uint8)
    numbers = raw.tobytes() if raw.size <= _SMALL else hashlib.sha256(raw.data).digest()
    place = (value.sharding, value.committed, value.weak_type) if isinstance(value, jax.Array) else ()
    return type(value), value.dtype, value.shape, numbers, place
