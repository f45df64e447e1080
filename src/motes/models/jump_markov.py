"""Jump-Markov systems: a mode that jumps among m as a Markov chain, and a state-space model for each mode.

    s_0 ~ initial_mode,   s_t ~ transition[s_{t-1}],   x_0 ~ initial of mode s_0,
    x_t ~ dynamics of mode s_t given x_{t-1},   y_t ~ sensor of mode s_t given x_t

The mode at t leads from x_{t-1} to x_t, and the first measurement is of x_0.
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from motes.core import checks
from motes.core.record import record, static
from motes.core.types import Inputs
from motes.laws.switching import SwitchingDynamics, SwitchingLaw, SwitchingSensor, log_probabilities, transition_matrix
from motes.models.interface import Model, Wrap, exchanged
from motes.models.state_space import StateSpaceModel

MODE = "mode"
"""Name of the last state of a joined model."""


@record
class JumpMarkovModel(Model):
    """A system that jumps among modes.

    Attributes:
        initial_mode: probabilities of the modes at step 0, `(m,)`.
        transition: probabilities `(m, m)` of going from the mode of a row to that of a column, or a function `(u, t)` of the inputs and the
            number of the new step that returns them.
        models: a state-space model for each mode, with the same states; each has its own initial law, and independent noises.
        names: names of the states, without the mode; those of the models when not given.
    """

    initial_mode: jax.Array
    transition: jax.Array | Callable[[Any, Any], Any]
    models: tuple[StateSpaceModel, ...]
    names: tuple[str, ...] = static(default=())

    def __init__(self, initial_mode: Any, transition: Any, models: Any, names: tuple[str, ...] = ()):
        """Check that the pieces fit each other.

        Raises:
            MotesError: a piece has the wrong kind or shape, probabilities do not sum to one, or the models differ in their states.
        """
        models = tuple(models) if isinstance(models, (tuple, list)) else (models,)
        for model in models:
            if not isinstance(model, StateSpaceModel):
                checks.refuse("JumpMarkovModel models", "a StateSpaceModel for each mode", type(model).__name__)
            if model.noise_cross_cov is not None:
                checks.refuse("JumpMarkovModel models", "independent process and measurement noise", "noise_cross_cov")
        if not models:
            checks.refuse("JumpMarkovModel models", "at least one mode", "none")
        names = tuple(names) or models[0].names
        for model in models:
            if model.size != len(names) or (model.names != names and models[0].names == names):
                checks.refuse("JumpMarkovModel models", f"the same states in all modes ({', '.join(names)})", ", ".join(model.names))
        initial_mode = _probabilities("initial_mode", initial_mode, (len(models),), models[0].dtype)
        if not callable(transition):
            transition = _probabilities("transition", transition, (len(models), len(models)), models[0].dtype)
        given = {"initial_mode": initial_mode, "transition": transition, "models": models, "names": names}
        for name, value in given.items():
            object.__setattr__(self, name, value)

    @property
    def count(self) -> int:
        """Number m of modes."""
        return len(self.models)

    @property
    def circular(self) -> tuple[int, ...]:  # type: ignore[override]
        """Indices of the states that are angles, as the dynamics of any mode declare."""
        return tuple(sorted({a for model in self.models for a in model.circular}))

    @property
    def dtype(self) -> jnp.dtype:
        """Floating type of the states."""
        return self.models[0].dtype

    def log_transition(self, u: Any, t: Any) -> jax.Array:
        """Log probabilities `(m, m)` of going from the mode of a row at t - 1 to that of a column at t."""
        return log_probabilities(transition_matrix(self.transition, u, t, self.dtype))

    def check(self, inputs_of_step: Inputs) -> None:
        """Run all functions on shapes alone and refuse what does not fit.

        Raises:
            MotesError: a function returns the wrong shape, or modes measure different numbers of components.
        """
        step = jax.ShapeDtypeStruct((), jnp.int32)
        found = jax.eval_shape(lambda u, t: transition_matrix(self.transition, u, t, self.dtype), inputs_of_step, step)
        checks.shape("transition(u, t)", jnp.zeros(found.shape), (self.count, self.count), "(modes, modes)")
        for model in self.models:
            model.check(inputs_of_step)
        sizes = {model.measurement_size(inputs_of_step) for model in self.models} - {None}
        if len(sizes) > 1:
            checks.refuse("JumpMarkovModel models", "the same number of measured components in all modes", sorted(map(str, sizes)))

    def measurement_size(self, inputs_of_step: Inputs) -> int | None:
        """Return the number of measured components, which all modes share; None where only the data can tell."""
        return self.models[0].measurement_size(inputs_of_step)

    def each_mode(self) -> tuple[StateSpaceModel, ...]:
        """Return the models of the modes."""
        return self.models

    def rebuilt(self, wrap: Wrap, u: Any, y: Any) -> "JumpMarkovModel":
        """Exchange the functions of the chain and of all modes; see `Model`."""
        models = tuple(model.rebuilt(wrap, u, y) for model in self.models)
        transition = wrap.function(self.transition, (u, jax.ShapeDtypeStruct((), jnp.int32)), "transition(u, t)")
        return exchanged(self, {"transition": transition, "models": models})

    def as_state_space(self) -> StateSpaceModel:
        """Return the same system as a state-space model whose last state is the number of the mode, 0 to m - 1.

        A `ParticleFilter` can run it, a `PointMassFilter` too (one node for each mode), and `simulate` draws from it.
        """
        sensors = tuple(model.sensor for model in self.models)
        # one that all modes have is asked once
        sensors = sensors[:1] if all(sensor == sensors[0] for sensor in sensors) else sensors
        return StateSpaceModel(
            SwitchingLaw(self.initial_mode, tuple(model.initial for model in self.models)),
            SwitchingDynamics(self.transition, tuple(model.dynamics for model in self.models), self.circular),
            SwitchingSensor(sensors),
            (*self.names, MODE),
        )


def _probabilities(name: str, value: Any, shape: tuple[int, ...], dtype: jnp.dtype) -> jax.Array:
    """Return probabilities whose last axis sums to one, or refuse."""
    argument = f"JumpMarkovModel {name}"
    array = checks.as_float(argument, value)
    checks.shape(argument, array, shape, "(one per mode)" if len(shape) == 1 else "(modes, modes)")
    if checks.is_concrete(array):
        rows = np.asarray(array, np.float64)
        if not ((rows >= 0).all() and np.allclose(rows.sum(axis=-1), 1, rtol=0, atol=1e-5)):
            wanted = "probabilities that sum to one" + (" in each row" if len(shape) > 1 else "")
            checks.refuse(argument, wanted, rows.round(6).tolist())
    return array.astype(dtype)


def as_jump_markov(model: Model) -> JumpMarkovModel:
    """Return a jump-Markov model; any other model is one with a single mode."""
    return model if isinstance(model, JumpMarkovModel) else JumpMarkovModel([1.0], [[1.0]], model.as_state_space())
