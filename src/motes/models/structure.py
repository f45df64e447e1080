"""Structure discovery: which states enter a model linearly, and what their covariance depends on, read off the traced functions.

A set of states is conditionally linear-Gaussian when dynamics and sensor are jointly affine in it for any value of the other states, both
noises are Gaussian with covariances that do not depend on it, and the initial law is Gaussian. See `affinity.py` for the exact reasoning.
"""

from collections.abc import Callable, Iterator
from itertools import combinations
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from motes.core import markdown
from motes.core.record import record, replace, static
from motes.core.types import Inputs
from motes.laws.cluttered import Cluttered
from motes.laws.conditional import AdditiveGaussian, AdditiveNoise, Conditional
from motes.laws.custom import Custom
from motes.laws.gaussian import Gaussian
from motes.laws.independent import Together
from motes.laws.observed import value_of
from motes.laws.several_targets import SeveralTargets
from motes.models.canonical import canonical
from motes.models.mixed_linear import MixedLinearModel
from motes.models.state_space import StateSpaceModel, as_state_space
from motes.tracing.affinity import dependence

SHARED, TIME_VARYING, PER_PARTICLE = "shared", "time-varying", "per-particle"
_LARGE = 100_000
"""A density of more numbers than that is not traced: its states are to be named."""
_EXHAUSTIVE = 18
"""Up to this many candidate states every subset is tried; beyond, the set grows greedily."""


@record
class Structure:
    """What tracing found.

    Attributes:
        linear: indices of the largest set of states that is conditionally linear-Gaussian.
        names: names of all states.
        covariance: what the covariance of that set depends on: "shared" (on nothing that varies), "time-varying" (on time or inputs) or
            "per-particle" (on the other states).
        reasons: for each other state, why it cannot join.
    """

    linear: tuple[int, ...] = static()
    names: tuple[str, ...] = static()
    covariance: str = static()
    reasons: tuple[tuple[str, str], ...] = static()

    def __str__(self) -> str:
        """Print as a table."""
        width = max(5, *(len(name) for name in self.names))
        lines = [f"{name:<{width + 2}}{part:<10}{why}" for name, part, why in [("state", "part", "why"), *self._rows()]]
        return "\n".join([*lines, f"covariance of the Kalman part: {self.covariance}"])

    def _rows(self) -> list[tuple[str, str, str]]:
        why = dict(self.reasons)
        return [(name, "Kalman" if i in self.linear else "particle", why.get(name, "conditionally linear-Gaussian"))
                for i, name in enumerate(self.names)]  # fmt: skip

    def _repr_markdown_(self) -> str:
        return f"{markdown.table(('state', 'part', 'why'), self._rows())}\ncovariance of the Kalman part: {self.covariance}\n"


class Traced(NamedTuple):
    """Which of the m variables (x states, then inputs, then time) the pieces of a model use, and which pairs of them interact.

    Attributes:
        slope_pairs: for dynamics and sensor with additive Gaussian noise, the interacting pairs of the mean, `(z, m, m)`.
        noise_uses: for the same, the variables that the noise covariance uses, `(m,)`.
        direct: states that the sensor uses, `(x,)`.
        moved_by: for each state, the states that the mean of its dynamics uses, `(x, x)`.
        closed: states that must be particles, with the reason.
    """

    slope_pairs: dict[str, np.ndarray]
    noise_uses: dict[str, np.ndarray]
    direct: np.ndarray
    moved_by: np.ndarray
    closed: dict[int, str]


def structure(model: StateSpaceModel, inputs: Inputs = None) -> Structure:
    """Find the largest set of states that a Kalman filter can carry.

    Args:
        model: the model; its functions are traced, not run.
        inputs: an example of the inputs of one step, where the functions use them.

    Raises:
        MotesError: the model is of another kind.
    """
    if isinstance(model, MixedLinearModel):
        return Structure(model.linear, model.names, _mixed_covariance(model, inputs), ())
    model = as_state_space("structure", model)
    if model.correlated:
        nothing = jnp.zeros((model.measurement_size(inputs) or 0,), model.dtype)
        model, drive = model.independent()
        inputs = drive.of(inputs, inputs, nothing)
    traced = trace(canonical(looked_at(model, inputs, _as_drawn(model, inputs)), inputs), inputs)
    best = largest(traced, model.size)
    return Structure(best, model.names, _covariance(traced, best, model.size), _reasons(traced, best, model.names))


