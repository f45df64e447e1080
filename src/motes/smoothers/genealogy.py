"""Genealogy smoothers: the filter's own ancestors, followed back (Kitagawa 1996); a fixed lag limits how far.

1. Follow the ancestors of each late particle back to the step of the state: from the last step, or with a lag L from L steps later.
2. Mean and covariance are those of the ancestors found, under the weights of the late particles.

Exact in the limit of many particles, and free. But particles of a late step descend from few of an early one: the whole genealogy holds
one path only, before a while. A lag costs a little bias where later measurements still tell something of the state, and saves the variance
(Kitagawa, Sato 2001).
"""

from typing import Any

import jax
import jax.numpy as jnp

from motes.core import checks
from motes.core.record import record, static
from motes.filters.history import History
from motes.laws.cloud import Cloud
from motes.models.interface import Model
from motes.models.state_space import at_step
from motes.smoothers.interface import Smoothed, Smoother, Steps, ask_laws, summed_up


@record
class GenealogySmoother(Smoother):
    """Genealogy smoother; it works with clouds and needs no density of the dynamics. With a lag it gives no paths.

    Of filters whose particles carry more, such as `MarginalizedParticleFilter` and `LandmarkFilter`, it takes what `mo.keep.paths` keeps.

    Source: Kitagawa 1996, Monte Carlo filter and smoother for non-Gaussian nonlinear state space models.

    Example:
        >>> model = mo.textbook.growth()
        >>> xs, ys = mo.simulate(0, model, 50)
        >>> history = mo.run(1, mo.ParticleFilter(n=500), model, ys, keep=mo.keep.laws)
        >>> mo.smooth(2, mo.smoothers.GenealogySmoother(lag=10), model, history).mean.shape
        (50, 1)

    Attributes:
        lag: number of steps beyond its own whose measurements count for a state; None for all.
    """

    lag: int | None = static(default=None)

    def check_parameters(self) -> None:
        """Check the parameters.

        Raises:
            MotesError: the lag is not a positive whole number.
        """
        if self.lag is not None:
            checks.positive_integer("GenealogySmoother lag", self.lag)

    def prepare(self, model: Any, history: History, u: Any) -> Model:
        """Ask for clouds whose particles descend from one another.

        Raises:
            MotesError: the history has none.
        """
        if not isinstance(history.kept.get("law"), Cloud):  # `keep.paths` gives one whatever the law of the filter
            ask_laws("GenealogySmoother", history, Cloud)
        if not history.descends:
            checks.refuse("GenealogySmoother history", "particles that came from the ancestors they name", history.label or "others",
                          "Use BackwardSimulationSmoother.")
        return checks.instance("GenealogySmoother model", model, Model, "the model of the run")

    def smooth(self, key: jax.Array, model: Model, history: History, steps: Steps) -> Smoothed:
        """Follow the ancestors."""
        clouds: Cloud = history.law
        return _followed(clouds, model.modes) if self.lag is None else _lagged(clouds, self.lag, model.modes)


def _followed(clouds: Cloud, modes: int) -> Smoothed:
    weights = clouds.log_weights[-1]

    def back(ancestor: jax.Array, row: Any) -> tuple[jax.Array, jax.Array]:
        particles, ancestors = row
        return ancestors[ancestor], particles[:, ancestor]

    particle_indices = jnp.arange(weights.shape[0], dtype=jnp.int32)
    # 1. follow
    _, paths = jax.lax.scan(back, particle_indices, (clouds.particles, clouds.ancestors), reverse=True)
    # 2. moments
    mean, cov, probabilities = jax.vmap(lambda X: summed_up(weights, X, modes))(paths)
    return Smoothed(mean, cov, paths, weights, probabilities)


def _lagged(clouds: Cloud, lag: int, modes: int) -> Smoothed:
    count, n = clouds.log_weights.shape
    particle_indices = jnp.arange(n, dtype=jnp.int32)

    def moments(t: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array | None]:
        late = jnp.minimum(t + lag, count - 1)
        # 1. follow
        ancestor = jax.lax.fori_loop(0, late - t, lambda k, ancestor: clouds.ancestors[late - k][ancestor], particle_indices)
        # 2. moments
        return summed_up(clouds.log_weights[late], at_step(clouds.particles, t)[:, ancestor], modes)

    mean, cov, probabilities = jax.lax.map(moments, jnp.arange(count))
    return Smoothed(mean, cov, mode_probabilities=probabilities)
