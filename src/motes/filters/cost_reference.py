"""Cost-reference particle filter (Miguez, Bugallo, Djuric 2004; Djuric 2004, section 4.2): costs in place of densities of the noises.

1. Risk of each particle: R = lambda C + |y - h(f(x))|^q, what it would cost without noise. Select particles by phi(R), or let each be
   replaced by the neighbor of the lowest risk; a particle keeps its cost C, not its risk.
2. Move each by f plus Gaussian steps; with `adaptive`, the factor s on their size follows the steps w that survived, in units of the scale:
   s^2 <- ((t - 1) s^2 + |w|^2 / x) / t.
3. Cost: C <- lambda C + |y - h(x)|^q. Weights are phi(C).
"""

from typing import Any

import jax
import jax.numpy as jnp

from motes.core import checks, logspace, random
from motes.core.record import record, replace, static
from motes.filters.info import Info, weigh
from motes.filters.interface import Guide
from motes.filters.look_ahead import Ahead, LookAheadFilter
from motes.filters.needs import as_moment_model
from motes.laws.conditional import matrix_over, over_particles
from motes.laws.cost_cloud import CostCloud
from motes.models.state_space import StateSpaceModel
from motes.resampling.costs import Falling, InverseExcess
from motes.resampling.schemes import Scheme, Systematic

SETTLING = 10
"""Steps before the size of the steps adapts."""


