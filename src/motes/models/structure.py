"""Structure discovery: which states enter a model linearly, and what their covariance depends on, read off the traced functions.

A set of states is conditionally linear-Gaussian when dynamics and sensor are jointly affine in it for any value of the other states, both
noises are Gaussian with covariances that do not depend on it, and the initial law is Gaussian. See `affinity.py` for the exact reasoning.
"""

from collections.abc import Iterator
from itertools import combinations
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from motes.core import checks, linalg
from motes.core.record import record, static
from motes.core.types import Inputs
from motes.laws.conditional import AdditiveGaussian, Conditional, Custom
from motes.laws.gaussian import Gaussian
from motes.models.affinity import dependence
from motes.models.mixed_linear import Affine, MixedLinearModel
from motes.models.state_space import Previous, StateSpaceModel, decorrelated, measurement_size

SHARED, TIME_VARYING, PER_PARTICLE = "shared", "time-varying", "per-particle"
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
        why = dict(self.reasons)
        width = max(5, *(len(name) for name in self.names))
        lines = [f"{'state':<{width + 2}}part      why"]
        for i, name in enumerate(self.names):
            part = "Kalman" if i in self.linear else "particle"
            lines.append(f"{name:<{width + 2}}{part:<10}{why.get(name, 'conditionally linear-Gaussian')}")
        return "\n".join([*lines, f"covariance of the Kalman part: {self.covariance}"])


class _Traced(NamedTuple):
    """Which variables (states, then inputs, then time) the pieces of a model use, and which pairs of them interact."""

    slope_pairs: dict[str, np.ndarray]
    noise_uses: dict[str, np.ndarray]
    direct: np.ndarray
    """States that the sensor uses."""
    closed: dict[int, str]
    """States that must be particles, with the reason."""


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
    if not isinstance(model, StateSpaceModel):
        checks.refuse("structure model", "a StateSpaceModel or a MixedLinearModel", type(model).__name__)
    if model.noise_cross_cov is not None:
        size = measurement_size(model, inputs) or 0
        return structure(decorrelated(model), Previous(inputs, inputs, jnp.zeros((size,), model.dtype)))
    traced = _trace(model, inputs)
    best = _largest(traced, model.size)
    return Structure(best, model.names, _covariance(traced, best, model.size), _reasons(traced, best, model.names))


def _trace(model: StateSpaceModel, inputs: Inputs) -> _Traced:
    size = model.size
    x = jax.ShapeDtypeStruct((size,), model.dtype)
    t = jax.ShapeDtypeStruct((), jnp.int32)
    kinds = ("fixed", "elements", "whole", "whole")
    slopes: dict[str, np.ndarray] = {}
    noises: dict[str, np.ndarray] = {}
    closed: dict[int, str] = {}
    direct = np.zeros(size, bool)
    for name, part in (("dynamics", model.dynamics), ("sensor", model.sensor)):
        if isinstance(part, AdditiveGaussian):
            mean = dependence(lambda part, x, u, t: part.mean(x, u, t), (part, x, inputs, t), kinds)
            cov = dependence(lambda part, x, u, t: part.cov(x, u, t), (part, x, inputs, t), kinds)
            slopes[name], noises[name] = mean.pairs, cov.uses.reshape(-1, size + 2).any(axis=0)
            used = mean.uses.any(axis=0)[:size]
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
    return _Traced(slopes, noises, direct, closed)


def _states_in_density(part: Conditional, x: Any, u: Any, t: Any) -> np.ndarray:
    """States that a density which is not Gaussian looks at."""
    if isinstance(part, Custom) and part.density is None:
        return np.ones(x.shape[0], bool)
    if hasattr(part, "f"):
        found = dependence(lambda part, x, u, t: part.f(x, u, t), (part, x, u, t), ("fixed", "elements", "whole", "whole"))
        return found.uses.reshape(-1, x.shape[0] + 2).any(axis=0)[: x.shape[0]]
    return np.ones(x.shape[0], bool)


def _joint(traced: _Traced, size: int) -> np.ndarray:
    """Pairs of states `(x, x)` that are not jointly affine in some function."""
    pairs = np.zeros((size, size), bool)
    for found in traced.slope_pairs.values():
        pairs |= found[:, :size, :size].any(axis=0)
    return pairs


def _largest(traced: _Traced, size: int) -> tuple[int, ...]:
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


def _varying(traced: _Traced, chosen: tuple[int, ...], size: int) -> dict[str, np.ndarray]:
    """For slope and noise of dynamics and sensor: which variables they depend on once `chosen` is marginalized."""
    found = {f"{name} slope": pairs[:, list(chosen)].reshape(-1, size + 2).any(axis=0) for name, pairs in traced.slope_pairs.items()}
    found |= {f"{name} noise": uses for name, uses in traced.noise_uses.items()}
    if not traced.direct[list(chosen)].any():
        # a sensor that does not see the Kalman part leaves its covariance alone
        found = {name: uses for name, uses in found.items() if not name.startswith("sensor")}
    return found


