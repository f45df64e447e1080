"""Compiled code is reused by models that are built anew from equal functions.

What is compiled depends on the user's functions, and JAX tells functions apart by identity: a model rebuilt from fresh lambdas would
compile again. Here each user function is traced once on the shapes of its arguments and wrapped so that it compares by the traced program:
its operations with all their parameters, closed-over numbers by type, shape and bytes, inputs and outputs. A function that cannot be
compared in this way (it closes over tracers, calls back into Python, has effects, or fails) is left alone and compares by identity.

Functions are taken to be pure, as everywhere in JAX: one whose closed-over values are changed after its first use must be made anew.
"""

import dataclasses
import hashlib
from collections.abc import Callable
from functools import cache
from itertools import count
from operator import attrgetter
from types import FunctionType
from typing import Any
from weakref import WeakKeyDictionary, WeakValueDictionary

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jax.extend.core import ClosedJaxpr, Jaxpr, Literal, Primitive

from motes.core.checks import refuse
from motes.core.record import is_function, replace
from motes.laws.conditional import AdditiveGaussian, AdditiveNoise, Conditional, Custom, LinearGaussian
from motes.laws.switching import SwitchingDynamics, SwitchingSensor
from motes.models.jump_markov import JumpMarkovModel
from motes.models.mixed_linear import MixedLinearModel
from motes.models.state_space import StateSpaceModel

_FUNCTIONS = {AdditiveGaussian: ("f", "Q"), LinearGaussian: ("A", "Q"), AdditiveNoise: ("f",)}

_settings = attrgetter("jax_enable_x64", "jax_default_matmul_precision", "jax_numpy_dtype_promotion", "jax_numpy_rank_promotion",
                       "jax_default_prng_impl", "jax_threefry_partitionable", "jax_softmax_custom_jvp", "jax_disable_jit")
"""Switches of JAX that change what tracing gives."""

_MOST_SHAPES = 32
"""So many shapes of arguments are remembered per function; the oldest goes."""

_SMALL = 64
"""Bytes up to which numbers are compared themselves, not by their digest."""


class Program:
    """A user function that equals another when their traced programs are equal; calling it calls the function."""

    __slots__ = ("function", "identity")

    def __init__(self, function: Callable[..., Any], identity: "_Identity"):
        """Take a function and what stands for its program."""
        self.function, self.identity = function, identity

    def __call__(self, *args: Any) -> Any:
        """Call the function."""
        return self.function(*args)

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
        """Take all that the program is, as nested tuples."""
        self.program = program


class _Rule(tuple[Any, ...]):
    """A function inside a program: its name with a digest of its code, and a number that no other function of this process has."""


class _IncomparableError(Exception):
    """Something in a program cannot be compared by value."""


# weak tables: neither functions nor what they close over live longer than without them
_found: WeakKeyDictionary[Any, dict[Any, _Identity | None]] = WeakKeyDictionary()
_programs: WeakValueDictionary[Any, _Identity] = WeakValueDictionary()
_numbers: WeakKeyDictionary[FunctionType, int] = WeakKeyDictionary()
_count = count()


def canonical(model: Any, u: Any, y: Any = None) -> Any:
    """Return a model whose user functions compare by their traced programs; a second call looks them up without tracing.

    Args:
        model: a state-space, mixed linear or jump-Markov model; anything else comes back as it is.
        u: inputs of one step, or their shapes.
        y: one measurement `(y,)` or its shape, for densities of sensors; without it these are left alone.
    """
    u, y = jax.tree.map(shape_of, (u, y))
    t = jax.ShapeDtypeStruct((), jnp.int32)
    if isinstance(model, StateSpaceModel):
        x = jax.ShapeDtypeStruct((model.size,), model.dtype)
        return _with(model, {
            "dynamics": canonical_conditional(model.dynamics, x, u, x),
            "sensor": canonical_conditional(model.sensor, x, u, y),
            "noise_cross_cov": canonical_function(model.noise_cross_cov, (x, u, t)),
        })
    if isinstance(model, MixedLinearModel):
        args, names = (jax.ShapeDtypeStruct((model.sizes[0],), model.dtype), u, t), ("particle", "kalman", "sensor", "cross_cov")
        return _with(model, {name: canonical_function(getattr(model, name), args) for name in names})
    if isinstance(model, JumpMarkovModel):
        models = tuple(canonical(part, u, y) for part in model.models)
        return _with(model, {"transition": canonical_function(model.transition, (u, t)), "models": models})
    return model


