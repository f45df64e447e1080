"""Gaussian-sum particle filters I, II and III (Kotecha, Djuric 2003 II): a bank of Gaussian particle filters, one for each mixand.

1. Where the weights of the mixands are uneven, or mixands too many, resample or prune them.
2. Predict: draw particles from each mixand, move them, keep mean and covariance. In form II the process noise is a mixture: each mixand
   gives one for each of its components, weighted by it.
3. Correct: draw particles from each mixand; p(y | x) at them gives its new moments, and their mean its new weight. In form III the
   measurement noise is a mixture: each mixand gives one for each of its components.
"""

from typing import Any

import jax
import jax.numpy as jnp

from motes.core import checks, linalg, logspace, random
from motes.core.record import record, replace, static
from motes.filters import alarm
from motes.filters.gated import Gated
from motes.filters.info import Info, weigh, with_innovation
from motes.filters.interface import Guide, TwoStageFilter
from motes.filters.needs import as_particle_model
from motes.filters.sharp import ask_noise
from motes.laws.cloud import weighted_moments
from motes.laws.conditional import AdditiveGaussian, AdditiveNoise, Conditional, matrix_over, over_particles
from motes.laws.gaussian import Gaussian
from motes.laws.mixture import Mixture, moments_each
from motes.models.state_space import StateSpaceModel
from motes.resampling.kernels import Regularization
from motes.resampling.policy import ESS, Policy, resample
from motes.resampling.schemes import Scheme, Systematic

NOISE_OF = {"II": "dynamics", "III": "sensor"}
"""For each form, the part of the model whose noise is split into its components."""


