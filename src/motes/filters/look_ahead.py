"""Filters that move only once they know the measurement: their step, and what methods with a proposal share.

1. Ahead: particles are resampled, moved and weighed knowing y.
2. Where y is not used, since nothing was measured, all weights vanished or it lies outside the gate, such particles are no sample of what
   was known before: the step is taken once more, blind, with the same keys and the dynamics alone.
"""

from abc import abstractmethod
from collections.abc import Callable
from typing import Any, ClassVar, NamedTuple

import jax

from motes.core import random
from motes.core.record import record, replace
from motes.filters import alarm
from motes.filters.alarm import Innovation
from motes.filters.info import Info, weigh
from motes.filters.interface import Filter
from motes.filters.proposals import Proposal
from motes.laws.cloud import Cloud
from motes.laws.law import LawT
from motes.laws.observed import is_nothing
from motes.models.state_space import StateSpaceModel
from motes.native import cloudwise


class Ahead(NamedTuple):
    """A step that knows the measurement.

    Attributes:
        after: the law given the measurement.
        info: record of the step.
        predicted: gives the law at the same time without the measurement.
    """

    after: Any
    info: Info
    predicted: Callable[[], Any]


@record
class LookAheadFilter(Filter[LawT]):
    """A filter that moves knowing the next measurement. Subclasses write `init`, `update` and `ahead`.

    One that does so by its parameters makes `look_ahead` a property, and derives from `TwoStageFilter` too, whose step is taken elsewhere.
    """

    look_ahead: ClassVar[bool] = True

    @abstractmethod
    def ahead(self, key: jax.Array, model: Any, state: Any, y: jax.Array, u: Any, t: Any) -> Ahead:
        """Go to the next time t knowing its measurement y `(y,)`, some or all of which may be NaN."""

    def step(self, key: jax.Array, model: Any, state: Any, y: jax.Array, u: Any, t: Any) -> tuple[Any, Info]:
        """Go to the next time t and take in its measurement."""
        if not self.look_ahead:
            return super().step(key, model, state, y, u, t)  # type: ignore[safe-super]
        after, info, predicted = self.ahead(key, model, state, y, u, t)  # step 1
        refused = info.collapsed | is_nothing(y)
        # 2. once more without y
        before = predicted() if self.gate is not None else jax.lax.cond(refused, predicted, lambda: after)
        return self.accept(before, after, info, y)


def keys_of(key: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Return the keys of a step for resampling and for the noise, those of `TwoStageFilter`."""
    predict_key = random.child(key, random.PREDICT)
    return random.child(predict_key, random.RESAMPLE), random.child(predict_key, random.NOISE)


def propose_and_weigh(
    key: jax.Array, proposal: Proposal, model: StateSpaceModel, parents: Cloud, y: jax.Array, u: Any, t: Any
) -> tuple[Cloud, Info]:
    """Move particles by a proposal that knows the measurement, and weigh them."""
    cloudwise.left_to_jax("move", parents, "particles are moved by a proposal")
    moved, log_weight, max_log_weight = proposal.proposed(key, model, parents.particles, y, u, t)
    weights, info = weigh(parents.log_weights, log_weight, max_log_weight)
    return replace(parents, particles=moved, log_weights=weights), info


def move_by_dynamics(key: jax.Array, model: StateSpaceModel, cloud: Cloud, u: Any, t: Any) -> Cloud:
    """Move particles by the dynamics, as if the measurement were not known."""
    return replace(cloud, particles=model.dynamics.sample(key, cloud.particles, u, t)).gathered(model.circular)


def predicted_innovation(key: jax.Array, model: StateSpaceModel, cloud: Cloud, y: jax.Array, u: Any, t: Any) -> Innovation:
    """Normalized innovation squared of y given some particles of the step before, moved as if it were not known."""
    some = alarm.some_of(cloud.log_weights.shape[0])
    X = model.dynamics.sample(random.child(key, random.NOISE), cloud.particles[:, some], u, t)
    return alarm.of_cloud(key, model.sensor, X, cloud.log_weights[some], y, u, t)
