"""Skeleton of a filter: copy to src/motes/filters/, rename, and write the three methods. The contract suite runs this file as it is.

First lines of a real one: the method's name, the paper and its equations, the algorithm in three to six lines of words.
"""

from typing import Any

import jax

from motes.core import checks, random
from motes.core.record import record, replace, static
from motes.filters.clouds import resample_and_move, update_weights
from motes.filters.info import Info
from motes.filters.interface import Guide, TwoStageFilter
from motes.laws.cloud import Cloud
from motes.models.state_space import StateSpaceModel, as_state_space
from motes.resampling.policy import Always
from motes.resampling.schemes import Systematic


@record
class SkeletonFilter(TwoStageFilter):
    """A bootstrap filter in its shortest form; its state is a `Cloud`.

    Attributes:
        n: number of particles.
    """

    guide = Guide(
        needs="dynamics that can be drawn from, a sensor with a density",
        cost="n calls of each function",
        use="to start a filter of your own from",
    )
    n: int = static()

    def check_parameters(self) -> None:
        """Refuse values that a parameter cannot have."""
        checks.positive_integer("SkeletonFilter n", self.n)

    def prepare(self, model: Any, u: Any) -> StateSpaceModel:
        """Ask for what this filter needs of a model; say what to use instead where it is missing."""
        return as_state_space("SkeletonFilter", model)

    def init(self, key: jax.Array, model: StateSpaceModel) -> Cloud:
        """Return the law before the first measurement."""
        return Cloud.equal(model.initial.sample(key, self.n))

    def predict(self, key: jax.Array, model: StateSpaceModel, state: Cloud, u: Any, t: Any) -> Cloud:
        """Resample at the start, then move each particle to time t; noise is drawn as one block."""

        def move(noise_key: jax.Array, cloud: Cloud) -> Cloud:
            return replace(cloud, particles=model.dynamics.sample(noise_key, cloud.particles, u, t))

        return resample_and_move((random.child(key, random.RESAMPLE), random.child(key, random.NOISE)), Systematic(), Always(), state, move)

    def correct(self, key: jax.Array, model: StateSpaceModel, state: Cloud, y: jax.Array, u: Any, t: Any) -> tuple[Cloud, Info]:
        """Take in y; missing components, collapse and its policy are seen to by `update_weights` and the base class."""

        def likelihood_of(cloud: Cloud) -> tuple[Cloud, jax.Array, jax.Array]:
            return cloud, model.sensor.log_prob(y, cloud.particles, u, t), model.sensor.max_log_prob(y, cloud.particles, u, t)

        return update_weights(state, likelihood_of)