@record
class GaussianSumParticleFilter(Gated, TwoStageFilter[Mixture]):
    """Gaussian-sum particle filter; its state is a `Mixture`, and `info.ess` counts mixands.

    Source: Kotecha, Djuric 2003, Gaussian sum particle filtering.

    Example:
        >>> model = mo.textbook.growth()
        >>> xs, ys = mo.simulate(0, model, 50)
        >>> mo.run(1, mo.GaussianSumParticleFilter(n=100, mixands=10), model, ys).mean.shape
        (50, 1)

    Attributes:
        n: number of particles of each mixand.
        mixands: number of mixands; forms II and III carry as many for each component of the noise until the next step reduces them.
        form: "I", or "II" where the dynamics' noise and "III" where the sensor's noise is a Gaussian `Mixture`.
        reduction: how forms II and III go back to `mixands`: "resample" (unbiased) or "prune" (the heaviest stay, with their weights).
        scheme: how mixands are drawn.
        policy: when mixands are resampled that are not too many.
    """

    guide = Guide(
        needs="as ParticleFilter; a Gaussian mixture for the noise in forms II and III",
        cost="n calls for each mixand",
        use="several modes, noises that are Gaussian mixtures",
    )

    n: int = static()
    mixands: int = static()
    form: str = static(default="I")
    reduction: str = static(default="resample")
    scheme: Scheme = Systematic()
    policy: Policy = ESS(0.5)

    def check_parameters(self) -> None:
        """Check the parameters.

        Raises:
            MotesError: a number is not a positive whole one, or a word is unknown.
        """
        for name in ("n", "mixands"):
            checks.positive_integer(f"GaussianSumParticleFilter {name}", getattr(self, name))
        checks.option("GaussianSumParticleFilter form", self.form, ("I", "II", "III"))
        checks.option("GaussianSumParticleFilter reduction", self.reduction, ("resample", "prune"))

    def prepare(self, model: Any, u: Any) -> StateSpaceModel:
        """Ask for dynamics that can be drawn from, a sensor with a density, and in forms II and III for a Gaussian mixture of a noise.

        Raises:
            MotesError: one is missing.
        """
        model = as_particle_model("GaussianSumParticleFilter", model, transition_density=False)
        if self.form != "I":
            name = NOISE_OF[self.form]
            part = getattr(model, name)
            if not (isinstance(part, AdditiveGaussian) or isinstance(getattr(part, "law", None), (Gaussian, Mixture))):
                checks.refuse(f"GaussianSumParticleFilter {name}", f"Gaussian noise or a Mixture in form {self.form!r}",
                              type(getattr(part, "law", part)).__name__, 'Use form="I".')
        return model

    def _noise_components(self, model: StateSpaceModel) -> list[tuple[jax.Array, Conditional]]:
        """Components of the noise that this form splits: log weight, and the conditional with this noise alone."""
        part = getattr(model, NOISE_OF[self.form])
        law = getattr(part, "law", None)
        if not (isinstance(part, AdditiveNoise) and isinstance(law, Mixture)):
            return [(jnp.zeros((), model.dtype), part)]
        cov = law.parts.covariance
        covs = [cov[..., k] if cov.ndim == 3 else cov for k in range(law.log_weights.shape[0])]
        return [(law.log_weights[k], replace(part, law=Gaussian(law.parts.center[:, k], covs[k]))) for k in range(len(covs))]

    def _copies(self, model: StateSpaceModel) -> int:
        return 1 if self.form == "I" else len(self._noise_components(model))

    def ask(self, model: Any, u: Any) -> None:
        """Refuse a sensor without noise.

        Raises:
            MotesError: it has none in some component.
        """
        ask_noise(type(self).__name__, model)

    def init(self, key: jax.Array, model: StateSpaceModel) -> Mixture:
        """Spread mixands so that mean and covariance of all are those of the initial law (their width is a kernel's for so many points)."""
        count = self.mixands * self._copies(model)
        mean, cov = model.initial.mean(), model.initial.cov()
        width = min(1.0, float(Regularization().bandwidth(model.size, self.mixands)))
        X = model.initial.sample(key, count)
        equal = logspace.uniform_weights(count, X.dtype)
        middle, spread = weighted_moments(equal, X)
        white = linalg.solve_lower(linalg.cholesky(spread), X - middle[:, None])
        centers = mean[:, None] + (1 - width**2) ** 0.5 * linalg.times_vector(linalg.cholesky(cov), white)
        return Mixture(Gaussian(centers, jnp.repeat(width**2 * cov[..., None], count, axis=-1)), equal)

    def _reduced(self, key: jax.Array, state: Mixture) -> Mixture:
        if state.log_weights.shape[0] == self.mixands:
            return resample(key, self.scheme, self.policy, state)
        if self.reduction == "resample":
            return state.resampled(self.scheme.ancestors(key, state.log_weights, self.mixands))
        heaviest, which = jax.lax.top_k(state.log_weights, self.mixands)
        return replace(state.resampled(which), log_weights=logspace.normalize(heaviest)[0])

    def predict(self, key: jax.Array, model: StateSpaceModel, state: Mixture, u: Any, t: Any) -> Mixture:
        """Reduce the mixands (step 1), then move each by particles (step 2)."""
        state = self._reduced(random.child(key, random.RESAMPLE), state)
        points = state.parts.sample_each(random.child(key, random.INITIAL), self.n)
        X = points.reshape(points.shape[0], -1)
        equal = jnp.full(points.shape[1:], -jnp.log(jnp.asarray(self.n, X.dtype)))
        if self.form != "II":
            moved = model.dynamics.sample(random.child(key, random.NOISE), X, u, t)
            parts = moments_each(equal, moved.reshape(points.shape), model.circular)
            copies = self._copies(model)
            log_weights = state.log_weights - jnp.log(jnp.asarray(copies, X.dtype))
            return Mixture(*jax.tree.map(lambda leaf: jnp.concatenate([leaf] * copies, axis=-1), (parts, log_weights)))
        # 2. form II: one mixand for each component of the process noise
        found: list[Mixture] = []
        for log_weight, part in self._noise_components(model):
            moved = moments_each(equal, over_particles(part.mean, X, u, t).reshape(points.shape), model.circular)
            noise = matrix_over(part.cov, X, u, t)
            if noise.ndim == 3:
                noise = jnp.mean(noise.reshape(*noise.shape[:2], *points.shape[1:]), axis=2)
            found.append(Mixture(Gaussian(moved.center, linalg.add(moved.covariance, noise)), state.log_weights + log_weight))
        return jax.tree.map(lambda *leaves: jnp.concatenate(leaves, axis=-1), *found)

    def correct(self, key: jax.Array, model: StateSpaceModel, state: Mixture, y: jax.Array, u: Any, t: Any) -> tuple[Mixture, Info]:
        """Weigh particles of each mixand by the likelihood of y; keep their moments and their mean weight (step 3)."""
        points = state.parts.sample_each(key, self.n)
        log_likelihood, max_log_likelihood = self._log_likelihoods(model, points, y, u, t)
        before = jnp.broadcast_to(state.log_weights - jnp.log(jnp.asarray(self.n, points.dtype)), points.shape[1:])
        joint, info = weigh(before.reshape(-1), log_likelihood.reshape(-1), max_log_likelihood.reshape(-1))
        # for the alarm, a few particles of each mixand
        some = points[:, alarm.some_of(self.n, -(-alarm.FEWEST // points.shape[2]))]
        log_weights = jnp.broadcast_to(state.log_weights, some.shape[1:]).reshape(-1)
        info = with_innovation(info, alarm.of_cloud(key, model.sensor, some.reshape(some.shape[0], -1), log_weights, y, u, t))
        joint = joint.reshape(points.shape[1:])
        # the new weight of each mixand, and the weights of its particles within it
        log_weights = jax.nn.logsumexp(joint, axis=0)
        possible = jnp.isfinite(log_weights)
        within = jnp.where(possible, joint - jnp.where(possible, log_weights, 0), -jnp.log(jnp.asarray(self.n, points.dtype)))
        # a mixand without any weight stays as predicted
        parts = jax.tree.map(lambda new, old: jnp.where(possible, new, old), moments_each(within, points), state.parts)
        return Mixture(parts, log_weights), replace(info, ess=logspace.effective_size(log_weights))

    def _log_likelihoods(self, model: StateSpaceModel, points: jax.Array, y: jax.Array, u: Any, t: Any) -> tuple[jax.Array, jax.Array]:
        """Log likelihood of each particle and its maximum, `(n, mixands)`; copies of a mixand answer for one component each."""
        split = self._noise_components(model) if self.form == "III" else [(jnp.zeros((), points.dtype), model.sensor)]
        found = []
        for (log_weight, part), some in zip(split, jnp.split(points, len(split), axis=-1), strict=True):
            X = some.reshape(some.shape[0], -1)
            share = log_weight + jnp.log(jnp.asarray(len(split), X.dtype))
            pair = part.log_prob(y, X, u, t), part.max_log_prob(y, X, u, t)
            found.append([share + jnp.broadcast_to(each, X.shape[-1:]).reshape(some.shape[1:]) for each in pair])
        log_likelihood, max_log_likelihood = (jnp.concatenate(parts, axis=-1) for parts in zip(*found, strict=True))
        return log_likelihood, max_log_likelihood
