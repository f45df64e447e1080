"""What a model, a filter or a tree of arrays is, as a digest that is the same in all processes: what a store on disk is known by."""

import dataclasses
import hashlib
from types import FunctionType
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from motes.core.checks import refuse
from motes.core.record import is_function
from motes.tracing.identity import Program, Rule
from motes.tracing.internals import Primitive


def fingerprint(argument: str, value: Any) -> str:
    """Return a digest of what a canonical model, a filter or a tree of arrays is: equal in all processes with one version of JAX.

    Args:
        argument: name to use in the message.
        value: records, tuples, dictionaries, arrays and functions that `identity.canonical_function` has wrapped.

    Raises:
        MotesError: a function cannot be compared by its traced program.
    """
    return hashlib.sha256(_spelled(argument, value).encode()).hexdigest()


def _spelled(argument: str, value: Any) -> str:
    """Write down what a value is: what holds others by its name and them, the rest by a word."""
    if isinstance(value, Program) and value.identity.program is not None:
        return _spelled(argument, value.identity.program)
    if isinstance(value, Rule):
        return value[0]
    if isinstance(value, (tuple, list)):
        return f"{type(value).__name__}({','.join(_spelled(argument, item) for item in value)})"
    if isinstance(value, dict):
        return f"dict({','.join(f'{_spelled(argument, name)}:{_spelled(argument, item)}' for name, item in value.items())})"
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        fields = {field.name: getattr(value, field.name) for field in dataclasses.fields(value)}
        return f"{type(value).__qualname__}{_spelled(argument, fields)}"
    if not jax.tree_util.all_leaves([value]):
        leaves, form = jax.tree.flatten(value)  # of somebody else's class
        return _spelled(argument, (str(form), leaves))
    return _word(argument, value)


def _word(argument: str, value: Any) -> str:
    """Write down an array, a function of the library's, or a plain value; refuse what only says where in memory it is."""
    if isinstance(value, (jax.Array, np.ndarray)) and not jnp.issubdtype(value.dtype, jax.dtypes.prng_key):
        return f"{value.dtype}{value.shape}{hashlib.sha256(np.ascontiguousarray(value).tobytes()).hexdigest()}"
    if isinstance(value, FunctionType) and (value.__module__ or "").startswith("motes.") and value.__closure__ is None:
        return f"{value.__module__}.{value.__qualname__}"
    text = value.name if isinstance(value, Primitive) else repr(value)
    foreign = is_function(value) and not isinstance(value, type) and type(value).__module__.partition(".")[0] not in ("jax", "jaxlib")
    if foreign or " at 0x" in text:
        name = getattr(getattr(value, "function", value), "__qualname__", text)[:80]
        refuse(argument, "functions that can be compared by their traced programs", name,
               "It calls back into Python or has a custom_vjp; without a store it may.")
    return f"{type(value).__name__} {text}"