@record
class CostReferenceParticleFilter(LookAheadFilter[CostCloud]):
    """Cost-reference particle filter; its state is a `CostCloud`. It has no likelihood.

    Of the model it uses the mean functions, and `initial` to draw the first particles: no densities. Components of y are summed as they
    are, so bring measurements of different units to one scale.

    Source: Miguez, Bugallo, Djuric 2004, A new class of particle filters for random dynamic systems with unknown statistics.

    Example:
        >>> model = mo.textbook.growth()
        >>> xs, ys = mo.simulate(0, model, 50)
        >>> mo.run(1, mo.CostReferenceParticleFilter(n=1000), model, ys).mean.shape
        (50, 1)

    Attributes:
        n: number of particles.
        q: power of the residual in the cost, 1 or 2.
        phi: how weights fall with costs.
        forgetting: lambda, from 0 (the last measurement alone) to 1 (all of them).
        scale: standard deviation of the Gaussian steps, a number or one per state; None for those of the model's process noise.
        adaptive: let each particle carry a factor on the scale that follows its steps (from step 11 on).
        selection: "global" draws by phi(R); "local" compares each particle with its two neighbors and needs no sum over particles.
        estimate: "mean" weighted by phi(C), or "minimum cost", the best particle.
        scheme: how the global selection draws.
    """

    guide = Guide(
        needs="mean functions alone",
        cost="n calls of each function",
        use="noises whose law is not known",
    )

    n: int = static()
    q: int = static(default=2)
    phi: Falling = InverseExcess()
    forgetting: float = 0.95
    scale: Any = None
    adaptive: bool = static(default=False)
    selection: str = static(default="global")
    estimate: str = static(default="mean")
    scheme: Scheme = Systematic()
    has_evidence = False

    def check_parameters(self) -> None:
        """Check the parameters.

        Raises:
            MotesError: a number is out of range, or a word is unknown.
        """
        name = "CostReferenceParticleFilter"
        checks.positive_integer(f"{name} n", self.n)
        if self.q not in (1, 2):
            checks.refuse(f"{name} q", "1 or 2", self.q)
        if checks.is_concrete(self.forgetting) and not 0 <= self.forgetting <= 1:
            checks.refuse(f"{name} forgetting", "a number from 0 to 1", self.forgetting)
        if self.scale is not None:
            scale = checks.as_float(f"{name} scale", self.scale)
            if checks.is_concrete(scale) and not bool((scale > 0).all()):
                checks.refuse(f"{name} scale", "positive standard deviations", scale.tolist())
            object.__setattr__(self, "scale", scale)
        checks.option(f"{name} selection", self.selection, ("global", "local"))
        checks.option(f"{name} estimate", self.estimate, ("mean", "minimum cost"))

    def prepare(self, model: Any, u: Any) -> StateSpaceModel:
        """Ask for mean functions of dynamics and sensor.

        Raises:
            MotesError: one of them is a Custom conditional, or there are not as many scales as states.
        """
        model = as_moment_model("CostReferenceParticleFilter", model)
        if self.scale is not None and self.scale.ndim:
            checks.shape("CostReferenceParticleFilter scale", self.scale, (model.size,), "(one per state)")
        return model

    def init(self, key: jax.Array, model: StateSpaceModel) -> CostCloud:
        """Draw n particles from the initial law, at no cost."""
        return CostCloud.free(model.initial.sample(key, self.n), self.estimate == "minimum cost")

    def _costs(self, model: StateSpaceModel, cloud: CostCloud, X: jax.Array, y: jax.Array, u: Any, t: Any) -> tuple[jax.Array, jax.Array]:
        """Costs of particles that stand at X `(x, n)`, above the least, and the least."""
        residual = model.sensor.residual(y, over_particles(model.sensor.mean, X, u, t))
        # what was not measured costs nothing; a prediction that is not a number costs all
        square = jnp.sum(jnp.where(jnp.isnan(y)[:, None], 0, residual) ** 2, axis=0)
        costs = jnp.where(jnp.isinf(cloud.costs), jnp.inf, self.forgetting * cloud.costs) + (square if self.q == 2 else jnp.sqrt(square))
        costs = jnp.where(jnp.isnan(costs), jnp.inf, costs)
        lowest = jnp.min(costs)
        base = jnp.where(jnp.isfinite(lowest), lowest, 0)
        return costs - base, self.forgetting * cloud.least + base

    def _weighed(self, model: StateSpaceModel, cloud: CostCloud, y: jax.Array, u: Any, t: Any) -> tuple[CostCloud, Info]:
        costs, least = self._costs(model, cloud, cloud.particles, y, u, t)
        log_masses = jnp.where(jnp.isfinite(costs), self.phi.log_mass(costs, least), jnp.nan)
        weights, info = weigh(logspace.uniform_weights(self.n, log_masses.dtype), log_masses, jnp.full((), jnp.inf, log_masses.dtype))
        return replace(cloud, log_weights=weights, costs=costs, least=least), replace(info, log_evidence=jnp.zeros_like(least))

    def update(self, key: jax.Array, model: StateSpaceModel, state: CostCloud, y: jax.Array, u: Any, t: Any) -> tuple[CostCloud, Info]:
        """Charge the particles for y (step 3)."""
        after, info = self._weighed(model, state, y, u, t)
        return self.accept(state, after, info, y)

    def _selected(self, key: jax.Array, risks: jax.Array, least: jax.Array) -> jax.Array:
        if self.selection == "local":
            here = jnp.arange(self.n, dtype=jnp.int32)
            around = jnp.stack([here, jnp.roll(here, 1), jnp.roll(here, -1)])
            return jnp.take_along_axis(around, jnp.argmin(risks[around], axis=0)[None], axis=0)[0]
        return self.scheme.ancestors(key, logspace.normalize(self.phi.log_mass(risks, least))[0], self.n)

    def ahead(self, key: jax.Array, model: StateSpaceModel, state: CostCloud, y: jax.Array, u: Any, t: Any) -> Ahead:
        """Select by risk, go to the next time t, and charge the particles for y (steps 1 to 3)."""
        # 1. risk and selection
        predicted = over_particles(model.dynamics.mean, state.particles, u, t)
        risks, least = self._costs(model, state, predicted, y, u, t)
        ancestors = self._selected(random.child(key, random.RESAMPLE), risks, least)
        # 2. move
        noise = random.normal(random.child(key, random.NOISE), predicted.shape, predicted.dtype)

        def moved(cloud: CostCloud, centers: jax.Array) -> CostCloud:
            walk = cloud.spread * noise
            mean_square, time = jnp.sum(walk**2, axis=0) / noise.shape[0], jnp.asarray(t, noise.dtype)
            adapted = jnp.sqrt(((time - 1) * cloud.spread**2 + mean_square) / time)
            spread = jnp.where(t > SETTLING, adapted, cloud.spread) if self.adaptive else cloud.spread
            return replace(cloud, particles=centers + self._scales(model, cloud.particles, u, t) * walk, spread=spread)

        # 3. cost
        after, info = self._weighed(model, moved(state.chosen(ancestors), predicted[:, ancestors]), y, u, t)
        unselected = replace(state, ancestors=jnp.arange(self.n, dtype=jnp.int32))
        return Ahead(after, info, lambda: moved(unselected, predicted).gathered(model.circular))

    def _scales(self, model: StateSpaceModel, X: jax.Array, u: Any, t: Any) -> jax.Array:
        """Standard deviations of the steps, `(x, n)` or what broadcasts to it."""
        if self.scale is not None:
            return jnp.asarray(self.scale, X.dtype).reshape(-1, 1)
        variances = jnp.diagonal(matrix_over(model.dynamics.cov, X, u, t))
        return jnp.sqrt(variances.T if variances.ndim == 2 else variances[:, None])
