"""Joint probabilistic data association with a cloud for each target (Schulz, Burgard, Fox, Cremers 2003; Vermaak, Godsill, Perez 2005).

1. Resample each target's cloud where the policy says so, and move it.
2. For each target i and plot j, average what the particles make of it: L_ij = sum of w P_D(x) p(z_j | x) / kappa(z_j), L_i0 of no plot.
3. Sum over all associations; beta_ij is the share of those in which plot j is of target i.
4. Weigh the particles of target i by sum_j (beta_ij / L_ij) L_ij(x).

The clouds are taken to be independent after each step, as they are not quite where targets share plots: the price of n particles for each
target instead of n to the power of their number.
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from motes.core import checks, random
from motes.core.record import record, replace, static
from motes.filters.clouds import weigh_by_likelihood
from motes.filters.info import Info, weigh
from motes.filters.interface import Guide, TwoStageFilter
from motes.filters.needs import as_particle_model
from motes.filters.sharp import ask_noise
from motes.laws.association import associated, gained, missed
from motes.laws.cloud import Cloud
from motes.laws.cluttered import Cluttered
from motes.laws.conditional import AdditiveGaussian
from motes.laws.gaussian import Gaussian
from motes.laws.near_plots import CHUNK, over_few
from motes.laws.several_targets import SeveralTargets
from motes.laws.target_clouds import TargetClouds
from motes.models.canonical import canonical
from motes.models.state_space import StateSpaceModel
from motes.resampling.policy import ESS, Policy, resample
from motes.resampling.schemes import Scheme, Systematic
from motes.tracing.affinity import dependence


@record
class JPDAParticleFilter(TwoStageFilter[TargetClouds]):
    """Particle filter with a cloud for each target of a `SeveralTargets` sensor; its state is a `TargetClouds`.

    With any other sensor there is one target, which has all states. `info.ess` is that of the target whose cloud is the most uneven.

    Source: Schulz, Burgard, Fox, Cremers 2003, People tracking with mobile robots using sample-based joint probabilistic data association
    filters; Vermaak, Godsill, Perez 2005, Monte Carlo filtering for multi-target tracking and data association.

    Example:
        >>> one = mo.Cluttered(mo.AdditiveGaussian(lambda x, u, t: x[:1], [[0.1]]), 0.9, clutter=0.01, plots=8)
        >>> both = mo.laws.SeveralTargets(one, (("a", "v_a"), ("b", "v_b")))
        >>> dynamics = mo.AdditiveGaussian(lambda x, u, t: x, jnp.eye(4))
        >>> model = mo.StateSpaceModel(mo.Gaussian(jnp.zeros(4), jnp.eye(4)), dynamics, both, ("a", "v_a", "b", "v_b"))
        >>> mo.run(0, mo.JPDAParticleFilter(n=500), model, [jnp.array([[0.1], [1.0]]), jnp.array([[0.3]])]).mean.shape
        (2, 4)

    Attributes:
        n: number of particles of each target.
        scheme: how ancestors are drawn.
        policy: when to resample a target's cloud, judged by its own weights.
    """

    starves = True
    guide = Guide(
        needs="as ParticleFilter; of several targets dynamics and initial law in which they are independent",
        cost="n calls of each function for each target, 2^T sums a plot for up to six targets",
        use="several targets in clutter, curved sensors, detections that depend on the state",
    )

    n: int = static()
    scheme: Scheme = Systematic()
    policy: Policy = ESS(0.5)

    def check_parameters(self) -> None:
        """Check the parameters.

        Raises:
            MotesError: n is not a positive whole number.
        """
        checks.positive_integer("JPDAParticleFilter n", self.n)

    def prepare(self, model: Any, u: Any) -> StateSpaceModel:
        """Ask for dynamics that can be drawn from, a sensor with a density, and a target for each state.

        Raises:
            MotesError: one is missing; the message names it.
        """
        model = as_particle_model("JPDAParticleFilter", model, transition_density=False)
        owned = {state for own in _targets(model) for state in own}
        for state in range(model.size):
            if state not in owned:
                hint = "Use a ParticleFilter or a Gaussian filter, whose law is of all states together."
                checks.refuse("JPDAParticleFilter model", "a target for each state", f"none for {model.names[state]}", hint)
        return model

    def ask(self, model: Any, u: Any) -> None:
        """Refuse a sensor without noise, and targets that are known not to be independent.

        Raises:
            MotesError: a component has no noise, or a target's states follow another's.
        """
        ask_noise(type(self).__name__, model)
        # what goes wrong in a user's function is told in one line by what it is wrapped in
        model = canonical(as_particle_model("JPDAParticleFilter", model, transition_density=False), u)
        known = [("initial law", model.initial.covariance)] if isinstance(model.initial, Gaussian) else []
        dynamics = model.dynamics
        if isinstance(dynamics, AdditiveGaussian):
            shapes = (jax.ShapeDtypeStruct((model.size,), model.dtype), u, jax.ShapeDtypeStruct((), jnp.int32))
            moved_by = dependence(lambda x, u, t: dynamics.mean(x, u, t), shapes, ("elements", "whole", "whole"))
            known.append(("dynamics", moved_by.uses[:, : model.size]))
            known += [("noise of the dynamics", dynamics.Q)] if not callable(dynamics.Q) else []
        owner = {state: i for i, own in enumerate(_targets(model)) for state in own}
        for name, pairs in known:
            for i, j in np.argwhere(np.asarray(pairs)) if checks.is_concrete(pairs) else []:
                if owner.get(int(i)) != owner.get(int(j)):
                    given, hint = f"{model.names[i]} that depends on {model.names[j]}", "Use a ParticleFilter, of all states together."
                    checks.refuse(f"JPDAParticleFilter {name}", "independent targets", given, hint)

    def init(self, key: jax.Array, model: StateSpaceModel) -> TargetClouds:
        """Draw n particles of each target from the initial law."""
        return TargetClouds.of(model.initial.sample(key, self.n), _targets(model))

    def predict(self, key: jax.Array, model: StateSpaceModel, state: TargetClouds, u: Any, t: Any) -> TargetClouds:
        """Resample each cloud where needed, then move it (step 1)."""
        keys = random.step_keys(random.child(key, random.RESAMPLE), len(state.targets))
        state = replace(state, clouds=jax.vmap(lambda key, cloud: resample(key, self.scheme, self.policy, cloud))(keys, state.clouds))
        return state.moved(model.dynamics.sample(random.child(key, random.NOISE), state.particles, u, t))

    def correct(self, key: jax.Array, model: StateSpaceModel, state: TargetClouds, y: Any, u: Any, t: Any) -> tuple[TargetClouds, Info]:
        """Weigh the particles of each target (steps 2 to 4)."""
        if not isinstance(model.sensor, SeveralTargets):
            only = jax.tree.map(lambda leaf: leaf[0], state.clouds)
            cloud, info = weigh_by_likelihood(key, model.sensor, only, y, u, t)
            return replace(state, clouds=jax.tree.map(lambda leaf: leaf[None], cloud)), info
        one, rows, shared, count = model.sensor.one, y.value, model.sensor.shared(y.value), len(state.targets)

        def needs(cloud: Cloud) -> jax.Array:
            return one.seen_by_any(rows, shared.gains, _missed(one, cloud, u, t), one.of_plots(cloud.particles, u, t))

        def likelihoods(rows: jax.Array, gains: jax.Array, false: jax.Array) -> tuple[jax.Array, jax.Array]:
            terms = jax.vmap(lambda cloud: _terms(one, cloud, rows, gains, u, t))(state.clouds)
            averages = jax.nn.logsumexp(state.clouds.log_weights[:, None] + terms, axis=2)
            evidence, shares = associated(averages[:, 1:], averages[:, 0], false)
            factors = jnp.where(shares > 0, jnp.log(shares) - averages, -jnp.inf)
            return evidence, jax.nn.logsumexp(factors[:, :, None] + terms, axis=1)

        wanted = shared.certain | jnp.any(jax.vmap(needs)(state.clouds), axis=0)
        evidence, found = over_few(likelihoods, wanted, CHUNK * count, rows, shared.gains, shared.false)
        unknown = jnp.asarray(jnp.inf, evidence.dtype)
        weights, info = jax.vmap(lambda before, log_likelihood: weigh(before, log_likelihood, unknown))(state.clouds.log_weights, found)
        return replace(state, clouds=replace(state.clouds, log_weights=weights)), _worst(info, shared.base + evidence)


def _missed(one: Cluttered, cloud: Cloud, u: Any, t: Any) -> jax.Array:
    """Log probability that each particle of a target gives no plot, `(n,)`."""
    return jnp.broadcast_to(missed(one.detected(cloud.particles, u, t)), cloud.log_weights.shape)


def _terms(one: Cluttered, cloud: Cloud, rows: jax.Array, gains: jax.Array, u: Any, t: Any) -> jax.Array:
    """Logs of what each particle of a target makes of no plot and of each, `(1 + K, n)`."""
    hit = jnp.log(one.detected(cloud.particles, u, t))
    plots = hit + gained(gains[:, None], jax.vmap(one.of_plots(cloud.particles, u, t).density)(rows))
    return jnp.concatenate([_missed(one, cloud, u, t)[None], plots])


def _targets(model: StateSpaceModel) -> tuple[tuple[int, ...], ...]:
    return model.sensor.indices if isinstance(model.sensor, SeveralTargets) else (tuple(range(model.size)),)


def _worst(info: Info, log_evidence: jax.Array) -> Info:
    """Return the record of a step from those of all targets `(m,)`: of each number that of the one which fares worst."""
    worst = {name: jnp.max(getattr(info, name)) for name in ("invalid", "highest")}
    worst |= {name: jnp.min(getattr(info, name)) for name in ("ess", "lowest", "shortfall")}
    collapsed = jnp.any(info.collapsed) | ~jnp.isfinite(log_evidence)
    return replace(jax.tree.map(lambda leaf: leaf[0], info), log_evidence=log_evidence, collapsed=collapsed, **worst)
