"""Compiled code is reused by models that are built anew from equal functions.

What is compiled depends on the user's functions, and JAX tells functions apart by identity: a model rebuilt from fresh lambdas would
compile again. Here each user function is traced once on the shapes of its arguments and wrapped so that it compares by its traced program
(see `tracing/identity.py`), or, where that cannot be compared, by what it reads.
"""

from functools import cache
from typing import Any

import jax
import jax.numpy as jnp

from motes.core.record import replace
from motes.laws.conditional import AdditiveGaussian, AdditiveNoise, Conditional, Custom, LinearGaussian
from motes.laws.switching import SwitchingDynamics, SwitchingSensor
from motes.models.jump_markov import JumpMarkovModel
from motes.models.mixed_linear import MixedLinearModel
from motes.models.state_space import StateSpaceModel
from motes.tracing.identity import canonical_function

_FUNCTIONS = {AdditiveGaussian: ("f", "Q"), LinearGaussian: ("A", "Q"), AdditiveNoise: ("f",)}


def canonical(model: Any, u: Any, y: Any = None) -> Any:
    """Return a model whose user functions compare by their traced programs; a second call looks them up without tracing.

    Args:
        model: a state-space, mixed linear or jump-Markov model; anything else comes back as it is.
        u: inputs of one step, or their shapes.
        y: one measurement `(y,)` or its shape, for densities of sensors; without it these are left alone.

    Raises:
        MotesError: a function of the user's fails; the message names it, its file and line.
    """
    u, y = jax.tree.map(shape_of, (u, y))
    t = jax.ShapeDtypeStruct((), jnp.int32)
    if isinstance(model, StateSpaceModel):
        x = jax.ShapeDtypeStruct((model.size,), model.dtype)
        return _with(model, {
            "dynamics": canonical_conditional("dynamics", model.dynamics, x, u, x),
            "sensor": canonical_conditional("sensor", model.sensor, x, u, y),
            "noise_cross_cov": canonical_function(model.noise_cross_cov, (x, u, t), "noise_cross_cov(x, u, t)"),
        })
    if isinstance(model, MixedLinearModel):
        args, names = (jax.ShapeDtypeStruct((model.sizes[0],), model.dtype), u, t), ("particle", "kalman", "sensor", "cross_cov")
        return _with(model, {name: canonical_function(getattr(model, name), args, f"{name}(x_p, u, t)") for name in names})
    if isinstance(model, JumpMarkovModel):
        models = tuple(canonical(part, u, y) for part in model.models)
        return _with(model, {"transition": canonical_function(model.transition, (u, t), "transition(u, t)"), "models": models})
    return model


def canonical_conditional(name: str, part: Conditional, x: Any, u: Any, value: Any) -> Conditional:
    """Return a conditional whose user functions compare by their traced programs.

    Args:
        name: what it is, for messages.
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
        known = {"parts": tuple(canonical_conditional(f"{name} of mode {m}", each, rest, u, value) for m, each in enumerate(part.parts))}
        return _with(part, known | ({"transition": canonical_function(part.transition, (u, t), "transition(u, t)")} if chain else {}))
    if type(part) is Custom:
        density, args = part.density, (value, x, u, t)
        density = density if value is None else canonical_function(density, args, f"{name} log_prob(value, x, u, t)")
        sampler = canonical_function(part.sampler, (_key_shape(), x, u, t), f"{name} sample(key, x, u, t)")
        return _with(part, {"sampler": sampler, "density": density})
    fields = _FUNCTIONS.get(type(part), ())
    return _with(part, {field: canonical_function(getattr(part, field), (x, u, t), f"{name} {field}(x, u, t)") for field in fields})


def _without_mode(state: Any) -> jax.ShapeDtypeStruct:
    return jax.ShapeDtypeStruct((state.shape[0] - 1,), state.dtype)


def shape_of(leaf: Any) -> jax.ShapeDtypeStruct:
    """Shape and type of an array or number, as JAX sees it."""
    if isinstance(leaf, jax.ShapeDtypeStruct):
        return leaf
    found = jax.typeof(leaf)
    return jax.ShapeDtypeStruct(found.shape, found.dtype, weak_type=found.weak_type)


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
