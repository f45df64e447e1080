"""Drawing trajectories and measurements from a model."""

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp

from motes.core import checks, random
from motes.core.loop import loop, with_first
from motes.core.record import replace
from motes.core.types import Inputs, KeyLike
from motes.laws.custom import Custom
from motes.models.canonical import canonical, one_of
from motes.models.interface import Model
from motes.models.state_space import StateSpaceModel, at_step, checked_inputs
from motes.tracing.compiling import jitted
from motes.tracing.identity import Beside


def simulate(key: KeyLike, model: Model, steps: int, inputs: Inputs = None) -> tuple[jax.Array, Any]:
    """Draw a trajectory and its measurements.

    Args:
        key: JAX key or integer seed.
        model: state-space, mixed linear or jump-Markov model; the last state of the last kind is the mode.
        steps: number of steps t.
        inputs: tree with the time axis first, or None.

    Returns:
        States `(t, x)` and measurements `(t, y)`, or in the form that a `Custom` sensor draws, time axis first. Those of several sensors
        with Gaussian noise (`Independent`) are an array with the components of one sensor after those of the other, which `run` takes, too.

    Raises:
        MotesError: steps is not a positive whole number, or inputs and model do not fit together.
    """
    checks.positive_integer("simulate steps", steps)
    inputs = checked_inputs(inputs, steps, "steps", names=model.input_names)
    key = random.as_key(key)
    known = _drawn_from(model, inputs)
    return _simulate(key, known, steps, inputs, Beside(known))


def measurements(key: KeyLike, model: Model, xs: jax.Array, inputs: Inputs = None) -> Any:
    """Draw measurements of a given trajectory: those that `simulate` draws with this key, had it come along the same states.

    Args:
        key: JAX key or integer seed.
        model: state-space, mixed linear or jump-Markov model; the last state of the last kind is the mode.
        xs: states `(t, x)`.
        inputs: tree with the time axis first, or None.

    Returns:
        Measurements `(t, y)`.

    Raises:
        MotesError: the states have another shape, or the measurement noise is correlated with that of the process, which these states fix.
    """
    if model.correlated:
        checks.refuse("model", "measurement noise that is independent of the process noise, where states are given", "noise_cross_cov")
    size = model.as_state_space().size
    xs = checks.as_float("xs", xs).astype(model.dtype)
    checks.shape("xs", xs, (None, size), "(steps, states)")
    inputs = checked_inputs(inputs, xs.shape[0], "xs", names=model.input_names)
    known = _drawn_from(model, inputs)
    return _measurements(random.as_key(key), known, xs, inputs, Beside(known))


def _drawn_from(model: Model, inputs: Inputs) -> Model:
    model = canonical(model, jax.tree.map(one_of, inputs))
    if isinstance(model, StateSpaceModel) and isinstance(model.sensor, Custom):
        # a density that is not needed here must not decide what is compiled
        model = replace(model, sensor=replace(model.sensor, density=None, digest=None))
    return model


def _measurement_at(key: jax.Array, model: StateSpaceModel, x: jax.Array, u: Inputs, t: Any) -> Any:
    keyed = random.child(random.step_key(key, t), random.MEASURE)
    return jax.tree.map(lambda leaf: leaf[..., 0], model.sensor.sample(keyed, x[:, None], u, t))


@jitted
def _measurements(key: jax.Array, given: Model, xs: jax.Array, inputs: Inputs, beside: Beside) -> Any:
    model = given.as_state_space()
    key = random.child(key, random.NOISE)
    steps = jnp.arange(xs.shape[0], dtype=jnp.int32)
    return jax.lax.map(lambda now: _measurement_at(key, model, *now), (xs, inputs, steps))


@partial(jitted, static_argnames=("steps",))
def _simulate(key: jax.Array, given: Model, steps: int, inputs: Inputs, beside: Beside) -> tuple[jax.Array, Any]:
    given.check(at_step(inputs, 0))
    model: StateSpaceModel = given.as_state_space()
    # a filter that is given the same key must not draw the truth as its first particle
    key = random.child(key, random.NOISE)
    separate, drive = model.independent()

    def advance(carry: tuple[jax.Array, jax.Array], t: jax.Array) -> tuple[Any, Any]:
        x, y = carry
        u = at_step(inputs, t)
        keyed = random.child(random.step_key(key, t), random.PREDICT)
        x = separate.dynamics.sample(keyed, x[:, None], drive.of(u, at_step(inputs, t - 1), y), t)[:, 0]
        y = _measurement_at(key, model, x, u, t)
        return (x, y), (x, y)

    x = model.initial.sample(random.child(random.step_key(key, 0), random.INITIAL), 1)[:, 0]
    y = _measurement_at(key, model, x, at_step(inputs, 0), jnp.int32(0))
    _, rest = loop(advance, (x, y), jnp.arange(1, steps, dtype=jnp.int32))
    return with_first((x, y), rest)
