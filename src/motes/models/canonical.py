"""Compiled code is reused by models that are built anew from equal functions.

What is compiled depends on the user's functions, and JAX tells functions apart by identity: a model rebuilt from fresh lambdas would
compile again. Here each user function is traced once on the shapes of its arguments and wrapped so that it compares by its traced program
(see `tracing/identity.py`), or, where that cannot be compared, by what it reads.
"""

from collections.abc import Mapping
from functools import cache, lru_cache
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np

from motes.core.checks import is_concrete
from motes.laws.cluttered import Cluttered
from motes.laws.conditional import AdditiveGaussian, AdditiveNoise, Conditional, LinearGaussian
from motes.laws.custom import Custom
from motes.laws.independent import Stacked, Together
from motes.laws.observed import Observed, value_of
from motes.laws.several_targets import SeveralTargets
from motes.laws.switching import SwitchingDynamics, SwitchingSensor, WithMode
from motes.models.interface import Model, Wrap, exchanged
from motes.tracing.identity import canonical_function

_MOST_ELEMENTS = 4096
SOME = 3
"""Particles that a function of all at once is traced with."""
M = TypeVar("M", bound=Model)

_FUNCTIONS = {AdditiveGaussian: ("f", "Q"), LinearGaussian: ("A", "Q"), AdditiveNoise: ("f",)}


def canonical(model: M, u: Any, y: Any = None) -> M:
    """Return a model whose user functions compare by their traced programs; a second call looks them up without tracing.

    Args:
        model: a model of any kind.
        u: inputs of one step, or their shapes.
        y: one measurement or its shapes, for densities of sensors; without it these are left alone.

    Raises:
        MotesError: a function of the user's fails; the message names it, its file and line.
    """
    u, y = jax.tree.map(shape_of, (u, y))
    return model.rebuilt(Wrap(canonical_function, canonical_conditional), u, y)


def canonical_conditional(name: str, part: Conditional, x: Any, u: Any, value: Any) -> Conditional:
    """Return a conditional whose user functions compare by their traced programs.

    Args:
        name: what it is, for messages.
        part: the conditional; kinds that are not the library's own come back as they are.
        x: shape of a state.
        u: shapes of the inputs of one step.
        value: shapes of what the conditional is the law of, or None where they are not known.
    """
    t = jax.ShapeDtypeStruct((), jnp.int32)
    if isinstance(part, (SwitchingDynamics, SwitchingSensor)):
        rest = _without_mode(x)
        chain = isinstance(part, SwitchingDynamics)
        value = _without_mode(value) if chain else value
        own = WithMode(u, t) if len(part.parts) < part.count else u
        known = {"parts": tuple(canonical_conditional(f"{name} of mode {m}", each, rest, own, value) for m, each in enumerate(part.parts))}
        return exchanged(part, known | ({"transition": canonical_function(part.transition, (u, t), "transition(u, t)")} if chain else {}))
    if isinstance(part, (Stacked, Together)):
        own = value_of(value) if isinstance(value, Observed) else {}
        parts = [canonical_conditional(f"{name} of {which}", each, x, u, own.get(which) if isinstance(own, Mapping) else None)
                 for which, each in zip(part.of_parts, part.parts, strict=True)]  # fmt: skip
        return exchanged(part, {"parts": tuple(parts)})
    if isinstance(part, SeveralTargets):
        own = jax.ShapeDtypeStruct((len(part.indices[0]),), x.dtype)
        return exchanged(part, {"one": canonical_conditional(f"{name} of one target", part.one, own, u, value)})
    if isinstance(part, Cluttered):
        row = value_of(value) if isinstance(value, Observed) else value
        row = None if row is None else jax.ShapeDtypeStruct(row.shape[1:], row.dtype)
        sensor = canonical_conditional(f"{name} of one plot", part.sensor, x, u, row)
        return exchanged(part, {"sensor": sensor, "detection": canonical_function(part.detection, (x, u, t), f"{name} detection(x, u, t)")})
    if type(part) is Custom:
        return exchanged(part, _canonical_custom(name, part, x, u, value))
    fields = _FUNCTIONS.get(type(part), ())
    wanted = {field: canonical_function(getattr(part, field), (x, u, t), f"{name} {field}(x, u, t)") for field in fields}
    return exchanged(part, wanted | ({"live": _live_in(part.A)} if isinstance(part, LinearGaussian) else {}))


def _live_in(A: Any) -> tuple[tuple[bool, ...], ...] | None:
    """Tell which elements of a matrix are not zero, where some are and its numbers are known; derivatives want all of them."""
    if callable(A) or not is_concrete(A) or np.size(A) > _MOST_ELEMENTS:
        return None
    found = np.asarray(A) != 0
    return None if found.all() else tuple(map(tuple, found.tolist()))


def _canonical_custom(name: str, part: Custom, x: Any, u: Any, value: Any) -> dict[str, Any]:
    t, value = jax.ShapeDtypeStruct((), jnp.int32), value_of(value)
    x = jax.ShapeDtypeStruct((x.shape[0] if part.states is None else len(part.states), *[SOME] * part.batched), x.dtype)
    sampler = canonical_function(part.sampler, (_key_shape(), x, u, t), f"{name} sample(key, x, u, t)")
    density, digest = part.density, part.digest
    if value is not None and digest is not None:
        digest = canonical_function(digest, (value, u, t), f"{name} digest(value, u, t)")
        value = jax.tree.map(shape_of, jax.eval_shape(lambda *args: digest(*args), value, u, t))
    if value is not None:
        density = canonical_function(density, (value, x, u, t), f"{name} log_prob(value, x, u, t)")
    return {"sampler": sampler, "density": density, "digest": digest}


def _without_mode(state: Any) -> jax.ShapeDtypeStruct:
    return jax.ShapeDtypeStruct((state.shape[0] - 1,), state.dtype)


def shape_of(leaf: Any) -> jax.ShapeDtypeStruct:
    """Shape and type of an array or number, as JAX sees it."""
    if isinstance(leaf, jax.ShapeDtypeStruct):
        return leaf
    if type(leaf) is np.ndarray:
        return _shape(leaf.shape, jax.dtypes.canonicalize_dtype(leaf.dtype), False)
    found = jax.typeof(leaf)
    return _shape(found.shape, found.dtype, found.weak_type)


def one_of(leaf: Any) -> jax.ShapeDtypeStruct:
    """Shape and type of one row of an array, as JAX sees it."""
    whole = shape_of(leaf)
    return _shape(whole.shape[1:], whole.dtype, whole.weak_type)


@lru_cache
def _shape(shape: tuple[int, ...], dtype: Any, weak_type: bool) -> jax.ShapeDtypeStruct:
    # to make one takes longer than to look it up
    return jax.ShapeDtypeStruct(shape, dtype, weak_type=weak_type)


@cache
def _key_shape() -> jax.ShapeDtypeStruct:
    return jax.eval_shape(lambda: jax.random.key(0, impl="threefry2x32"))
