"""Rao-Blackwellized particle Gibbs (Whiteley, Andrieu, Doucet 2010; Lindsten, Schon 2013): particles for part of the path alone.

1. Run a marginalized particle filter in which one particle follows x_p of the present path; its x_k plays no part.
2. Draw a path of both parts backward through its clouds (`RaoBlackwellizedSmoother`): at each step a particle and then x_k given it.

Drawing backward takes the place of ancestor sampling, and asks that the other particles' ancestors are drawn independently of that one's.
"""

from typing import Any

import jax
import jax.numpy as jnp

from motes.core import checks, random
from motes.core.record import record, replace, static
from motes.filters import keep
from motes.filters.info import Info
from motes.filters.interface import TwoStageFilter
from motes.filters.marginal_moves import moved
from motes.filters.marginalized import MarginalizedParticleFilter
from motes.filters.run import run
from motes.laws.marginal_cloud import MarginalCloud
from motes.mcmc.interface import LogDensity, Position
from motes.models.mixed_linear import initial_means
from motes.models.split import SplitModel, split
from motes.models.state_space import as_state_space, at_step
from motes.parameters.paths import DrawsPaths, PathPosterior
from motes.resampling.schemes import Multinomial
from motes.smoothers.rao_blackwellized import RaoBlackwellizedSmoother
from motes.smoothers.smooth import smooth


@record
class RaoBlackwellizedParticleGibbs(DrawsPaths):
    """Draws a path given the parameters, with particles for the states that are not marginalized; needs a `parameters.PathPosterior`.

    With every state marginalized it is the exact draw by a Kalman filter forward and sampling backward, and one particle is enough.

    Source: Whiteley, Andrieu, Doucet 2010, Efficient Bayesian inference for switching state-space models using discrete particle Markov
    chain Monte Carlo methods; Lindsten, Schon 2013, Backward simulation methods for Monte Carlo statistical inference.

    Example:
        >>> model, prior = mo.textbook.constant_velocity(), mo.Gaussian(jnp.zeros(1), jnp.eye(1))
        >>> xs, ys = mo.simulate(0, model, 20)
        >>> posterior = mo.parameters.PathPosterior(prior, lambda theta: model, ys)
        >>> kernel = mo.parameters.RaoBlackwellizedParticleGibbs(n=20, linear=("vx", "vy"))
        >>> chains = mo.sample(1, kernel, posterior, posterior.start, draws=100)

    Attributes:
        n: particles, that of the path included.
        linear: states to marginalize, by name or index; None for the largest set that the model's structure allows.
    """

    n: int = static()
    linear: tuple[str | int, ...] | None = static(default=None)

    def __post_init__(self) -> None:
        """Check the parameters.

        Raises:
            MotesError: n is not a positive whole number.
        """
        checks.positive_integer("RaoBlackwellizedParticleGibbs n", self.n)

    def check(self, key: jax.Array, log_density: LogDensity, position: Position) -> None:
        """Ask for a posterior of parameters and path, and a model that splits; particles want company."""
        given, inputs = self.asked(log_density).at(position["theta"])
        model = split(given, self.linear, at_step(inputs, 0))
        if self.n < 2 and len(model.mixed.linear) < len(model.mixed.order):
            checks.refuse("RaoBlackwellizedParticleGibbs n", "at least 2 (one follows the path)", self.n)

    def path(self, key: jax.Array, posterior: PathPosterior, position: Position) -> jax.Array:
        """See `DrawsPaths`."""
        model = as_state_space(type(self).__name__, posterior.model(position["theta"]))
        follows = _Following(MarginalizedParticleFilter(self.n, self.linear), position["path"], on_collapse="predict")
        history = run(random.child(key, random.FILTER), follows, model, posterior.ys, posterior.inputs, keep.laws)
        drawn = smooth(random.child(key, random.WORLD), RaoBlackwellizedSmoother(1), model, history, posterior.ys, posterior.inputs)
        return jnp.asarray(drawn.paths)[..., 0]


@record
class _Following(TwoStageFilter):
    """A marginalized particle filter whose first particle follows a path.

    Attributes:
        filter: the other particles'.
        path: `(t, x)`.
    """

    filter: MarginalizedParticleFilter
    path: jax.Array

    def prepare(self, model: Any, u: Any) -> SplitModel:
        """See `MarginalizedParticleFilter`."""
        return self.filter.prepare(model, u)

    def init(self, key: jax.Array, model: SplitModel) -> MarginalCloud:
        """See `MarginalizedParticleFilter`; the first particle is where the path starts."""
        cloud, mixed = self.filter.init(key, model), model.mixed
        x_p = cloud.particles.at[:, 0].set(self._at(cloud, 0))
        means = initial_means(mixed.initial_p, mixed.initial_k, mixed.initial_gain, x_p)
        return replace(cloud, particles=x_p, kalman=replace(cloud.kalman, center=means))

    def predict(self, key: jax.Array, model: SplitModel, state: MarginalCloud, u: Any, t: Any) -> MarginalCloud:
        """Resample always, the first particle from itself, and move it along the path."""
        ancestors = Multinomial().conditional_ancestors(random.child(key, random.RESAMPLE), state.log_weights, jnp.int32(0))
        first, example = self._at(state, t), state.particles[:, 0]
        return moved(random.child(key, random.NOISE), model, state.resampled(ancestors), example, u, t, first)

    def correct(self, key: jax.Array, model: SplitModel, state: MarginalCloud, y: jax.Array, u: Any, t: Any) -> tuple[MarginalCloud, Info]:
        """See `MarginalizedParticleFilter`."""
        return self.filter.correct(key, model, state, y, u, t)

    def _at(self, cloud: MarginalCloud, t: Any) -> jax.Array:
        """Particle states of the path."""
        own = [state for state, place in enumerate(cloud.order) if place < cloud.particles.shape[0]]
        return self.path[t][jnp.array(own, int)]
