"""Particle filter: sequential importance sampling with resampling (Gordon, Salmond, Smith 1993; Arulampalam, Maskell, Gordon, Clapp 2002).

1. Resample where the policy says so: always is SIR (bootstrap), never is SIS, a threshold is the generic filter.
2. Move each particle by the dynamics, or by the proposal where one is given.
3. Multiply each weight by p(y | x) or, with a proposal, by p(y | x) p(x | before) / q(x | before, y); normalize.
"""

from typing import Any

import jax

from motes.core import checks, random
from motes.core.record import record, replace, static
from motes.filters.clouds import resample_and_move
from motes.filters.info import Info, with_innovation
from motes.filters.interface import Guide, TwoStageFilter
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
class ParticleFilter(LookAheadFilter[Cloud], TwoStageFilter[Cloud]):
    """Particle filter; its state is a `Cloud`.

    Source: Gordon, Salmond, Smith 1993, Novel approach to nonlinear/non-Gaussian Bayesian state estimation; Arulampalam, Maskell,
    Gordon, Clapp 2002, A tutorial on particle filters for online nonlinear/non-Gaussian Bayesian tracking.

    Example:
        >>> model = mo.textbook.growth()
        >>> xs, ys = mo.simulate(0, model, 50)
        >>> mo.run(1, mo.ParticleFilter(n=1000), model, ys).mean.shape
        (50, 1)

    Attributes:
        n: number of particles.
        proposal: how particles are moved once y_t is known: `OptimalProposal`, `ExtendedKalmanProposal`, `UnscentedProposal`, or a law of
            x_t given x_{t-1} and y_t, a conditional whose functions get the pair `(u, y)` for inputs. None for the dynamics.
        scheme: how ancestors are drawn.
        policy: when to resample, at the start of a step.
    """

    starves = resamples_first = True
    guide = Guide(
        needs="dynamics that can be drawn from, a sensor with a density",
        cost="n calls of each function",
        use="any model of few states; a proposal where measurements are sharp",
    )

    n: int = static()
    proposal: Proposal | Conditional | None = None
    scheme: Scheme = Systematic()
    policy: Policy = ESS(0.5)

    def check_parameters(self) -> None:
        """Check the parameters.

        Raises:
            MotesError: n is not a positive whole number, or another parameter has the wrong kind.
        """
        checks.positive_integer("ParticleFilter n", self.n)
        _ = self._importance_density

    @property
    def look_ahead(self) -> bool:  # type: ignore[override]
        """With a proposal the filter moves only when it knows the measurement."""
        return self.proposal is not None

    @property
    def _importance_density(self) -> Proposal:
        return as_proposal("ParticleFilter proposal", self.proposal)

    def prepare(self, model: Any, u: Any) -> StateSpaceModel:
        """Ask for dynamics that can be drawn from, a sensor with a density, and what the proposal needs.

        Raises:
            MotesError: one is missing.
        """
        model = as_particle_model("ParticleFilter", model, transition_density=isinstance(self.proposal, Conditional))
        self._importance_density.check("ParticleFilter", model, u)
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

    def predict(self, key: jax.Array, model: StateSpaceModel, state: Cloud, u: Any, t: Any) -> Cloud:
        """Resample where needed, then move by the dynamics (steps 1 and 2)."""

        def move(noise_key: jax.Array, cloud: Cloud) -> Cloud:
            return replace(cloud, particles=model.dynamics.sample(noise_key, cloud.particles, u, t))

        keys = (random.child(key, random.RESAMPLE), random.child(key, random.NOISE))
        return resample_and_move(keys, self.scheme, self.policy, state, move)

    def correct(self, key: jax.Array, model: StateSpaceModel, state: Cloud, y: jax.Array, u: Any, t: Any) -> tuple[Cloud, Info]:
        """Weigh the particles by the likelihood of y (step 3)."""
        return weigh_or_redraw(key, self._importance_density, model, state, y, u, t)

    def ahead(self, key: jax.Array, model: StateSpaceModel, state: Cloud, y: jax.Array, u: Any, t: Any) -> Ahead:
        """Resample where needed, then move by the proposal and weigh (steps 1 to 3)."""
        resample_key, noise_key = keys_of(key)
        parents = resample(resample_key, self.scheme, self.policy, state)
        after, info = propose_and_weigh(noise_key, self._importance_density, model, parents, y, u, t)
        info = with_innovation(info, predicted_innovation(noise_key, model, parents, y, u, t))
        return Ahead(after, info, lambda: move_by_dynamics(noise_key, model, parents, u, t))