def _covariance(traced: _Traced, chosen: tuple[int, ...], size: int) -> str:
    uses = np.any([np.zeros(size + 2, bool), *_varying(traced, chosen, size).values()], axis=0)
    if uses[:size].any():
        return PER_PARTICLE
    return TIME_VARYING if uses[size:].any() else SHARED


def _reasons(traced: _Traced, chosen: tuple[int, ...], names: tuple[str, ...]) -> tuple[tuple[str, str], ...]:
    size = len(names)
    reasons = {}
    for i in set(range(size)) - set(chosen):
        reasons[names[i]] = traced.closed.get(i) or _clash(traced, (*chosen, i), names)
    return tuple(sorted(reasons.items(), key=lambda item: names.index(item[0])))


def _clash(traced: _Traced, chosen: tuple[int, ...], names: tuple[str, ...]) -> str:
    """Name the function and the first pair of the chosen states in which it is not jointly affine; empty when there is none."""
    for function, pairs in traced.slope_pairs.items():
        found = pairs[:, : len(names), : len(names)].any(axis=0)
        for i, j in combinations(sorted(chosen), 2):
            if found[i, j]:
                return f"{function} is not jointly linear in {names[i]} and {names[j]}"
    return ""


@record
class SplitModel:
    """A mixed linear model made ready for a cloud: each matrix is evaluated once, or once per particle, as its dependence asks.

    Attributes:
        mixed: the model.
        varies: which matrices depend on the particle: of "particle", "kalman", "sensor", "cross_cov", slope (1) or noise (2).
        per_particle: whether the covariance of the Kalman part does.
        likelihood: the sensor itself where it does not see the Kalman part, else None.
    """

    mixed: MixedLinearModel
    likelihood: Conditional | None
    varies: tuple[tuple[str, int], ...] = static()
    per_particle: bool = static()

    @property
    def measures_linear(self) -> bool:
        """Whether the sensor sees the Kalman part."""
        return self.likelihood is None

    def whole(self, X_p: jax.Array) -> jax.Array:
        """Full states `(x, n)` with zeros for the Kalman part, for a sensor that does not see it."""
        zeros = jnp.zeros((len(self.mixed.linear), X_p.shape[-1]), X_p.dtype)
        return jnp.concatenate([X_p, zeros])[jnp.asarray(self.mixed.order)]

    def over(self, part: str, X_p: jax.Array, u: Any, t: Any) -> Affine:
        """Evaluate one of "particle", "kalman", "sensor" over the cloud: f `(z, n)`, A and Q with or without the particle axis."""
        function = getattr(self.mixed, part)

        def evaluate(x_p: jax.Array) -> Affine:
            return Affine(*(jnp.asarray(value).astype(x_p.dtype) for value in function(x_p, u, t)))

        one = evaluate(X_p[:, 0])
        many = jax.vmap(evaluate, in_axes=-1, out_axes=-1)(X_p)
        return Affine(many.f, *(many[i] if (part, i) in self.varies else one[i] for i in (1, 2)))

    def cross_cov(self, X_p: jax.Array, u: Any, t: Any) -> jax.Array | None:
        """Covariance `(p, k, *n)` of the two process noises, or None when they are independent."""
        function = self.mixed.cross_cov
        if function is None:
            return None
        if ("cross_cov", 2) not in self.varies:
            return function(X_p[:, 0], u, t)
        return jax.vmap(lambda x_p: function(x_p, u, t), in_axes=-1, out_axes=-1)(X_p)


def split(model: Any, linear: tuple[str | int, ...] | None, inputs: Inputs) -> SplitModel:
    """Split a model into particle and Kalman parts.

    Args:
        model: state-space model, mixed linear model, or a split one (returned as it is).
        linear: states for the Kalman part by name or index; None for the largest possible set.
        inputs: example of the inputs of one step.

    Raises:
        MotesError: the states are not conditionally linear-Gaussian; the message names the function and the states.
    """
    if isinstance(model, SplitModel):
        return model
    if isinstance(model, MixedLinearModel):
        if linear is not None and set(linear) - set(model.linear) - {model.names[i] for i in model.linear}:
            return split(model.joined(), linear, inputs)
        varies = _mixed_varies(model, inputs)
        return SplitModel(model, None, varies, bool(varies))
    if not isinstance(model, StateSpaceModel):
        checks.refuse("MarginalizedParticleFilter model", "a StateSpaceModel or a MixedLinearModel", type(model).__name__)
    traced = _trace(model, inputs)
    chosen = _largest(traced, model.size) if linear is None else _asked_for(traced, model, linear)
    varying = {name for name, uses in _varying(traced, chosen, model.size).items() if uses[: model.size].any()}
    varies = [(part, i) for part in ("particle", "kalman") for i, what in ((1, "slope"), (2, "noise")) if f"dynamics {what}" in varying]
    varies += [("sensor", i) for i, what in ((1, "slope"), (2, "noise")) if f"sensor {what}" in varying]
    varies += [("cross_cov", 2)] if "dynamics noise" in varying else []
    sees = bool(traced.direct[list(chosen)].any())
    return SplitModel(_mixed(model, chosen), None if sees else model.sensor, tuple(varies), bool(varies))


