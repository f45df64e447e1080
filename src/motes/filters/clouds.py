"""What filters do with clouds of weighted particles: resample and move them, update their weights; fused where the native engine can."""

from collections.abc import Callable
from typing import Any, TypeVar

import jax

from motes.core.record import replace
from motes.filters import alarm
from motes.filters.info import Info, info_of, weigh, with_innovation
from motes.gaussian.modes import expected, measured
from motes.gaussian.rule import Rule
from motes.laws.cloud import Cloud
from motes.laws.conditional import Conditional
from motes.laws.mode_mixture import ModeMixture
from motes.laws.observed import Observed
from motes.models.jump_markov import JumpMarkovModel
from motes.native import cloudwise
from motes.resampling import gradients
from motes.resampling.policy import Policy, resample
from motes.resampling.schemes import Scheme, Weighted

C = TypeVar("C", bound=Weighted)


def resample_and_move(keys: tuple[jax.Array, jax.Array], scheme: Scheme, policy: Policy, cloud: C, move: Callable[[jax.Array, C], C]) -> C:
    """Resample a cloud where the policy says so, then move it.

    Args:
        keys: for resampling, and for the noise.
        scheme: how ancestors are drawn.
        policy: when to resample.
        cloud: law of n weighted particles.
        move: from the key of the noise and the cloud to the moved cloud, each particle on its own.
    """
    moved = cloudwise.resample_and_move(keys, scheme, policy, cloud, move)
    if moved is None:
        return move(keys[1], resample(keys[0], scheme, policy, cloud))
    return gradients.noticed(moved) if gradients.loses(scheme, policy) else moved


def update_weights(cloud: C, likelihood_of: Callable[[C], tuple[C, jax.Array, jax.Array]]) -> tuple[C, Info]:
    """Correct a cloud and weigh its particles by a measurement.

    Args:
        cloud: law of n weighted particles.
        likelihood_of: gives the corrected cloud, the log likelihood of each particle `(n,)` and its maximum (see `weigh`), each on its own.
    """
    native = cloudwise.update_weights(cloud, likelihood_of)
    if native is not None:
        return native[0], info_of(native[1])
    after, log_likelihood, max_log_likelihood = likelihood_of(cloud)
    weights, info = weigh(cloud.log_weights, log_likelihood, max_log_likelihood)
    return replace(after, log_weights=weights), info


def weigh_by_likelihood(key: jax.Array, sensor: Conditional, cloud: Cloud, y: jax.Array, u: Any, t: Any) -> tuple[Cloud, Info]:
    """Weigh particles that stay where they are by the likelihood of y alone; the key serves the alarm."""

    def likelihood_of(cloud: Cloud) -> tuple[Cloud, jax.Array, jax.Array]:
        return cloud, sensor.log_prob(y, cloud.particles, u, t), sensor.max_log_prob(y, cloud.particles, u, t)

    after, info = update_weights(cloud, likelihood_of)
    n = cloud.log_weights.shape[0]
    some = alarm.some_of(n)
    return after, with_innovation(info, alarm.of_cloud(key, sensor, cloud.particles[:, some], cloud.log_weights[some], y, u, t, n))


def correct_modes(rule: Rule, model: JumpMarkovModel, state: ModeMixture, y: jax.Array, u: Any, t: Any) -> tuple[ModeMixture, Info]:
    """Correct the Gaussian of each component by the sensor of its mode, and weigh it by its predictive density of y."""
    done = measured(rule, model, state, y, u, t)
    weights, info = weigh(state.log_weights, done.log_evidence, done.max_log_evidence)
    after = replace(state, parts=done.law, log_weights=weights)
    if isinstance(y, Observed):
        return after, info
    few, log_weights = alarm.few_of(state.log_weights.reshape(model.count, -1))
    predicted = expected(rule, model, state, few, u, t)
    found = alarm.of_mixture(model.models[0].sensor.angles, predicted.center, predicted.covariance, log_weights.reshape(-1), y, drawn=False)
    return after, with_innovation(info, found)
