"""Sensors without noise in some component: refused to filters that draw particles and then weigh them, none of which ever fits."""

from collections.abc import Callable
from functools import lru_cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from motes.core import checks, random
from motes.core.record import replace
from motes.filters.clouds import weigh_by_likelihood
from motes.filters.info import Info
from motes.filters.look_ahead import propose_and_weigh
from motes.filters.proposals import OptimalProposal, Proposal
from motes.laws.cloud import Cloud
from motes.laws.conditional import AdditiveGaussian, AdditiveNoise, Conditional
from motes.laws.density import noiseless
from motes.laws.gaussian import Gaussian
from motes.laws.mixture import Mixture
from motes.laws.switching import SwitchingSensor
from motes.models.interface import Model
from motes.models.state_space import StateSpaceModel

CURE = ("Give it a little noise, or use a proposal (OptimalProposal) or a filter that conditions on it exactly (KalmanFilter, or "
        "MarginalizedParticleFilter with what is measured in its Kalman part).")  # fmt: skip


def ask_noise(asked_by: str, model: Model, weighs: Callable[[], bool] = lambda: True) -> None:
    """Refuse a sensor whose noise is known to leave out some component.

    Args:
        asked_by: the filter, for the message.
        model: the user's model.
        weighs: tells whether the filter weighs by the sensor's density alone; asked where there is such a component.

    Raises:
        MotesError: the message names the component and the cure.
    """
    for part in model.each_mode():
        component = None if part.correlated else _without(part.sensor)
        if component is not None and weighs():
            checks.refuse(f"{asked_by} sensor", "noise in every component (particles are weighed by its density)",
                          f"none of its own in component {component}", CURE)


def ask_full_noise(asked_by: str, model: Any) -> None:
    """Refuse dynamics whose noise is known to have some directions and to miss others.

    Raises:
        MotesError: the message names the state.
    """
    dynamics = getattr(model, "dynamics", None)
    cov = _known(dynamics) if isinstance(dynamics, Conditional) else None
    for dead in [] if cov is None else _dead_of(cov):
        if 0 < len(dead) < model.size:
            hint = "Use a ParticleFilter, or a Kalman filter where the model is linear."
            checks.refuse(f"{asked_by} dynamics", "noise in every direction (or in none, and no motion)",
                          f"none of its own in {model.names[dead[0]]}", hint)


def _known(part: Conditional) -> Any:
    """Return the covariance of a Gaussian noise, `(z, z)` or that of n mixed ones, `(z, z, n)`; None where it is not known now."""
    law = part.law if isinstance(part, AdditiveNoise) else None
    law = law.parts if isinstance(law, Mixture) else law
    cov = part.Q if isinstance(part, AdditiveGaussian) else law.covariance if isinstance(law, Gaussian) else None
    return None if cov is None or callable(cov) or not checks.is_concrete(cov) else cov


def _without(sensor: Conditional) -> int | None:
    """Return the first component that has no noise of its own, as far as numbers are known."""
    if isinstance(sensor, SwitchingSensor):
        return next((found for found in map(_without, sensor.parts) if found is not None), None)
    cov = _known(sensor)
    return None if cov is None else min((j for dead in _dead_of(cov) for j in dead), default=None)


def _dead_of(cov: Any) -> list[tuple[int, ...]]:
    """Return what `_dead` finds in one known covariance, or in each of n `(z, z, n)`."""
    size, eps = cov.shape[0], float(jnp.finfo(jnp.result_type(cov)).eps)
    matrices = np.asarray(cov, np.float64).reshape(size, size, -1)
    return [_dead(each.tobytes(), size, eps) for each in np.moveaxis(matrices, -1, 0)]


@lru_cache
def _dead(numbers: bytes, size: int, eps: float) -> tuple[int, ...]:
    """Components that those before say all of, as `linalg.cholesky` finds them; remembered, since each run asks."""
    cov = np.frombuffer(numbers).reshape(size, size)
    rest, found = cov.copy(), []
    for j in range(size):
        if rest[j, j] > 4 * size * eps * cov[j, j]:
            rest -= np.outer(rest[:, j], rest[j]) / rest[j, j]
        else:
            found.append(j)
    return tuple(found)


def conditions_exactly(proposal: Proposal, model: Any) -> bool:
    """Tell whether a proposal takes in a measurement without noise, the first one included."""
    return isinstance(proposal, OptimalProposal) and isinstance(getattr(model, "initial", None), Gaussian)


def weigh_or_redraw(
    key: jax.Array, proposal: Proposal, model: StateSpaceModel, state: Cloud, y: jax.Array, u: Any, t: Any
) -> tuple[Cloud, Info]:
    """Weigh particles by the likelihood of y; where it has no noise in some component, draw those of step 0 anew given y.

    The first state is then moved by the proposal as from the mean of the initial law, with its covariance for noise.
    """

    def weighed() -> tuple[Cloud, Info]:
        return weigh_by_likelihood(key, model.sensor, state, y, u, t)

    if not conditions_exactly(proposal, model):
        return weighed()
    mean, cov = model.initial.mean(), model.initial.cov()
    from_mean = replace(model, dynamics=AdditiveGaussian(lambda x, u, t: mean, cov))
    sharp = jnp.any(noiseless(model.sensor.cov(mean, u, t)))
    noise_key = random.child(key, random.NOISE)
    return jax.lax.cond(sharp & (t == 0), lambda: propose_and_weigh(noise_key, proposal, from_mean, state, y, u, t), weighed)
