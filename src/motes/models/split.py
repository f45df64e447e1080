"""Splitting a model into particle and Kalman parts, ready for a cloud."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from motes.core import checks, linalg
from motes.core.record import record, static
from motes.core.types import Inputs
from motes.laws.conditional import AdditiveGaussian, Conditional
from motes.laws.gaussian import Gaussian
from motes.models.mixed_linear import Affine, MixedLinearModel, user_order
from motes.models.state_space import StateSpaceModel, as_state_space
from motes.models.structure import Traced, clash, largest, mixed_uses, trace, varying


@record
class SplitModel:
    """A mixed linear model made ready for a cloud: each matrix is evaluated once, or once per particle, as its dependence asks.

    Attributes:
        mixed: the model.
        varies: which matrices depend on the particle: of "particle", "kalman", "sensor", "cross_cov", slope (1) or noise (2).
        per_particle: whether the covariance of the Kalman part does.
        drives: whether the Kalman part enters the dynamics of the particle part; if not, moving particles tell nothing of it.
        likelihood: the sensor itself where it does not see the Kalman part, else None.
    """

    mixed: MixedLinearModel
    likelihood: Conditional | None
    varies: tuple[tuple[str, int], ...] = static()
    per_particle: bool = static()
    drives: bool = static()

    @property
    def circular(self) -> tuple[int, ...]:
        """Indices of the states that are angles, in the user's order."""
        return self.mixed.circular

    @property
    def places(self) -> tuple[int, ...]:
        """Places in (x_p, x_k) of the states that are angles."""
        return tuple(self.mixed.order[a] for a in self.circular)

    def whole(self, X_p: jax.Array) -> jax.Array:
        """Full states `(x, n)` with zeros for the Kalman part, for a sensor that does not see it."""
        zeros = jnp.zeros((len(self.mixed.linear), X_p.shape[-1]), X_p.dtype)
        return linalg.take(jnp.concatenate([X_p, zeros]), self.mixed.order)

    def over(self, part: str, X_p: jax.Array, example: jax.Array, u: Any, t: Any) -> Affine:
        """Evaluate one of "particle", "kalman", "sensor" over the cloud: f `(z, n)`, A and Q with or without the particle axis.

        What does not depend on the particle is worked out at `example`, `(p,)`.
        """
        function = getattr(self.mixed, part)

        def evaluate(x_p: jax.Array) -> Affine:
            return Affine(*(jnp.asarray(value).astype(x_p.dtype) for value in function(x_p, u, t)))

        one = evaluate(example)
        many = jax.vmap(evaluate, in_axes=-1, out_axes=-1)(X_p)
        return Affine(many.f, *(many[i] if (part, i) in self.varies else one[i] for i in (1, 2)))

    def cross_cov(self, X_p: jax.Array, example: jax.Array, u: Any, t: Any) -> jax.Array | None:
        """Covariance `(p, k, *n)` of the two process noises, or None when they are independent; `example` as in `over`."""
        function = self.mixed.cross_cov
        if function is None:
            return None
        if ("cross_cov", 2) not in self.varies:
            return function(example, u, t)
        return jax.vmap(lambda x_p: function(x_p, u, t), in_axes=-1, out_axes=-1)(X_p)


def split(model: Any, linear: tuple[str | int, ...] | None, inputs: Inputs) -> SplitModel:
    """Split a model into particle and Kalman parts.

    Args:
        model: a model without modes.
        linear: states for the Kalman part by name or index; None for the largest possible set.
        inputs: example of the inputs of one step.

    Raises:
        MotesError: the states are not conditionally linear-Gaussian; the message names the function and the states.
    """
    if isinstance(model, MixedLinearModel):
        if linear is not None and {model.index(state) for state in linear} != set(model.linear):
            return split(model.as_state_space(), linear, inputs)
        varies = _mixed_varies(model, inputs)
        return SplitModel(model, None, varies, bool(varies), True)
    model = as_state_space("MarginalizedParticleFilter", model)
    traced = trace(model, inputs)
    chosen = largest(traced, model.size) if linear is None else _asked_for(traced, model, linear)
    moving = {name for name, uses in varying(traced, chosen, model.size).items() if uses[: model.size].any()}
    varies = [(part, i) for part in ("particle", "kalman") for i, what in ((1, "slope"), (2, "noise")) if f"dynamics {what}" in moving]
    varies += [("sensor", i) for i, what in ((1, "slope"), (2, "noise")) if f"sensor {what}" in moving]
    varies += [("cross_cov", 2)] if "dynamics noise" in moving else []
    sees = bool(traced.direct[list(chosen)].any())
    own = [i for i in range(model.size) if i not in chosen]
    drives = bool(traced.moved_by[np.ix_(own, chosen)].any())
    return SplitModel(_mixed(model, chosen), None if sees else model.sensor, tuple(varies), bool(varies), drives)


