"""PaRIS, the particle-based rapid incremental smoother (Olsson, Westerborn 2017): smoothed sums over time, while the filter runs.

For S_t = h(x_0, x_1) + ... + h(x_{t-1}, x_t) each particle carries an estimate s_i of E[S_t | x_t = x_i, y_0 .. y_t].

1. Make a step of the particle filter: resample, move, weigh.
2. For each new particle x_i' draw k parents among the old ones, P(j) ~ w_j p(x_i' | x_j).
3. s_i <- mean over the k draws of s_j + h(x_j, x_i').

The weighted mean of s_i is E[S_t | y_0 .. y_t]. Two draws keep the variance from growing as that of a genealogy does; one does not.
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

from motes.core import checks, random, sums
from motes.core.record import record, static
from motes.filters.info import Info
from motes.filters.interface import Filter, Guide
from motes.filters.particle import ParticleFilter
from motes.filters.sharp import ask_noise
from motes.laws.cloud import Cloud
from motes.laws.law import Law
from motes.models.correlated import users
from motes.models.state_space import StateSpaceModel
from motes.resampling.policy import ESS, Policy
from motes.resampling.schemes import Scheme, Systematic
from motes.smoothers.interface import ask_backward_density
from motes.smoothers.parents import ExactParents, Move, Parents


@record
class AdditiveCloud(Law):
    """A cloud whose particles carry smoothed sums.

    Attributes:
        cloud: the filtered law.
        sums: expected sums given each particle, `(d, n)`.
    """

    weighted = True
    cloud: Cloud
    sums: jax.Array

    @property
    def log_weights(self) -> jax.Array:
        """Normalized, `(n,)`."""
        return self.cloud.log_weights

    def total(self) -> jax.Array:
        """Expected sums given all measurements so far, `(d,)`."""
        return sums.weighted_sum(self.sums, self.cloud.weights)

    def mean(self) -> jax.Array:
        """Mean of the state, `(x,)`."""
        return self.cloud.mean()

    def cov(self) -> jax.Array:
        """Covariance of the state, `(x, x)`."""
        return self.cloud.cov()

    def mode_probabilities(self, count: int = 0) -> jax.Array | None:
        """Probabilities of the modes, `(count,)`; see `Law`."""
        return self.cloud.mode_probabilities(count)

    def gathered(self, angles: tuple[int, ...]) -> "AdditiveCloud":
        """Return the law with particles on one branch of the states that are angles; the sums are the user's."""
        return AdditiveCloud(self.cloud.gathered(angles), self.sums)

    def sample(self, key: jax.Array, n: int) -> jax.Array:
        """Draw n states, `(x, n)`."""
        return self.cloud.sample(key, n)


@record
class PaRIS(Filter):
    """A particle filter that smooths sums on its way; its state is an `AdditiveCloud`, whose `total()` they are.

    Keep them of each step with `keep=lambda law: {"mean": law.mean(), "total": law.total()}`.

    Source: Olsson, Westerborn 2017, Efficient particle-based online smoothing in general hidden Markov models: the PaRIS algorithm.

    Example:
        >>> model = mo.textbook.growth()
        >>> xs, ys = mo.simulate(0, model, 50)
        >>> sums = mo.smoothers.PaRIS(n=200, function=lambda before, after, u, t: before * after, size=1)
        >>> mo.run(1, sums, model, ys).state.total().shape
        (1,)

    Attributes:
        n: number of particles.
        function: h, `(before, after, u, t)` of two states `(x,)`, inputs and index of the later step; gives what a move adds, `(d,)`.
        size: d.
        draws: k, parents drawn for each particle.
        parents: how they are drawn: `ExactParents()`, `RejectedParents()` or `SteppedParents()`.
        scheme: how ancestors are drawn.
        policy: when to resample, at the start of a step.
    """

    guide = Guide(
        needs="as ParticleFilter, and a density of the dynamics",
        cost="as ParticleFilter, and n^2 densities (fewer with `RejectedParents` or `SteppedParents`)",
        use="smoothed sums over time, such as those of expectation maximization, while the filter runs",
    )

    n: int = static()
    function: Callable[..., jax.Array] = static()
    size: int = static()
    draws: int = static(default=2)
    parents: Parents = ExactParents()
    scheme: Scheme = Systematic()
    policy: Policy = ESS(0.5)
    look_ahead = True

    def check_parameters(self) -> None:
        """Check the parameters.

        Raises:
            MotesError: a number is not a positive whole one, or function is none.
        """
        for name in ("n", "size", "draws"):
            checks.positive_integer(f"PaRIS {name}", getattr(self, name))
        if not callable(self.function):
            checks.refuse("PaRIS function", "a function (before, after, u, t) of two states", type(self.function).__name__)

    @property
    def _filter(self) -> ParticleFilter:
        return ParticleFilter(self.n, scheme=self.scheme, policy=self.policy, on_collapse=self.on_collapse)

    def prepare(self, model: Any, u: Any) -> StateSpaceModel:
        """Ask for dynamics that can be drawn from and have a density, and a sensor with a density.

        Raises:
            MotesError: one is missing.
        """
        model = self._filter.prepare(model, u)
        ask_backward_density("PaRIS", model)
        self.parents.check(model.dynamics)
        return model

    def ask(self, model: Any, u: Any) -> None:
        """Refuse a sensor without noise.

        Raises:
            MotesError: it has none in some component.
        """
        ask_noise(type(self).__name__, model)

    def init(self, key: jax.Array, model: StateSpaceModel) -> AdditiveCloud:
        """Draw n particles from the initial law; sums are zero."""
        cloud = self._filter.init(key, model)
        return AdditiveCloud(cloud, jnp.zeros((self.size, self.n), cloud.particles.dtype))

    def update(self, key: jax.Array, model: Any, state: AdditiveCloud, y: jax.Array, u: Any, t: Any) -> tuple[AdditiveCloud, Info]:
        """Take in the measurement y `(y,)` of the present time."""
        cloud, info = self._filter.update(key, model, state.cloud, y, u, t)
        return AdditiveCloud(cloud, state.sums), info

    def step(self, key: jax.Array, model: Any, state: AdditiveCloud, y: jax.Array, u: Any, t: Any) -> tuple[AdditiveCloud, Info]:
        """Go to the next time t, take in its measurement, and add what the move brings (steps 1 to 3)."""
        # 1. filter
        cloud, info = self._filter.step(key, model, state.cloud, y, u, t)
        # 2. parents
        after, ancestors = (jnp.concatenate([leaf] * self.draws, axis=-1) for leaf in (cloud.particles, cloud.ancestors))
        parents, known = self.parents.draw(random.child(key, random.MEASURE), state.cloud, Move(model.dynamics, u, t), after, ancestors)
        # 3. sums
        added_by = jax.vmap(lambda before, after: self._added(before, after, u, t), in_axes=-1, out_axes=-1)
        added = added_by(state.cloud.particles[:, parents], after)
        drawn_sums = jnp.where(known, state.sums[:, parents] + added, jnp.nan).reshape(self.size, self.draws, self.n)
        return AdditiveCloud(cloud, jnp.mean(drawn_sums, axis=1)), info

    def _added(self, before: jax.Array, after: jax.Array, u: Any, t: Any) -> jax.Array:
        added = jnp.asarray(self.function(before, after, users(u), t)).astype(after.dtype)
        checks.shape("PaRIS function", added, (self.size,), "(the size given)")
        return added
