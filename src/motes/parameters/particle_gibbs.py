"""Particle Gibbs with ancestor sampling (Andrieu, Doucet, Holenstein 2010; Lindsten, Jordan, Schon 2014).

1. Run a particle filter in which one particle follows the present path.
2. At each step draw a new ancestor for it, in proportion to w p(x_t | x_{t-1}), which lets its past change.
3. Draw one of the particles of the last step by weight; its ancestry is the new path.

In a `mcmc.Cycle` with a kernel for the parameters given the path it draws both.
"""

from typing import Any

import jax
import jax.numpy as jnp

from motes.core import checks, logspace, random
from motes.core.loop import loop
from motes.core.record import record, static
from motes.filters.needs import as_particle_model, ask_density
from motes.laws.cloud import draw
from motes.mcmc.interface import LogDensity, Position
from motes.models.state_space import at_step
from motes.parameters.paths import DrawsPaths, PathPosterior
from motes.resampling.schemes import Multinomial, Scheme
from motes.smoothers.parents import Move


@record
class ParticleGibbs(DrawsPaths):
    """Draws a path given the parameters; needs a `parameters.PathPosterior`.

    Source: Andrieu, Doucet, Holenstein 2010, Particle Markov chain Monte Carlo methods; Lindsten, Jordan, Schon 2014, Particle Gibbs
    with ancestor sampling.

    Example:
        >>> model, prior = mo.textbook.growth(), mo.Gaussian(jnp.zeros(1), jnp.eye(1))
        >>> xs, ys = mo.simulate(0, model, 20)
        >>> posterior = mo.parameters.PathPosterior(prior, lambda theta: model, ys)
        >>> chains = mo.sample(1, mo.parameters.ParticleGibbs(n=20), posterior, posterior.start, draws=100)
        >>> chains.positions["path"].shape
        (4, 100, 20, 1)

    Attributes:
        n: particles, that of the path included.
        scheme: with a conditional form: `Multinomial`, `Systematic` or `Killing`.
    """

    n: int = static()
    scheme: Scheme = Multinomial()

    def __post_init__(self) -> None:
        """Check the parameters.

        Raises:
            MotesError: n is less than 2.
        """
        checks.positive_integer("ParticleGibbs n", self.n)
        if self.n < 2:
            checks.refuse("ParticleGibbs n", "at least 2 (one follows the path)", self.n)

    def check(self, key: jax.Array, log_density: LogDensity, position: Position) -> None:
        """Ask for a posterior of parameters and path, and dynamics with a density."""
        model = as_particle_model("ParticleGibbs", self.asked(log_density).at(position["theta"])[0], transition_density=False)
        ask_density("ParticleGibbs dynamics", model.dynamics, " (ancestors of the path are drawn by it)")

    def path(self, key: jax.Array, posterior: PathPosterior, position: Position) -> jax.Array:
        """See `DrawsPaths`."""
        (model, inputs), old = posterior.at(position["theta"]), position["path"]

        def weighed(X: jax.Array, t: Any) -> jax.Array:
            return logspace.normalize(posterior.log_likelihood(model, X, at_step(inputs, t), t))[0]

        def ahead(held: tuple[jax.Array, jax.Array], t: jax.Array) -> tuple[tuple[jax.Array, jax.Array], tuple[jax.Array, jax.Array]]:
            X, log_weights = held
            step, u = random.step_key(key, t), at_step(inputs, t)
            toward = jnp.broadcast_to(old[t][:, None], X.shape)
            linked, any_leads = logspace.normalize(log_weights + Move(model.dynamics, u, t).among(X, toward).log_prob(toward, X))
            # without noise in some direction no other particle leads to the path: it keeps its own past
            parent = jnp.where(jnp.isfinite(any_leads), draw(random.child(step, random.INITIAL), linked, 1)[0], 0)
            ancestors = self.scheme.conditional_ancestors(random.child(step, random.RESAMPLE), log_weights, parent)
            moved = model.dynamics.sample(random.child(step, random.PREDICT), X[:, ancestors], u, t).at[:, 0].set(old[t])
            return (moved, weighed(moved, t)), (moved, ancestors)

        opening = random.step_key(key, 0)
        first = model.initial.sample(random.child(opening, random.INITIAL), self.n).at[:, 0].set(old[0])
        steps = jnp.arange(1, old.shape[0], dtype=jnp.int32)
        (_, log_weights), (clouds, ancestors) = loop(ahead, (first, weighed(first, 0)), steps)
        chosen = draw(random.child(opening, random.RESAMPLE), log_weights, 1)[0]

        def back(own: jax.Array, row: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
            cloud, parents = row
            return parents[own], cloud[:, own]

        own, later = jax.lax.scan(back, chosen, (clouds, ancestors), reverse=True)
        return jnp.concatenate([first[:, own][None], later])
