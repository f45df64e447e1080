"""Gaussian particle filter (Kotecha, Djuric 2003 I; Djuric 2004): particles carry a Gaussian over each step, nothing resamples.

1. Draw particles from the Gaussian of the step before and move them by the dynamics; with `redraw`, keep only their mean and covariance.
2. Weigh particles, the moved ones or with `redraw` new ones from the predicted Gaussian, by p(y | x).
3. Their weighted mean and covariance are the new Gaussian.
"""

from typing import Any

import jax
import jax.numpy as jnp

from motes.core import checks, logspace, random
from motes.core.record import record, replace, static
from motes.filters import alarm
from motes.filters.gated import Gated
from motes.filters.info import Info, weigh, with_innovation
from motes.filters.interface import Guide, TwoStageFilter
from motes.filters.look_ahead import Ahead, LookAheadFilter
from motes.filters.needs import as_particle_model
from motes.filters.sharp import ask_noise
from motes.laws.circular import gathered
from motes.laws.cloud import weighted_moments
from motes.laws.gaussian import Gaussian
from motes.models.state_space import StateSpaceModel


@record
class GaussianParticleFilter(Gated, LookAheadFilter[Gaussian], TwoStageFilter[Gaussian]):
    """Gaussian particle filter; its state is a `Gaussian`. It converges to the true posterior only where that is Gaussian.

    Source: Kotecha, Djuric 2003, Gaussian particle filtering.

    Example:
        >>> model = mo.textbook.radar_tracking()
        >>> xs, ys = mo.simulate(0, model, 50)
        >>> mo.run(1, mo.GaussianParticleFilter(n=1000), model, ys).mean.shape
        (50, 6)

    Attributes:
        n: number of particles.
        redraw: weigh new draws from the predicted Gaussian (the general form); otherwise the moved particles themselves, which spares
            half of the draws and keeps the shape of the prediction (Djuric 2004, steps 1 to 5), but moves only when y is known.
    """

    starves = True
    guide = Guide(
        needs="dynamics that can be drawn from, a sensor with a density",
        cost="n calls of each function, no resampling",
        use="one mode with noises of any law",
    )

    n: int = static()
    redraw: bool = static(default=True)

    def check_parameters(self) -> None:
        """Check the parameters.

        Raises:
            MotesError: n is not a positive whole number.
        """
        checks.positive_integer("GaussianParticleFilter n", self.n)

    @property
    def look_ahead(self) -> bool:  # type: ignore[override]
        """Moved particles that are to be weighed themselves are not kept from step to step."""
        return not self.redraw

    def prepare(self, model: Any, u: Any) -> StateSpaceModel:
        """Ask for dynamics that can be drawn from and a sensor with a density.

        Raises:
            MotesError: one is missing.
        """
        return as_particle_model("GaussianParticleFilter", model, transition_density=False)

    def ask(self, model: Any, u: Any) -> None:
        """Refuse a sensor without noise.

        Raises:
            MotesError: it has none in some component.
        """
        ask_noise(type(self).__name__, model)

    def init(self, key: jax.Array, model: StateSpaceModel) -> Gaussian:
        """Return the Gaussian with the moments of the initial law."""
        return Gaussian(model.initial.mean(), model.initial.cov())

    def _moved(self, key: jax.Array, model: StateSpaceModel, state: Gaussian, u: Any, t: Any) -> jax.Array:
        X = state.sample(random.child(key, random.INITIAL), self.n)
        return model.dynamics.sample(random.child(key, random.NOISE), X, u, t)

    def _predicted(self, model: StateSpaceModel, X: jax.Array) -> Gaussian:
        return _fitted(model, logspace.uniform_weights(self.n, X.dtype), X)

    def _corrected(self, key: jax.Array, model: StateSpaceModel, X: jax.Array, y: jax.Array, u: Any, t: Any) -> tuple[Gaussian, Info]:
        log_likelihood, max_log_likelihood = model.sensor.log_prob(y, X, u, t), model.sensor.max_log_prob(y, X, u, t)
        weights, info = weigh(logspace.uniform_weights(self.n, X.dtype), log_likelihood, max_log_likelihood)
        some = X[:, alarm.some_of(self.n)]
        info = with_innovation(info, alarm.of_cloud(key, model.sensor, some, jnp.zeros_like(some[0]), y, u, t))
        # after a collapse the next particles are drawn anew, all of equal weight
        return _fitted(model, weights, X), replace(info, ess=jnp.where(info.collapsed, self.n, info.ess))

    def predict(self, key: jax.Array, model: StateSpaceModel, state: Gaussian, u: Any, t: Any) -> Gaussian:
        """Draw particles, move them, keep their moments (step 1)."""
        return self._predicted(model, self._moved(key, model, state, u, t))

    def correct(self, key: jax.Array, model: StateSpaceModel, state: Gaussian, y: jax.Array, u: Any, t: Any) -> tuple[Gaussian, Info]:
        """Draw particles, weigh them by the likelihood of y, keep their moments (steps 2 and 3)."""
        return self._corrected(key, model, state.sample(key, self.n), y, u, t)

    def ahead(self, key: jax.Array, model: StateSpaceModel, state: Gaussian, y: jax.Array, u: Any, t: Any) -> Ahead:
        """Draw particles, move them and weigh them themselves (steps 1 to 3)."""
        X = self._moved(random.child(key, random.PREDICT), model, state, u, t)
        after, info = self._corrected(random.child(key, random.UPDATE), model, X, y, u, t)
        return Ahead(after, info, lambda: self._predicted(model, X))


def _fitted(model: StateSpaceModel, log_weights: jax.Array, X: jax.Array) -> Gaussian:
    """Return the Gaussian with the moments of weighted particles `(x, n)`."""
    return Gaussian(*weighted_moments(log_weights, gathered(X, log_weights, model.circular)))