def trace(model: StateSpaceModel, inputs: Inputs) -> Traced:
    """Trace dynamics and sensor of a model and note what their means and noises use."""
    size = model.size
    x = jax.ShapeDtypeStruct((size,), model.dtype)
    t = jax.ShapeDtypeStruct((), jnp.int32)
    kinds = ("fixed", "elements", "whole", "whole")
    slopes: dict[str, np.ndarray] = {}
    noises: dict[str, np.ndarray] = {}
    closed: dict[int, str] = {}
    direct, moved_by = np.zeros(size, bool), np.ones((size, size), bool)
    for name, part in (("dynamics", model.dynamics), ("sensor", model.sensor)):
        if isinstance(part, AdditiveGaussian):
            mean = dependence(lambda part, x, u, t: part.mean(x, u, t), (part, x, inputs, t), kinds)
            cov = dependence(lambda part, x, u, t: part.cov(x, u, t), (part, x, inputs, t), kinds)
            slopes[name], noises[name] = mean.pairs, cov.uses.reshape(-1, size + 2).any(axis=0)
            used = mean.uses.any(axis=0)[:size]
            moved_by = mean.uses[:, :size] if name == "dynamics" else moved_by
        else:
            used = np.ones(size, bool) if name == "dynamics" else _states_in_density(part, x, inputs, t)
            closed |= {int(i): f"{name} has noise that is not additive Gaussian" for i in np.flatnonzero(used)}
        if name == "sensor":
            direct = used
    if not isinstance(model.initial, Gaussian):
        closed |= {i: "the initial law is not Gaussian" for i in range(size)}
    for name, uses in noises.items():
        closed |= {int(i): f"the noise covariance of {name} depends on it" for i in np.flatnonzero(uses[:size])}
    for name, pairs in slopes.items():
        own = np.einsum("zii->i", pairs[:, :size, :size])
        closed |= {int(i): f"{name} is nonlinear in it" for i in np.flatnonzero(own)}
    return Traced(slopes, noises, direct, moved_by, closed)


def _states_in_density(part: Conditional, x: Any, u: Any, t: Any) -> np.ndarray:
    """States that a density which is not Gaussian looks at."""
    if isinstance(part, Custom) and (part.states is not None or part.looks is not None):
        seen = np.zeros(x.shape[0], bool)
        seen[list(part.looks if part.states is None else part.states)] = True  # type: ignore[arg-type]
        return seen
    if isinstance(part, Together):
        return _some([_states_in_density(each, x, u, t) for each in part.parts])
    if isinstance(part, SeveralTargets):
        marks = np.zeros(x.shape[0], bool)
        for own in part.indices:
            marks[list(own)] |= _states_in_density(part.one, jax.ShapeDtypeStruct((len(own),), x.dtype), u, t)
        return marks
    if isinstance(part, Cluttered):
        seen = _states_in_density(part.sensor, x, u, t)
        return seen | _states_used(lambda part, x, u, t: part.detected(x, u, t), part, x, u, t)
    if isinstance(part, AdditiveGaussian):
        return _states_used(lambda part, x, u, t: jnp.concatenate([part.mean(x, u, t), part.cov(x, u, t).ravel()]), part, x, u, t)
    if isinstance(part, AdditiveNoise):
        return _states_used(lambda part, x, u, t: part.f(x, u, t), part, x, u, t)
    return np.ones(x.shape[0], bool)


def _states_used(function: Callable[..., Any], part: Conditional, x: Any, u: Any, t: Any) -> np.ndarray:
    """States `(x,)` that a function of a conditional, a state, the inputs and the time uses."""
    found = dependence(function, (part, x, u, t), ("fixed", "elements", "whole", "whole"))
    return found.uses.reshape(-1, x.shape[0] + 2).any(axis=0)[: x.shape[0]]


def looked_at(model: Any, inputs: Inputs, y: Any) -> Any:
    """Return a model whose sensor says at which states its density looks, as tracing finds once the form of a measurement is known.

    Args:
        model: a model in any form; others than state-space models with a `Custom` sensor come back as they are.
        inputs: of one step, as the model's functions take them.
        y: one measurement, or its shapes; None where they are not known.
    """
    sensor = getattr(model, "sensor", None)
    if y is None or not isinstance(model, StateSpaceModel) or not isinstance(sensor, Custom):
        return model
    if sensor.states is not None or sensor.density is None:
        return model
    x, t = jax.ShapeDtypeStruct((model.size,), model.dtype), jax.ShapeDtypeStruct((), jnp.int32)
    digest, own = sensor.digest, sensor.density
    value = value_of(y) if digest is None else jax.eval_shape(lambda *args: digest(*args), value_of(y), inputs, t)
    if sum(leaf.size for leaf in jax.tree.leaves(value)) > _LARGE:
        return model
    density = lambda v, x, u, t: own(v, x[:, None] if sensor.batched else x, u, t)  # noqa: E731
    found = dependence(density, (value, x, inputs, t), ("fixed", "elements", "whole", "whole"))
    used = found.uses.reshape(-1, model.size + 2).any(axis=0)[: model.size]
    return model if used.all() else replace(model, sensor=replace(sensor, looks=tuple(np.flatnonzero(used).tolist())))


def _as_drawn(model: StateSpaceModel, inputs: Inputs) -> Any:
    """Return the shapes of a measurement, as a sensor of the user's own draws it; None where it does not."""
    sensor = model.sensor
    if not isinstance(sensor, Custom) or sensor.sampler is None:
        return None
    X = jax.ShapeDtypeStruct((model.size, 1), model.dtype)
    y = jax.eval_shape(sensor.sample, jax.random.key(0), X, inputs, jax.ShapeDtypeStruct((), jnp.int32))
    return jax.tree.map(lambda leaf: jax.ShapeDtypeStruct(leaf.shape[:-1], leaf.dtype), y)