def canonical_conditional(part: Conditional, x: Any, u: Any, value: Any) -> Conditional:
    """Return a conditional whose user functions compare by their traced programs.

    Args:
        part: the conditional; kinds that are not the library's own come back as they are.
        x: shape of a state.
        u: shapes of the inputs of one step.
        value: shape of what the conditional is the law of, or None where it is not known.
    """
    t = jax.ShapeDtypeStruct((), jnp.int32)
    if isinstance(part, (SwitchingDynamics, SwitchingSensor)):
        rest = _without_mode(x)
        chain = isinstance(part, SwitchingDynamics)
        value = _without_mode(value) if chain else value
        known = {"parts": tuple(canonical_conditional(each, rest, u, value) for each in part.parts)}
        return _with(part, known | ({"transition": canonical_function(part.transition, (u, t))} if chain else {}))
    if type(part) is Custom:
        density = part.density if value is None else canonical_function(part.density, (value, x, u, t))
        return _with(part, {"sampler": canonical_function(part.sampler, (_key_shape(), x, u, t)), "density": density})
    return _with(part, {name: canonical_function(getattr(part, name), (x, u, t)) for name in _FUNCTIONS.get(type(part), ())})


def _without_mode(state: Any) -> jax.ShapeDtypeStruct:
    return jax.ShapeDtypeStruct((state.shape[0] - 1,), state.dtype)


def shape_of(leaf: Any) -> jax.ShapeDtypeStruct:
    """Shape and type of an array or number, as JAX sees it."""
    if isinstance(leaf, jax.ShapeDtypeStruct):
        return leaf
    seen = jax.typeof(leaf)
    return jax.ShapeDtypeStruct(seen.shape, seen.dtype, weak_type=seen.weak_type)


def one_of(leaf: Any) -> jax.ShapeDtypeStruct:
    """Shape and type of one row of an array, as JAX sees it."""
    whole = shape_of(leaf)
    return jax.ShapeDtypeStruct(whole.shape[1:], whole.dtype, weak_type=whole.weak_type)


@cache
def _key_shape() -> jax.ShapeDtypeStruct:
    return jax.eval_shape(lambda: jax.random.key(0, impl="threefry2x32"))


def _with(record: Any, wanted: dict[str, Any]) -> Any:
    changed = {name: value for name, value in wanted.items() if value is not getattr(record, name)}
    return replace(record, **changed) if changed else record


def canonical_function(function: Any, args: tuple[Any, ...]) -> Any:
    """Wrap a function, unless it is none (an array, a record, None) or cannot be compared."""
    if isinstance(function, Program) or not is_function(function):
        return function
    leaves, tree = jax.tree.flatten(args)
    signature = (tuple((leaf.shape, leaf.dtype, leaf.weak_type) for leaf in leaves), tree, _settings(jax.config))
    try:
        known = _found.setdefault(function, {})
    except TypeError:
        return function  # neither hashable nor weakly referable
    if signature not in known:
        if len(known) >= _MOST_SHAPES:
            known.pop(next(iter(known)), None)
        known[signature] = _identity(function, args, signature)
    identity = known[signature]
    return function if identity is None else Program(function, identity)


def _identity(function: Any, args: tuple[Any, ...], signature: Any) -> _Identity | None:
    try:
        program, shapes = jax.make_jaxpr(function, return_shape=True)(*args)
        key = (signature, jax.tree.structure(shapes), _program(program.jaxpr, program.consts))
        return _programs.setdefault(key, _Identity(key))
    except Exception:  # whatever is wrong with the function, the run that uses it says it better
        return None


def _program(jaxpr: Any, consts: Any) -> tuple[Any, ...]:
    """Return all that a program is, as nested tuples: variables numbered in order of appearance, everything else by value.

    Raises:
        _IncomparableError: the program holds something that has no value to compare, or has effects.
    """
    if jaxpr.effects:
        raise _IncomparableError
    numbers: dict[Any, int] = {}

    def bound(variables: Any) -> tuple[Any, ...]:
        for variable in variables:
            numbers[variable] = len(numbers)
        return tuple(variable.aval for variable in variables)

    def used(atoms: Any) -> tuple[Any, ...]:
        return tuple((atom.aval, _value(atom.val)) if isinstance(atom, Literal) else numbers[atom] for atom in atoms)

    inputs = (bound(jaxpr.constvars), bound(jaxpr.invars))
    lines = tuple((eqn.primitive, eqn.ctx, used(eqn.invars), _parameters(eqn), bound(eqn.outvars)) for eqn in jaxpr.eqns)
    return inputs, lines, used(jaxpr.outvars), tuple(map(_value, consts))


def _parameters(eqn: Any) -> tuple[Any, ...]:
    params = dict(eqn.params)
    if eqn.primitive.name.startswith("custom_vjp") or eqn.primitive.name.endswith("callback"):
        raise _IncomparableError  # these hold functions of JAX's own making, new at each tracing
    if eqn.primitive.name == "custom_jvp_call":
        params["jvp_jaxpr_fun"] = _derivative_rule(params["jvp_jaxpr_fun"])
    return tuple((name, _value(params[name])) for name in sorted(params))


