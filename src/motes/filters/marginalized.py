"""Marginalized (Rao-Blackwellized) particle filter (Karlsson, Schon, Gustafsson 2005, Alg. 1; Schon, Gustafsson, Nordlund 2005 for C != 0).

The states x_k that are linear-Gaussian given the path of the others x_p are carried by one Kalman filter per particle, of mean l and
covariance P.

1. Resample particles with their Gaussians where the policy says so; smooth x_p where a regularization is given.
2. Draw x_p' from N(f_p + A_p l, A_p P A_p' + Q_p): the spread of x_k counts.
3. Correct l and P by x_p' as if it were a measurement of x_k, then predict them. Correlated process noises are decorrelated first:
   with G = Q_kp Q_p^-1, x_k' = f_k + (A_k - G A_p) x_k + G (x_p' - f_p) + noise of covariance Q_k - G Q_pk (Gram-Schmidt).
4. Weigh each particle by N(y; h + C l, C P C' + R), determinant included, before its Kalman filter sees y; then correct l and P by y.

The paper begins with step 4. Where nothing in the covariance recursion depends on the particle, one P serves all.
"""

from typing import Any

import jax

from motes.core import checks, linalg, random
from motes.core.record import record, replace, static
from motes.filters import alarm
from motes.filters.alarm import Innovation
from motes.filters.clouds import resample_and_move, update_weights
from motes.filters.gated import Gated
from motes.filters.info import Info, with_innovation
from motes.filters.interface import Guide, TwoStageFilter
from motes.filters.marginal_moves import first_particles, moved
from motes.filters.sharp import ask_noise
from motes.laws.circular import wrap
from motes.laws.density import measured_in
from motes.laws.gaussian import Gaussian
from motes.laws.marginal_cloud import MarginalCloud
from motes.models.split import SplitModel, split
from motes.resampling.kernels import Regularization
from motes.resampling.policy import ESS, Policy
from motes.resampling.schemes import Scheme, Systematic


