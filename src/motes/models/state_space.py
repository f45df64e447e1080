"""State-space models: a law of the first state, dynamics from step to step, a sensor at each step.

    x_0 ~ initial,   x_t ~ dynamics given (x_{t-1}, u_t, t),   y_t ~ sensor given (x_t, u_t, t),   t = 0, 1, ...

The first measurement y_0 is of x_0, before any dynamics.
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from motes.core import checks, random
from motes.core.record import record, replace, static
from motes.core.types import Inputs, MatrixLike
from motes.io import tabular
from motes.laws.circular import near
from motes.laws.cluttered import Cluttered
from motes.laws.conditional import AdditiveGaussian, AdditiveNoise, Conditional, check_matrix
from motes.laws.custom import Custom
from motes.laws.law import Law, as_law, check_size, drawn
from motes.laws.several_targets import SeveralTargets
from motes.models.correlated import Drive, decorrelated
from motes.models.interface import Model, Wrap, exchanged

LARGEST = float(np.finfo(np.float32).max)
"""Of the numbers that are finite in every type that is computed with."""


@record
class StateSpaceModel(Model):
    """What the world does.

    Attributes:
        initial: law of x_0, before y_0.
        dynamics: law of x_t given x_{t-1}.
        sensor: law of y_t given x_t.
        names: names of the states; x0, x1, ... when not given.
        noise_cross_cov: covariance `(x, y)` of the process noise that leads from t to t+1 with the measurement noise at t, an array
            or a user function; None when they are independent. Both noises must then be additive Gaussian.
        input_names: names of the inputs of a step where these are an array; of tables the columns of these names are taken, in this order.
    """

    initial: Law
    dynamics: Conditional
    sensor: Conditional
    names: tuple[str, ...] = static(default=())
    noise_cross_cov: MatrixLike | None = None
    input_names: tuple[str, ...] = static(default=())

    def __init__(
        self,
        initial: Law,
        dynamics: Conditional,
        sensor: Conditional,
        names: tuple[str, ...] = (),
        noise_cross_cov: MatrixLike | None = None,
        input_names: tuple[str, ...] = (),
    ):
        """Check the kinds of the pieces, the indices of angles, the names and the cross-covariance; `check` looks at the functions.

        Raises:
            MotesError: a piece has the wrong kind or size; the message names it.
        """
        initial = as_law("StateSpaceModel initial", initial)
        for name, value in (("dynamics", dynamics), ("sensor", sensor)):
            if not isinstance(value, Conditional):
                checks.refuse(f"StateSpaceModel {name}", "LinearGaussian, AdditiveGaussian, AdditiveNoise or Custom", type(value).__name__)
        size = drawn(initial).shape[0]
        if any(not -size <= index < size for index in dynamics.angles):
            checks.refuse("StateSpaceModel dynamics angles", f"indices of the {size} states", list(dynamics.angles))
        # negative indices count from the end; a cloud on both sides of the cut is put on one branch before anything is averaged
        initial = initial.gathered(tuple(index % size for index in dynamics.angles))
        names = tuple(names) or tuple(f"x{i}" for i in range(size))
        if len(names) != size or len(set(names)) != size:
            checks.refuse("StateSpaceModel names", f"{size} different names, one per state", list(names))
        sensor = sensor.of_states(names)
        if noise_cross_cov is not None:
            noise_cross_cov = _checked_cross_cov(noise_cross_cov, dynamics, sensor, size)
        fields = {"initial": initial, "dynamics": dynamics, "sensor": sensor, "names": names, "noise_cross_cov": noise_cross_cov,
                  "input_names": tuple(input_names)}  # fmt: skip
        for name, value in fields.items():
            object.__setattr__(self, name, value)

    @property
    def dtype(self) -> jnp.dtype:
        """Floating type of the states."""
        return drawn(self.initial).dtype

    @property
    def circular(self) -> tuple[int, ...]:  # type: ignore[override]
        """Indices of the states that are angles, as the dynamics declare."""
        return tuple(sorted({int(a) % self.size for a in self.dynamics.angles}))

    @property
    def modes(self) -> int:  # type: ignore[override]
        """Number of modes, the index of which is the last state, of a joined jump-Markov model; 0 of any other."""
        return self.dynamics.modes

    @property
    def correlated(self) -> bool:  # type: ignore[override]
        """Whether process and measurement noise are correlated."""
        return self.noise_cross_cov is not None

    def initial_log_prob(self, X: jax.Array) -> jax.Array:
        """Log density of x_0 at `(x,)` or `(x, n)`; states that are angles may be given on any branch."""
        return self.initial.log_prob(near(X, self.initial.mean(), self.circular) if self.circular else X)

    def check(self, inputs_of_step: Inputs) -> None:
        """Run dynamics and sensor on shapes alone and refuse what does not fit.

        Raises:
            MotesError: the dynamics do not return `(x,)`, or a covariance does not fit.
        """
        x = jax.ShapeDtypeStruct((self.size,), self.dtype)
        t = jax.ShapeDtypeStruct((), jnp.int32)
        for name, part, expected in (("dynamics", self.dynamics, self.size), ("sensor", self.sensor, None)):
            if isinstance(part, SeveralTargets):
                x, part = jax.ShapeDtypeStruct((len(part.indices[0]),), self.dtype), part.one  # noqa: PLW2901 (checked as of one target)
            if isinstance(part, Cluttered):
                part.check(x, inputs_of_step, t)
                name, part = f"{name} of one plot", part.sensor  # noqa: PLW2901 (whose functions are checked as any other's)
            if isinstance(part, AdditiveGaussian):
                _check_moments(name, part, x, inputs_of_step, t, expected)
            elif isinstance(part, AdditiveNoise):
                found = _predicted(part, x, inputs_of_step, t)
                checks.shape(f"{name} f(x, u, t)", jnp.zeros(found), (expected,))
                check_size(f"{name} law", part.law, found[0])
            elif isinstance(part, Custom) and part.sampler is not None and expected is not None:
                found = jax.eval_shape(lambda x, u, t, part=part: part.sample(random.as_key(0), x[:, None], u, t), x, inputs_of_step, t)
                checks.shape(f"{name} sample(key, x, u, t)", jnp.zeros(found.shape[:-1]), (expected,))

    def measurement_size(self, inputs_of_step: Inputs) -> int | None:
        """Return the number of measured components, or None where only the data can tell (a custom density)."""
        if not isinstance(self.sensor, (AdditiveGaussian, AdditiveNoise)):
            return None
        x = jax.ShapeDtypeStruct((self.size,), self.dtype)
        return _predicted(self.sensor, x, inputs_of_step, jax.ShapeDtypeStruct((), jnp.int32))[0]

    def as_state_space(self) -> "StateSpaceModel":
        """Return the model itself."""
        return self

    def rebuilt(self, wrap: Wrap, u: Any, y: Any) -> "StateSpaceModel":
        """Exchange the functions of dynamics, sensor and cross-covariance; see `Model`."""
        x, t = jax.ShapeDtypeStruct((self.size,), self.dtype), jax.ShapeDtypeStruct((), jnp.int32)
        return exchanged(self, {
            "dynamics": wrap.conditional("dynamics", self.dynamics, x, u, x),
            "sensor": wrap.conditional("sensor", self.sensor, x, u, y),
            "noise_cross_cov": wrap.function(self.noise_cross_cov, (x, u, t), "noise_cross_cov(x, u, t)"),
        })

    def independent(self) -> tuple["StateSpaceModel", Drive]:
        """Return the model with independent noises, and what makes its inputs; see `Model`."""
        if self.noise_cross_cov is None:
            return self, Drive()
        dynamics, sensor = decorrelated(self.dynamics, self.sensor, self.noise_cross_cov)  # type: ignore[arg-type]
        return replace(self, dynamics=dynamics, sensor=sensor, noise_cross_cov=None), Drive(correlated=True)


def _predicted(part: Any, x: Any, u: Any, t: Any) -> tuple[int, ...]:
    """Shape of what the function of a conditional returns."""
    of_f = part.mean if isinstance(part, AdditiveGaussian) else part.f
    return jax.eval_shape(lambda x, u, t: jnp.asarray(of_f(x, u, t)), x, u, t).shape


def as_state_space(asked_by: str, model: Any) -> StateSpaceModel:
    """Return a model as a state-space model with the same states.

    Args:
        asked_by: who asks, for the message.
        model: a model of any kind.

    Raises:
        MotesError: the value is no model, or its modes would be one more state.
    """
    wanted = "a StateSpaceModel or a MixedLinearModel"
    found = checks.instance(f"{asked_by} model", model, Model, wanted).as_state_space()
    if found.size != model.size:
        hint = "Use InteractingMultipleModel or JumpMarkovFilter, or give model.as_state_space()."
        checks.refuse(f"{asked_by} model", wanted, type(model).__name__, hint)
    return found


def _check_moments(name: str, part: AdditiveGaussian, x: Any, u: Any, t: Any, expected: int | None) -> None:
    moments = jax.eval_shape(lambda part, x, u, t: (part.mean(x, u, t), part.cov(x, u, t)), part, x, u, t)
    mean, cov = (leaf.shape for leaf in moments)
    if len(mean) != 1 or (expected is not None and mean[0] != expected):
        wanted = f"({expected},)" if expected is not None else "(y,)"
        checks.refuse(f"{name} f(x, u, t)", f"a vector of shape {wanted}", f"shape {mean}")
    if cov != (mean[0], mean[0]):
        checks.refuse(f"{name} Q", f"shape {(mean[0], mean[0])} (the size of its f)", f"shape {cov}")
    if any(not -mean[0] <= a < mean[0] for a in part.angles):
        checks.refuse(f"{name} angles", f"indices of the {mean[0]} components", list(part.angles))


def _checked_cross_cov(value: MatrixLike, dynamics: Conditional, sensor: Conditional, size: int) -> MatrixLike:
    if not (isinstance(dynamics, AdditiveGaussian) and isinstance(sensor, AdditiveGaussian)):
        checks.refuse("noise_cross_cov", "dynamics and sensor with additive Gaussian noise",
                      f"{type(dynamics).__name__} and {type(sensor).__name__}")
    value = check_matrix("noise_cross_cov", value, (size, None))
    known = (value, dynamics.Q, sensor.Q)
    if not any(callable(v) for v in known) and checks.is_concrete(known):
        count = jnp.shape(sensor.Q)[0]  # type: ignore[arg-type]
        checks.shape("noise_cross_cov", value, (size, count), "(states, measurements)")
        joint = jnp.block([[dynamics.Q, value], [jnp.transpose(value), sensor.Q]])  # type: ignore[arg-type, list-item]
        checks.covariance("noise_cross_cov (with Q and R as one joint covariance)", joint, size + count)
    return value


def at_step(rows: Any, step: jax.Array | int) -> Any:
    """Return what belongs to one step, inputs or laws, of a tree with the time axis first."""
    return jax.tree.map(lambda leaf: leaf[step], rows)


def checked_inputs(inputs: Inputs, steps: int, like: str, argument: str = "inputs", names: tuple[str, ...] = ()) -> Inputs:
    """Return inputs as arrays of numbers; refuse those that do not have one row per step, or are not known in every row.

    Args:
        inputs: tree with the time axis first, or None.
        steps: number of steps.
        like: another argument that gives the number of steps.
        argument: name to use in the message.
        names: of the columns that are taken of a table; see `Model.input_names`.
    """
    if inputs is None:
        return None
    found = numbers_of(argument, tabular.by_columns(argument, inputs, names) if names else inputs, rows=True)
    lengths = {np.shape(leaf)[0] if np.ndim(leaf) else None for leaf in jax.tree.leaves(found)}
    if lengths - {steps}:
        like = like and f" as {like}"
        hint = "A list counts as a tree of numbers: write np.array(...) around it." if None in lengths else ""
        told = sorted(map(str, lengths))
        checks.refuse(argument, f"arrays with the time axis first, {steps} steps{like}", f"first axes {told}", hint)
    return found


def numbers_of(argument: str, inputs: Inputs, rows: bool = False) -> Inputs:
    """Return a tree of inputs with an array of numbers in each place; infinity is one (a variance that tells nothing), NaN is none.

    Args:
        argument: name to use in the message.
        inputs: tree of whatever `checks.as_numbers` takes, tables and series of other libraries among them, or None.
        rows: whether the time axis is first.

    Raises:
        MotesError: something is no number, or NaN, missing, minus infinity or too large for its type, as far as it is known; the message
            names place and row.
    """
    if inputs is None:
        return None
    leaves, structure = jax.tree.flatten(inputs)
    if all(map(_is_plain, leaves)):
        return structure.unflatten(leaf if isinstance(leaf, (bool, int, float)) else np.asarray(leaf) for leaf in leaves)

    def one(path: Any, leaf: Any) -> Any:
        name = argument + jax.tree_util.keystr(path)
        if isinstance(leaf, jax.Array) and not (checks.is_concrete(leaf) and jnp.issubdtype(leaf.dtype, jnp.floating)):
            return leaf
        array = leaf if isinstance(leaf, (bool, int, float)) else checks.as_numbers(name, tabular.plain(name, leaf))
        # an infinite variance says that nothing was measured
        wrong = checks.unknown(np.where(np.isposinf(array), 0, array) if jnp.issubdtype(np.asarray(array).dtype, jnp.floating) else array)
        if wrong is not None:
            place = f" in row {wrong[0]}" if rows and len(wrong) else ""
            hint = "Only measurements may be missing: fill it, or say by one more input where it holds."
            checks.refuse(name, "finite numbers", f"{np.asarray(array)[tuple(wrong)]:g}{place}", hint)
        return array

    return jax.tree_util.tree_map_with_path(one, tabular.by_name(inputs))


def _is_plain(leaf: Any) -> bool:
    """Tell numbers of Python and NumPy that are right in every type: a stream asks at each step, and paths to leaves take long."""
    if type(leaf) is np.ndarray or isinstance(leaf, np.generic):
        if leaf.dtype.kind != "f":
            return leaf.dtype.kind in "biu"
        return bool((abs(leaf.item()) if leaf.size == 1 else np.abs(leaf).max(initial=0)) <= LARGEST)
    return type(leaf) in (bool, int) or (type(leaf) is float and abs(leaf) <= LARGEST)