def _asked_for(traced: _Traced, model: StateSpaceModel, linear: tuple[str | int, ...]) -> tuple[int, ...]:
    chosen = tuple(sorted({model.index(state) for state in linear}))
    for i in chosen:
        if i in traced.closed:
            checks.refuse("linear", "states that are conditionally linear-Gaussian", f"{model.names[i]}: {traced.closed[i]}",
                          "mo.structure(model) lists what is possible.")
    clash = _clash(traced, chosen, model.names)
    if clash:
        checks.refuse("linear", "states in which the model is jointly linear", clash, "Take one of them out.")
    return chosen


def _mixed(model: StateSpaceModel, linear: tuple[int, ...]) -> MixedLinearModel:
    """Build the mixed linear model; slopes are Jacobians, exact because the functions are affine in the chosen states."""
    own = np.array([i for i in range(model.size) if i not in linear], int)
    other = np.array(linear, int)

    def evaluate(part: AdditiveGaussian, x_p: jax.Array, u: Any, t: Any) -> Affine:
        def mean(x_k: jax.Array) -> jax.Array:
            x = jnp.zeros((model.size,), x_p.dtype).at[own].set(x_p).at[other].set(x_k)
            return part.mean(x, u, t)

        nothing = jnp.zeros((len(linear),), x_p.dtype)
        x = jnp.zeros((model.size,), x_p.dtype).at[own].set(x_p)
        return Affine(mean(nothing), jax.jacfwd(mean)(nothing), part.cov(x, u, t))

    def rows(part: Any, keep: np.ndarray, x_p: jax.Array, u: Any, t: Any) -> Affine:
        f, A, Q = evaluate(part, x_p, u, t)
        return Affine(f[keep], A[keep], Q[keep][:, keep])

    dynamics, sensor = model.dynamics, model.sensor
    initial_p, initial_k, gain = _initial_parts(model, own, other)
    return MixedLinearModel(
        initial_p,
        initial_k,
        particle=lambda x_p, u, t: rows(dynamics, own, x_p, u, t),
        kalman=lambda x_p, u, t: rows(dynamics, other, x_p, u, t),
        sensor=lambda x_p, u, t: evaluate(sensor, x_p, u, t),  # type: ignore[arg-type]
        cross_cov=(lambda x_p, u, t: evaluate(dynamics, x_p, u, t).Q[own][:, other]) if len(own) and len(other) else None,  # type: ignore[arg-type]
        initial_gain=gain,
        angles=sensor.angles,
        linear=linear,
        names=model.names,
    )


def _initial_parts(model: StateSpaceModel, own: np.ndarray, other: np.ndarray) -> tuple[Any, Gaussian, jax.Array | None]:
    if not len(other):
        return model.initial, Gaussian(jnp.zeros((0,), model.dtype), jnp.zeros((0, 0), model.dtype)), None
    center, cov = model.initial.mean(), model.initial.cov()
    P_p, P_kp = cov[own][:, own], cov[other][:, own]
    gain = linalg.solve(linalg.cholesky(P_p), P_kp.T).T
    rest = linalg.symmetric(cov[other][:, other] - gain @ P_kp.T)
    return Gaussian(center[own], P_p), Gaussian(center[other], rest), gain


def _mixed_uses(model: MixedLinearModel, inputs: Inputs) -> dict[tuple[str, int], np.ndarray]:
    """Which variables (x_p, inputs, time) each matrix of a mixed linear model depends on."""
    p = model.sizes[0]
    args = (model, jax.ShapeDtypeStruct((p,), model.dtype), inputs, jax.ShapeDtypeStruct((), jnp.int32))

    def matrices(model: MixedLinearModel, x_p: jax.Array, u: Any, t: Any) -> dict[str, list[Any]]:
        found = {part: list(getattr(model, part)(x_p, u, t))[1:] for part in ("particle", "kalman", "sensor")}
        return found if model.cross_cov is None else found | {"cross_cov": [jnp.zeros(()), model.cross_cov(x_p, u, t)]}

    found = dependence(matrices, args, ("fixed", "elements", "whole", "whole"))
    return {(part, i + 1): both[i].uses.reshape(-1, p + 2).any(axis=0) for part, both in found.items() for i in (0, 1)}


def _mixed_varies(model: MixedLinearModel, inputs: Inputs) -> tuple[tuple[str, int], ...]:
    return tuple(name for name, uses in _mixed_uses(model, inputs).items() if uses[:-2].any())


def _mixed_covariance(model: MixedLinearModel, inputs: Inputs) -> str:
    uses = np.any(list(_mixed_uses(model, inputs).values()), axis=0)
    return PER_PARTICLE if uses[:-2].any() else TIME_VARYING if uses[-2:].any() else SHARED