@record
class MarginalizedParticleFilter(Gated, TwoStageFilter[MarginalCloud]):
    """Marginalized particle filter; its state is a `MarginalCloud`. `mo.filters.RaoBlackwellizedParticleFilter` is the same.

    Source: Karlsson, Schon, Gustafsson 2005, Complexity analysis of the marginalized particle filter; Schon, Gustafsson, Nordlund 2005,
    Marginalized particle filters for mixed linear/nonlinear state-space models.

    Example:
        >>> model = mo.textbook.radar_tracking()
        >>> xs, ys = mo.simulate(0, model, 50)
        >>> mo.run(1, mo.MarginalizedParticleFilter(n=500), model, ys).mean.shape
        (50, 6)

    Attributes:
        n: number of particles.
        linear: states to marginalize, by name or index; None for the largest set that the model's structure allows.
        scheme: how ancestors are drawn.
        policy: when to resample, at the start of a step.
        regularization: kernel that smooths the particle part of what was resampled (see `RegularizedParticleFilter`); None for none.
    """

    subtracts = True
    starves = True
    guide = Guide(
        needs="k states that are linear-Gaussian given the rest, found by tracing",
        cost="n k^2 with one covariance for all, n k^3 with one for each particle",
        use="some states enter linearly: fewer particles for the same accuracy",
    )

    n: int = static()
    linear: tuple[str | int, ...] | None = static(default=None)
    scheme: Scheme = Systematic()
    policy: Policy = ESS(0.5)
    regularization: Regularization | None = None

    def check_parameters(self) -> None:
        """Check the parameters.

        Raises:
            MotesError: n is not a positive whole number, or another parameter has the wrong kind.
        """
        checks.positive_integer("MarginalizedParticleFilter n", self.n)
        if self.linear is not None:
            object.__setattr__(self, "linear", (self.linear,) if isinstance(self.linear, str) else tuple(self.linear))

    @property
    def resamples_first(self) -> bool:  # type: ignore[override]
        """Where nothing is smoothed by what the weights say."""
        return self.regularization is None

    def prepare(self, model: Any, u: Any) -> SplitModel:
        """Split the model into particle and Kalman parts.

        Raises:
            MotesError: the states asked for are not conditionally linear-Gaussian; the message names the function and the states.
        """
        return split(model, self.linear, u)

    def ask(self, model: Any, u: Any) -> None:
        """Refuse a sensor without noise that sees no state of the Kalman part.

        Raises:
            MotesError: it has none in some component.
        """
        ask_noise(type(self).__name__, model, lambda: self.prepare(model, u).likelihood is not None)

    def init(self, key: jax.Array, model: SplitModel) -> MarginalCloud:
        """Draw n particles of x_p, each with the Gaussian of x_k given it."""
        return first_particles(key, model, self.n)

    def predict(self, key: jax.Array, model: SplitModel, state: MarginalCloud, u: Any, t: Any) -> MarginalCloud:
        """Resample where needed, move the particles, then correct and predict the Kalman part (steps 1 to 3)."""
        keys = (random.child(key, random.RESAMPLE), random.child(key, random.NOISE))
        example = state.particles[:, 0]
        smooth = None
        if self.regularization is not None and example.shape[0]:
            smooth = self.regularization.fitted(state.log_weights, state.particles, self.policy.needed(state.log_weights))

        def move(noise_key: jax.Array, cloud: MarginalCloud) -> MarginalCloud:
            if smooth is not None:
                cloud = replace(cloud, particles=smooth(random.child(noise_key, random.NOISE), cloud.particles))
            return moved(noise_key, model, cloud, example, u, t)

        def predict_only(noise_key: jax.Array, cloud: MarginalCloud) -> MarginalCloud:
            of_k = model.over("kalman", cloud.particles, example, u, t)
            return replace(cloud, kalman=cloud.kalman.through(of_k.A, of_k.f, of_k.Q))

        return resample_and_move(keys, self.scheme, self.policy, state, move if state.particles.shape[0] else predict_only)

    def correct(self, key: jax.Array, model: SplitModel, state: MarginalCloud, y: jax.Array, u: Any, t: Any) -> tuple[MarginalCloud, Info]:
        """Weigh each particle by its predictive density of y, and correct its Gaussian (step 4)."""
        example = state.particles[:, 0]

        def likelihood_of(cloud: MarginalCloud) -> tuple[MarginalCloud, jax.Array, jax.Array]:
            if model.likelihood is not None:
                whole = model.whole(cloud.particles)
                return cloud, model.likelihood.log_prob(y, whole, u, t), model.likelihood.max_log_prob(y, whole, u, t)
            h, C, R = model.over("sensor", cloud.particles, example, u, t)
            prediction = h + linalg.times_vector(C, cloud.kalman.center)
            innovation = wrap(y[:, None] - prediction, model.mixed.angles)
            done = cloud.kalman.corrected(innovation, C, R, measured_in(y, R))
            return replace(cloud, kalman=done.law), done.log_evidence, done.max_log_evidence

        after, info = update_weights(state, likelihood_of)
        return after, with_innovation(info, _innovation(key, model, state, y, u, t))


def _innovation(key: jax.Array, model: SplitModel, state: MarginalCloud, y: jax.Array, u: Any, t: Any) -> Innovation:
    """Ask some of the particles, each with its Gaussian, what they expect to measure."""
    some = alarm.some_of(state.log_weights.shape[0])
    particles, log_weights, cov = state.particles[:, some], state.log_weights[some], state.kalman.covariance
    if model.likelihood is not None:
        return alarm.of_cloud(key, model.likelihood, model.whole(particles), log_weights, y, u, t)
    h, C, R = model.over("sensor", particles, particles[:, 0], u, t)
    predicted = Gaussian(state.kalman.center[:, some], cov[..., some] if cov.ndim == 3 else cov).through(C, h, R)
    return alarm.of_mixture(model.mixed.angles, predicted.center, predicted.covariance, log_weights, y)


RaoBlackwellizedParticleFilter = MarginalizedParticleFilter
