"""Jump-Markov systems: a mode that jumps among m as a Markov chain, and a state-space model for each mode.

    s_0 ~ initial_mode,   s_t ~ transition[s_{t-1}],   x_0 ~ initial of mode s_0,
    x_t ~ dynamics of mode s_t given x_{t-1},   y_t ~ sensor of mode s_t given x_t

The mode at t leads from x_{t-1} to x_t, and the first measurement is of x_0. Modes that differ in numbers alone are one model whose
functions take the mode (`one_model.py`): 48 of them compile as fast as two.
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from motes.core import checks
from motes.core.record import record, static
from motes.core.types import Inputs
from motes.laws.switching import (
    SwitchingDynamics,
    SwitchingLaw,
    SwitchingSensor,
    WithMode,
    in_each_mode,
    log_probabilities,
    transition_matrix,
)
from motes.models.certain import noiseless
from motes.models.interface import Model, Wrap, exchanged
from motes.models.one_model import at_mode, taking_mode
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
        models: a state-space model for each mode, with the same states; each has its own initial law, and independent noises. Or the
            one that all share.
        names: names of the states, without the mode; those of the models when not given.
        count: number m of modes.
        noiseless: indices of the states to which neither the initial law nor process noise gives variance in any mode, where the library
            has looked before it compiles; see `certain.py`.
        certain: those of them that have no variance ever, where a filter has looked that leaves them out of covariances.
    """

    initial_mode: jax.Array
    transition: jax.Array | Callable[[Any, Any], Any]
    models: tuple[StateSpaceModel, ...]
    names: tuple[str, ...] = static(default=())
    count: int = static(default=1)
    noiseless: tuple[int, ...] = static(default=())
    certain: tuple[int, ...] = static(default=())

    def __init__(
        self,
        initial_mode: Any,
        transition: Any,
        models: Any = None,
        names: tuple[str, ...] = (),
        *,
        model: StateSpaceModel | None = None,
        modes: int | None = None,
    ):
        """Check that the pieces fit each other.

        Args:
            initial_mode: see the class.
            transition: likewise.
            models: a state-space model for each mode.
            names: see the class.
            model: in place of models, one whose functions take the mode, `()` int32, as their last argument where they need it:
                `f(x, u, t, mode)`, `Q(x, u, t, mode)`.
            modes: number m of modes that share it.

        Raises:
            MotesError: a piece has the wrong kind or shape, probabilities do not sum to one, or the models differ in their states.
        """
        if (models is None) == (model is None):
            wanted = "models, one for each mode, or model=, the one that all share, with modes="
            checks.refuse("JumpMarkovModel", wanted, "neither" if model is None else "both")
        if model is None and modes is not None:
            checks.refuse("JumpMarkovModel modes", "none beside models (their number is known)", modes)
        models = (model,) if models is None else tuple(models) if isinstance(models, (tuple, list)) else (models,)
        for one in models:
            if not isinstance(one, StateSpaceModel):
                checks.refuse("JumpMarkovModel models", "a StateSpaceModel for each mode", type(one).__name__)
            if one.noise_cross_cov is not None:
                checks.refuse("JumpMarkovModel models", "independent process and measurement noise", "noise_cross_cov")
        if not models:
            checks.refuse("JumpMarkovModel models", "at least one mode", "none")
        names = tuple(names) or models[0].names
        for one in models:
            if one.size != len(names) or (one.names != names and models[0].names == names):
                checks.refuse("JumpMarkovModel models", f"the same states in all modes ({', '.join(names)})", ", ".join(one.names))
        if model is None:
            count = len(models)
        else:
            checks.positive_integer("JumpMarkovModel modes", modes)
            shared, count = taking_mode(models[0]), int(modes)  # type: ignore[arg-type]
            models = (shared if count > 1 else at_mode(shared, 0),)
        initial_mode = _probabilities("initial_mode", initial_mode, (count,), models[0].dtype)
        if not callable(transition):
            transition = _probabilities("transition", transition, (count, count), models[0].dtype)
        given = {"initial_mode": initial_mode, "transition": transition, "models": models, "names": names, "count": count}
        for name, value in (given | {"noiseless": (), "certain": ()}).items():
            object.__setattr__(self, name, value)

    @property
    def shared(self) -> bool:
        """Whether all modes share one model, whose functions find the mode among their inputs."""
        return len(self.models) < self.count

    @property
    def spread(self) -> tuple[int, ...]:
        """Indices of the states that are not certain."""
        return tuple(i for i in range(self.size) if i not in self.certain)

    @property
    def circular(self) -> tuple[int, ...]:  # type: ignore[override]
        """Indices of the states that are angles, as the dynamics of any mode declare."""
        return tuple(sorted({a for model in self.models for a in model.circular}))

    @property
    def input_names(self) -> tuple[str, ...]:  # type: ignore[override]
        """Names of the inputs, as the first mode has them."""
        return self.models[0].input_names

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
        for model in self.each_mode():
            model.check(inputs_of_step)
        sizes = {model.measurement_size(inputs_of_step) for model in self.each_mode()} - {None}
        if len(sizes) > 1:
            checks.refuse("JumpMarkovModel models", "the same number of measured components in all modes", sorted(map(str, sizes)))

    def measurement_size(self, inputs_of_step: Inputs) -> int | None:
        """Return the number of measured components, which all modes share; None where only the data can tell."""
        return self.each_mode()[0].measurement_size(inputs_of_step)

    def each_mode(self) -> tuple[StateSpaceModel, ...]:
        """Return the models of the modes, or the one that they share as it is in the first."""
        return (at_mode(self.models[0], 0),) if self.shared else self.models

    def in_each_mode(self, u: Any, ask: Callable[..., Any], given: Any = ()) -> Any:
        """Ask the model of each mode, mode axis last but one; see `laws.switching.in_each_mode`."""
        return in_each_mode(self.models, self.count, u, ask, given)

    def rebuilt(self, wrap: Wrap, u: Any, y: Any) -> "JumpMarkovModel":
        """Exchange the functions of the chain and of all modes; see `Model`."""
        number = jax.ShapeDtypeStruct((), jnp.int32)
        models = tuple(model.rebuilt(wrap, WithMode(u, number) if self.shared else u, y) for model in self.models)
        transition = wrap.function(self.transition, (u, number), "transition(u, t)")
        return exchanged(self, {"transition": transition, "models": models, "noiseless": noiseless(models)})

    def as_state_space(self) -> StateSpaceModel:
        """Return the same system as a state-space model whose last state is the number of the mode, 0 to m - 1.

        A `ParticleFilter` can run it, a `PointMassFilter` too (one node for each mode), and `simulate` draws from it.
        """
        sensors = tuple(model.sensor for model in self.models)
        # one that all modes have is asked once
        sensors = sensors[:1] if all(sensor == sensors[0] for sensor in sensors) else sensors
        return StateSpaceModel(
            SwitchingLaw(self.initial_mode, tuple(model.initial for model in self.models)),
            SwitchingDynamics(self.transition, tuple(model.dynamics for model in self.models), self.count, self.circular),
            SwitchingSensor(sensors, self.count if self.shared else 0),
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