def _some(marks: Any) -> np.ndarray:
    """Tell, along the first axis, whether any mark is set."""
    return np.logical_or.reduce(marks, axis=0)


def _joint(traced: Traced, size: int) -> np.ndarray:
    """Pairs of states `(x, x)` that are not jointly affine in some function."""
    pairs = np.zeros((size, size), bool)
    for found in traced.slope_pairs.values():
        pairs |= found[:, :size, :size].any(axis=0)
    return pairs


def largest(traced: Traced, size: int) -> tuple[int, ...]:
    """Return the largest set that fits; of several, the one with the cheapest covariance recursion, then the first."""
    pairs = _joint(traced, size)
    free = [i for i in range(size) if i not in traced.closed]

    def fits(chosen: tuple[int, ...]) -> bool:
        return not pairs[np.ix_(chosen, chosen)].any()

    if len(free) > _EXHAUSTIVE:
        grown: tuple[int, ...] = ()
        for i in sorted(free, key=lambda i: int(pairs[i, free].sum())):
            grown = (*grown, i) if fits((*grown, i)) else grown
        return tuple(sorted(grown))

    def candidates(count: int) -> Iterator[tuple[int, ...]]:
        return (chosen for chosen in combinations(free, count) if fits(chosen))

    rank = {SHARED: 0, TIME_VARYING: 1, PER_PARTICLE: 2}
    for count in range(len(free), 0, -1):
        found = list(candidates(count))
        if found:
            return min(found, key=lambda chosen: (rank[_covariance(traced, chosen, size)], chosen))
    return ()


def varying(traced: Traced, chosen: tuple[int, ...], size: int) -> dict[str, np.ndarray]:
    """For slope and noise of dynamics and sensor: which variables they depend on once `chosen` is marginalized."""
    found = {f"{name} slope": _some(pairs[:, list(chosen)].reshape(-1, size + 2)) for name, pairs in traced.slope_pairs.items()}
    found |= {f"{name} noise": uses for name, uses in traced.noise_uses.items()}
    if not traced.direct[list(chosen)].any():
        # a sensor that does not see the Kalman part leaves its covariance alone
        found = {name: uses for name, uses in found.items() if not name.startswith("sensor")}
    return found


def _covariance(traced: Traced, chosen: tuple[int, ...], size: int) -> str:
    uses = _some([np.zeros(size + 2, bool), *varying(traced, chosen, size).values()])
    if uses[:size].any():
        return PER_PARTICLE
    return TIME_VARYING if uses[size:].any() else SHARED


def _reasons(traced: Traced, chosen: tuple[int, ...], names: tuple[str, ...]) -> tuple[tuple[str, str], ...]:
    size = len(names)
    reasons = {}
    for i in set(range(size)) - set(chosen):
        reasons[names[i]] = traced.closed.get(i) or clash(traced, (*chosen, i), names)
    return tuple(sorted(reasons.items(), key=lambda item: names.index(item[0])))


def clash(traced: Traced, chosen: tuple[int, ...], names: tuple[str, ...]) -> str:
    """Name the function and the first pair of the chosen states in which it is not jointly affine; empty when there is none."""
    for function, pairs in traced.slope_pairs.items():
        found = _some(pairs[:, : len(names), : len(names)])
        for i, j in combinations(sorted(chosen), 2):
            if found[i, j]:
                return f"{function} is not jointly linear in {names[i]} and {names[j]}"
    return ""


def mixed_uses(model: MixedLinearModel, inputs: Inputs) -> dict[tuple[str, int], np.ndarray]:
    """Which variables (x_p, inputs, time) each matrix of a mixed linear model depends on."""
    p = model.sizes[0]
    args = (model, jax.ShapeDtypeStruct((p,), model.dtype), inputs, jax.ShapeDtypeStruct((), jnp.int32))

    def matrices(model: MixedLinearModel, x_p: jax.Array, u: Any, t: Any) -> dict[str, list[Any]]:
        found = {part: list(getattr(model, part)(x_p, u, t))[1:] for part in ("particle", "kalman", "sensor")}
        return found if model.cross_cov is None else found | {"cross_cov": [jnp.zeros(()), model.cross_cov(x_p, u, t)]}

    found = dependence(matrices, args, ("fixed", "elements", "whole", "whole"))
    return {(part, i + 1): both[i].uses.reshape(-1, p + 2).any(axis=0) for part, both in found.items() for i in (0, 1)}


def _mixed_covariance(model: MixedLinearModel, inputs: Inputs) -> str:
    uses = _some(list(mixed_uses(model, inputs).values()))
    return PER_PARTICLE if uses[:-2].any() else TIME_VARYING if uses[-2:].any() else SHARED