def _asked_for(traced: Traced, model: StateSpaceModel, linear: tuple[str | int, ...]) -> tuple[int, ...]:
    chosen = tuple(sorted({model.index(state) for state in linear}))
    for i in chosen:
        if i in traced.closed:
            checks.refuse("linear", "states that are conditionally linear-Gaussian", f"{model.names[i]}: {traced.closed[i]}",
                          "mo.structure(model) lists what is possible.")
    pair = clash(traced, chosen, model.names)
    if pair:
        checks.refuse("linear", "states in which the model is jointly linear", pair, "Take one of them out.")
    return chosen


def _mixed(model: StateSpaceModel, linear: tuple[int, ...]) -> MixedLinearModel:
    """Build the mixed linear model; slopes are Jacobians, exact because the functions are affine in the chosen states."""
    own = tuple(i for i in range(model.size) if i not in linear)
    other = linear
    order = user_order(linear, model.size)

    def evaluate(part: AdditiveGaussian, x_p: jax.Array, u: Any, t: Any) -> Affine:
        def mean(x_k: jax.Array) -> jax.Array:
            return part.mean(linalg.take(jnp.concatenate([x_p, x_k]), order), u, t)

        nothing = jnp.zeros((len(linear),), x_p.dtype)
        x = linalg.take(jnp.concatenate([x_p, nothing]), order)
        return Affine(mean(nothing), jax.jacfwd(mean)(nothing), part.cov(x, u, t))

    def rows(part: Any, keep: tuple[int, ...], x_p: jax.Array, u: Any, t: Any) -> Affine:
        f, A, Q = evaluate(part, x_p, u, t)
        return Affine(linalg.take(f, keep), linalg.take(A, keep), linalg.take(linalg.take(Q, keep), keep, axis=1))

    def cross_cov(x_p: jax.Array, u: Any, t: Any) -> jax.Array:
        return linalg.take(linalg.take(rows(dynamics, tuple(range(model.size)), x_p, u, t).Q, own), other, axis=1)

    dynamics, sensor = model.dynamics, model.sensor
    initial_p, initial_k, gain = _initial_parts(model, np.array(own, int), np.array(other, int))
    return MixedLinearModel(
        initial_p,
        initial_k,
        particle=lambda x_p, u, t: rows(dynamics, own, x_p, u, t),
        kalman=lambda x_p, u, t: rows(dynamics, other, x_p, u, t),
        sensor=lambda x_p, u, t: evaluate(sensor, x_p, u, t),  # type: ignore[arg-type]
        cross_cov=cross_cov if len(own) and len(other) else None,
        initial_gain=gain,
        angles=sensor.angles,
        linear=linear,
        names=model.names,
        circular=model.circular,
    )


def _initial_parts(model: StateSpaceModel, own: np.ndarray, other: np.ndarray) -> tuple[Any, Gaussian, jax.Array | None]:
    if not len(other):
        return model.initial, Gaussian(jnp.zeros((0,), model.dtype), jnp.zeros((0, 0), model.dtype)), None
    center, cov = model.initial.mean(), model.initial.cov()
    P_p, P_kp = cov[own][:, own], cov[other][:, own]
    gain = linalg.solve(linalg.cholesky(P_p), P_kp.T).T
    rest = linalg.symmetric(cov[other][:, other] - gain @ P_kp.T)
    return Gaussian(center[own], P_p), Gaussian(center[other], rest), gain


def _mixed_varies(model: MixedLinearModel, inputs: Inputs) -> tuple[tuple[str, int], ...]:
    return tuple(name for name, uses in mixed_uses(model, inputs).items() if uses[:-2].any())
