"""Regularized particle filter (Musso, Oudjane, LeGland 2001; compared with in Dahia et al. 2004): resampling from a smoothed cloud.

1. Resample where the policy says so.
2. "post": add a draw of a small kernel to each resampled particle, then move it by the dynamics. "pre": the other way round, so that the
   predicted cloud is smoothed; its correction is by weights as ever, not by rejection. "metropolis": move it and add nothing.
3. Weigh by p(y | x).
4. "metropolis": the kernel proposes x* for each particle, which replaces x with probability
   min(1, p(y | x*) p(x* | before) / (p(y | x) p(x | before))): the law stays that of the particle filter, without bias from the kernel.
"""

from typing import Any

import jax
import jax.numpy as jnp

from motes.core import checks, linalg, random
from motes.core.record import record, replace, static
from motes.filters.clouds import resample_and_move, weigh_by_likelihood
from motes.filters.info import Info
from motes.filters.interface import Guide, TwoStageFilter
from motes.filters.look_ahead import Ahead, LookAheadFilter, keys_of, move_by_dynamics
from motes.filters.needs import as_particle_model
from motes.filters.sharp import ask_noise
from motes.laws.cloud import Cloud
from motes.laws.conditional import AdditiveGaussian, matrix_over
from motes.models.state_space import StateSpaceModel
from motes.native import cloudwise
from motes.resampling.kernels import Regularization
from motes.resampling.policy import ESS, Policy, resample
from motes.resampling.schemes import Scheme, Systematic


@record
class RegularizedParticleFilter(LookAheadFilter[Cloud], TwoStageFilter[Cloud]):
    """Regularized particle filter; its state is a `Cloud`.

    Source: Musso, Oudjane, LeGland 2001, Improving regularised particle filters.

    Example:
        >>> model = mo.textbook.growth()
        >>> xs, ys = mo.simulate(0, model, 50)
        >>> mo.run(1, mo.RegularizedParticleFilter(n=1000), model, ys).mean.shape
        (50, 1)

    Attributes:
        n: number of particles.
        regularization: the kernel.
        form: "post", "pre" or "metropolis", which needs noise in every state to accept anything.
        scheme: how ancestors are drawn.
        policy: when to resample, and with it to smooth, at the start of a step.
    """

    starves = True
    guide = Guide(
        needs="as ParticleFilter; a density of the dynamics for the Metropolis form",
        cost="n calls of each function, and one draw more",
        use="little process noise, so that resampled particles stay equal",
    )

    n: int = static()
    regularization: Regularization = Regularization()
    form: str = static(default="post")
    scheme: Scheme = Systematic()
    policy: Policy = ESS(0.5)

    def check_parameters(self) -> None:
        """Check the parameters.

        Raises:
            MotesError: n is not a positive whole number, the form is unknown, or shrinkage is to be accepted or refused.
        """
        checks.positive_integer("RegularizedParticleFilter n", self.n)
        checks.option("RegularizedParticleFilter form", self.form, ("post", "pre", "metropolis"))
        if self.form == "metropolis" and self.regularization.shrink:
            checks.refuse("RegularizedParticleFilter regularization", "no shrinkage with 'metropolis' (its proposals are symmetric)",
                          "shrink=True")

    @property
    def look_ahead(self) -> bool:  # type: ignore[override]
        """The Metropolis form moves only when it knows the measurement."""
        return self.form == "metropolis"

    def prepare(self, model: Any, u: Any) -> StateSpaceModel:
        """Ask for dynamics that can be drawn from (and, for the Metropolis form, have a density) and a sensor with a density.

        Raises:
            MotesError: one is missing.
        """
        return as_particle_model("RegularizedParticleFilter", model, transition_density=self.look_ahead)

    def ask(self, model: Any, u: Any) -> None:
        """Refuse a sensor without noise.

        Raises:
            MotesError: it has none in some component.
        """
        ask_noise(type(self).__name__, model)

    def init(self, key: jax.Array, model: StateSpaceModel) -> Cloud:
        """Draw n particles from the initial law."""
        return Cloud.equal(model.initial.sample(key, self.n))

    def predict(self, key: jax.Array, model: StateSpaceModel, state: Cloud, u: Any, t: Any) -> Cloud:
        """Resample where needed, move by the dynamics, and smooth what was resampled before or after (steps 1 and 2)."""
        keys = (random.child(key, random.RESAMPLE), random.child(key, random.NOISE))
        needed = self.policy.needed(state.log_weights)
        smooth = self.regularization.fitted(state.log_weights, state.particles, needed) if self.form == "post" else None

        def move(noise_key: jax.Array, cloud: Cloud) -> Cloud:
            X = cloud.particles if smooth is None else smooth(random.child(noise_key, random.NOISE), cloud.particles)
            return replace(cloud, particles=model.dynamics.sample(noise_key, X, u, t))

        # 1. resample; 2. move, in the form "post" what was smoothed
        moved = resample_and_move(keys, self.scheme, self.policy, state, move)
        if self.form == "post":
            return moved
        # 2. "pre": smooth what was moved
        moved = moved.gathered(model.circular)
        smooth = self.regularization.fitted(moved.log_weights, moved.particles, needed)
        return replace(moved, particles=smooth(random.child(keys[1], random.NOISE), moved.particles))

    def correct(self, key: jax.Array, model: StateSpaceModel, state: Cloud, y: jax.Array, u: Any, t: Any) -> tuple[Cloud, Info]:
        """Weigh the particles by the likelihood of y (step 3)."""
        return weigh_by_likelihood(key, model.sensor, state, y, u, t)

    def ahead(self, key: jax.Array, model: StateSpaceModel, state: Cloud, y: jax.Array, u: Any, t: Any) -> Ahead:
        """Resample where needed, move by the dynamics, weigh, and let the kernel propose (steps 1 to 4)."""
        resample_key, noise_key = keys_of(key)
        needed = self.policy.needed(state.log_weights)
        # its covariance is that of the past: proposals that knew the particles they move would not be symmetric
        smooth = self.regularization.fitted(state.log_weights, state.particles, needed)
        # 1. resample
        parents = resample(resample_key, self.scheme, self.policy, state)
        cloudwise.left_to_jax("move", parents, "a Metropolis step takes particles back")
        # 2. move
        moved = move_by_dynamics(noise_key, model, parents, u, t)
        # 3. weigh
        after, info = self.correct(key, model, moved, y, u, t)

        # 4. propose, and accept or stay
        def log_target(X: jax.Array) -> jax.Array:
            return model.sensor.log_prob(y, X, u, t) + model.dynamics.log_prob(X, parents.particles, u, t)

        proposed = smooth(random.child(noise_key, random.NOISE), moved.particles)
        uniform = random.uniform(random.child(key, random.UPDATE), (self.n,), proposed.dtype)
        accepted = jnp.log(1 - uniform) < log_target(proposed) - log_target(moved.particles)
        accepted &= _noisy_everywhere(model, parents.particles, u, t)
        return Ahead(replace(after, particles=jnp.where(accepted, proposed, moved.particles)), info, lambda: moved)


def _noisy_everywhere(model: StateSpaceModel, X: jax.Array, u: Any, t: Any) -> jax.Array | bool:
    """Tell where the dynamics have noise in every direction: elsewhere no proposal lies on the support of what it is to replace."""
    if not isinstance(model.dynamics, AdditiveGaussian):
        return True
    factor = linalg.cholesky(matrix_over(model.dynamics.Q, X, u, t))
    return jnp.all(jnp.stack([factor[i, i] for i in range(factor.shape[0])]) > 0, axis=0)
