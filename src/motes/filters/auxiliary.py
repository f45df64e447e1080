"""Auxiliary particle filter (Pitt, Shephard 1999): particles are resampled by what the next measurement says of them, before they move.

1. Score each particle x of the step before: s, an estimate of p(y | x).
2. Where the policy says so for the first-stage weights w s, resample by them; a resampled particle then weighs 1 / s of its ancestor.
3. Move each particle by the proposal, and multiply its weight by p(y | x') p(x' | x) / q(x' | x, y).

The evidence is the sum of the weights; after resampling that is sum(w s) times the mean of the second-stage weights, which is unbiased.
"""

from typing import Any

import jax
import jax.numpy as jnp

from motes.core import checks
from motes.core.record import record, static
from motes.filters.info import Info, with_innovation
from motes.filters.interface import Guide
from motes.filters.look_ahead import Ahead, LookAheadFilter, keys_of, move_by_dynamics, predicted_innovation, propose_and_weigh
from motes.filters.needs import as_particle_model
from motes.filters.proposals import Proposal, as_proposal
from motes.filters.sharp import ask_noise, conditions_exactly, weigh_or_redraw
from motes.laws.cloud import Cloud
from motes.laws.conditional import Conditional
from motes.models.state_space import StateSpaceModel
from motes.resampling.policy import ESS, Policy, resample
from motes.resampling.schemes import Scheme, Systematic


@record
class AuxiliaryParticleFilter(LookAheadFilter[Cloud]):
    """Auxiliary particle filter; its state is a `Cloud`.

    With `OptimalProposal` it is fully adapted: where particles were resampled all weights are equal, and the evidence given the cloud is
    exact. With the dynamics for proposal, particles are scored by p(y | mean of x'), which misleads where the process noise is wide beside
    the likelihood.

    Source: Pitt, Shephard 1999, Filtering via simulation: auxiliary particle filters.

    Example:
        >>> model = mo.textbook.growth()
        >>> xs, ys = mo.simulate(0, model, 50)
        >>> mo.run(1, mo.AuxiliaryParticleFilter(n=1000), model, ys).mean.shape
        (50, 1)

    Attributes:
        n: number of particles.
        proposal: how particles are scored and moved: see `ParticleFilter`.
        scheme: how ancestors are drawn.
        policy: when to resample, judged by the first-stage weights; `Always` is the filter of the paper.
    """

    starves = True
    guide = Guide(
        needs="as ParticleFilter, and a mean function of the dynamics",
        cost="n calls of each function, and a score for each particle",
        use="measurements tell much of where particles should have come from",
    )

    n: int = static()
    proposal: Proposal | Conditional | None = None
    scheme: Scheme = Systematic()
    policy: Policy = ESS(0.5)

    def check_parameters(self) -> None:
        """Check the parameters.

        Raises:
            MotesError: n is not a positive whole number, or the proposal has the wrong kind.
        """
        checks.positive_integer("AuxiliaryParticleFilter n", self.n)
        _ = self._importance_density

    @property
    def _importance_density(self) -> Proposal:
        return as_proposal("AuxiliaryParticleFilter proposal", self.proposal)

    def prepare(self, model: Any, u: Any) -> StateSpaceModel:
        """Ask for dynamics that can be drawn from and have a mean, a sensor with a density, and what the proposal needs.

        Raises:
            MotesError: one is missing.
        """
        model = as_particle_model("AuxiliaryParticleFilter", model, transition_density=isinstance(self.proposal, Conditional))
        if not model.dynamics.has_moments:
            checks.refuse("AuxiliaryParticleFilter dynamics", "a mean function (particles are scored at it)", type(model.dynamics).__name__,
                          "Use a ParticleFilter.")
        self._importance_density.check("AuxiliaryParticleFilter", model, u)
        return model

    def ask(self, model: Any, u: Any) -> None:
        """Refuse a sensor without noise; only the optimal proposal takes its measurement in.

        Raises:
            MotesError: it has none in some component.
        """
        ask_noise(type(self).__name__, model, lambda: not conditions_exactly(self._importance_density, model))

    def init(self, key: jax.Array, model: StateSpaceModel) -> Cloud:
        """Draw n particles from the initial law."""
        return Cloud.equal(model.initial.sample(key, self.n))

    def update(self, key: jax.Array, model: StateSpaceModel, state: Cloud, y: jax.Array, u: Any, t: Any) -> tuple[Cloud, Info]:
        """Weigh the particles by the likelihood of y."""
        after, info = weigh_or_redraw(key, self._importance_density, model, state, y, u, t)
        return self.accept(state, after, info, y)

    def ahead(self, key: jax.Array, model: StateSpaceModel, state: Cloud, y: jax.Array, u: Any, t: Any) -> Ahead:
        """Score, resample by the scores where needed, then move by the proposal and weigh (steps 1 to 3)."""
        resample_key, noise_key = keys_of(key)
        log_score = _finite_scores(self._importance_density.score(model, state.particles, y, u, t))
        parents = resample(resample_key, self.scheme, self.policy, state, log_score)
        after, info = propose_and_weigh(noise_key, self._importance_density, model, parents, y, u, t)
        info = with_innovation(info, predicted_innovation(noise_key, model, state, y, u, t))
        return Ahead(after, info, lambda: move_by_dynamics(noise_key, model, resample(resample_key, self.scheme, self.policy, state), u, t))


def _finite_scores(score: jax.Array) -> jax.Array:
    """Let scores that are no finite numbers count as the lowest that is: they tell nothing, and no particle may be left out for certain."""
    finite = jnp.isfinite(score)
    lowest = jnp.min(jnp.where(finite, score, jnp.inf))
    return jnp.where(finite, score, jnp.where(jnp.isfinite(lowest), lowest, 0))