def _derivative_rule(traced: Any) -> Any:
    """Return the user's own derivative rule, which JAX keeps in closures; any failure to find it leaves the function alone."""

    def held(function: Any, name: str) -> Any:
        return function.__closure__[function.__code__.co_freevars.index(name)].cell_contents

    rule = held(held(traced.f, "fn"), "jvp")
    if len(rule.transforms) != 1:
        raise _IncomparableError  # more than flattening of arguments: under vmap, or with arguments that are no arrays
    return rule.f


def _value(value: Any) -> Any:
    """Return what stands for a parameter or constant: equal only when the value is the same."""
    if isinstance(value, (jax.Array, np.ndarray, np.generic)):
        return _array(value)
    if isinstance(value, (Jaxpr, ClosedJaxpr)):
        return _program(getattr(value, "jaxpr", value), getattr(value, "consts", ()))
    if isinstance(value, (float, complex)):
        return type(value), repr(value)  # 0.0 equals -0.0, and NaN not itself
    if isinstance(value, (tuple, list)):
        return type(value), tuple(map(_value, value))
    if isinstance(value, dict):
        return dict, tuple((_value(name), _value(item)) for name, item in value.items())
    if isinstance(value, FunctionType):
        code = hashlib.sha256(value.__code__.co_code).hexdigest()
        return _Rule((f"{value.__module__}.{value.__qualname__} {code}", _numbers.setdefault(value, next(_count))))
    if type(value).__module__.partition(".")[0] not in ("builtins", "jax", "jaxlib", "numpy", "ml_dtypes"):
        raise _IncomparableError
    hash(value)
    return type(value), value


def _array(value: Any) -> tuple[Any, ...]:
    if isinstance(value, Tracer):
        raise _IncomparableError
    if jnp.issubdtype(value.dtype, jax.dtypes.prng_key):
        return "key", str(jax.random.key_impl(value)), _array(jax.random.key_data(value))
    raw = np.ascontiguousarray(value).reshape(-1).view(np.uint8)
    numbers = raw.tobytes() if raw.size <= _SMALL else hashlib.sha256(raw.data).digest()
    place = (value.sharding, value.committed, value.weak_type) if isinstance(value, jax.Array) else ()
    return type(value), value.dtype, value.shape, numbers, place


def fingerprint(argument: str, value: Any) -> str:
    """Return a digest of what a canonical model, a filter or a tree of arrays is: equal in all processes with one version of JAX.

    Args:
        argument: name to use in the message.
        value: records, tuples, dictionaries, arrays and functions that `canonical` has wrapped.

    Raises:
        MotesError: a function cannot be compared by its traced program.
    """
    return hashlib.sha256(_spelled(argument, value).encode()).hexdigest()


def _spelled(argument: str, value: Any) -> str:
    if isinstance(value, Program):
        return _spelled(argument, value.identity.program)
    if isinstance(value, _Rule):
        return value[0]
    if isinstance(value, (tuple, list)):
        return f"{type(value).__name__}({','.join(_spelled(argument, item) for item in value)})"
    if isinstance(value, dict):
        return f"dict({','.join(f'{_spelled(argument, name)}:{_spelled(argument, item)}' for name, item in value.items())})"
    if isinstance(value, (jax.Array, np.ndarray)) and not jnp.issubdtype(value.dtype, jax.dtypes.prng_key):
        return f"{value.dtype}{value.shape}{hashlib.sha256(np.ascontiguousarray(value).tobytes()).hexdigest()}"
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        fields = ((field.name, getattr(value, field.name)) for field in dataclasses.fields(value))
        return f"{type(value).__qualname__}{_spelled(argument, dict(fields))}"
    if not jax.tree_util.all_leaves([value]):
        leaves, form = jax.tree.flatten(value)
        return _spelled(argument, (str(form), leaves))
    if isinstance(value, FunctionType) and value.__module__.startswith("motes.") and value.__closure__ is None:
        return f"{value.__module__}.{value.__qualname__}"
    text = value.name if isinstance(value, Primitive) else repr(value)
    foreign = is_function(value) and not isinstance(value, type) and type(value).__module__.partition(".")[0] not in ("jax", "jaxlib")
    if foreign or " at 0x" in text:
        refuse(argument, "functions that can be compared by their traced programs", getattr(value, "__qualname__", text)[:80],
               "It calls back into Python, has a custom_vjp, or fails on its own; without a store it may.")
    return f"{type(value).__name__} {text}"
