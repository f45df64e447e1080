"""Two-filter smoother (Briers, Doucet, Maskell 2010): the filter, and a second one that takes the measurements from the last to the first.

The second filter is after p(y_t .. y_T | x_t), which need not be a density of x_t; times g_t, a Gaussian about the filtered law, it is one.

1. Draw points z_k at each step from g_t, a Gaussian about the filtered law.
2. From the last step to the first, weigh them by v_k = p(y_t | z_k) sum_j v'_j p(z'_j | z_k) / g_{t+1}(z'_j), primes for the next step.
3. Predict: p(z_k | y_0 .. y_{t-1}) is a sum over the particles of the filter at t - 1.
4. The smoothed law has the weights v_k p(z_k | y_0 .. y_{t-1}) / g_t(z_k).
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

from motes.core import checks, logspace, pairs, random
from motes.core.record import record, static
from motes.filters.history import History
from motes.filters.needs import as_particle_model
from motes.laws.cloud import Cloud, weighted_moments
from motes.laws.conditional import AdditiveGaussian, matrix_over
from motes.laws.density import noiseless
from motes.laws.gaussian import Gaussian
from motes.laws.observed import is_nothing
from motes.models.state_space import StateSpaceModel
from motes.smoothers.interface import Smoothed, Smoother, Steps, ask_backward_density, ask_laws
from motes.smoothers.parents import Move


@record
class TwoFilterSmoother(Smoother):
    """Two-filter smoother; it works with clouds, looks at the measurements, and takes some n^2 densities per step.

    Source: Briers, Doucet, Maskell 2010, Smoothing algorithms for state-space models.

    Example:
        >>> model = mo.textbook.growth()
        >>> xs, ys = mo.simulate(0, model, 50)
        >>> history = mo.run(1, mo.ParticleFilter(n=200), model, ys, keep=mo.keep.laws)
        >>> mo.smooth(2, mo.smoothers.TwoFilterSmoother(n=200), model, history, ys).mean.shape
        (50, 1)

    Attributes:
        n: number of points of the second filter.
        inflation: factor on the filtered covariance for the law g from which the points come, at least 1.
    """

    n: int = static()
    inflation: float = 1.5
    lost = ("dynamics with noise in every direction", "Without it points of the second filter lead to none of the next step: "
            "use BackwardSimulationSmoother, or run a KalmanFilter where the model is linear.")  # fmt: skip

    def check_parameters(self) -> None:
        """Check the parameters.

        Raises:
            MotesError: n is not a positive whole number, or the inflation is below 1.
        """
        super().check_parameters()
        if checks.is_concrete(self.inflation) and not self.inflation >= 1:
            checks.refuse("TwoFilterSmoother inflation", "a factor of at least 1", self.inflation)

    def prepare(self, model: Any, history: History, u: Any) -> StateSpaceModel:
        """Ask for clouds and for densities of dynamics, sensor and initial law.

        Raises:
            MotesError: one is missing.
        """
        ask_laws("TwoFilterSmoother", history, Cloud)
        model = as_particle_model("TwoFilterSmoother", model, transition_density=False)
        ask_backward_density("TwoFilterSmoother", model, history.descends)
        if model.modes:
            checks.refuse("TwoFilterSmoother model", "states that a Gaussian can have (points are drawn from one)", "the number of a mode",
                          "Use BackwardSimulationSmoother.")
        return model

    def smooth(self, key: jax.Array, model: StateSpaceModel, history: History, steps: Steps) -> Smoothed:
        """Run the second filter and bring both together at each step."""
        if steps.y is None:
            checks.refuse("TwoFilterSmoother ys", "the measurements of the run (t, y)", "None", "Give them to smooth.")
        clouds: Cloud = history.law
        # 1. points
        g = jax.vmap(lambda cloud: Gaussian(cloud.mean(), self.inflation * cloud.cov()))(clouds)
        points = jax.vmap(lambda law, t: law.sample(random.step_key(key, t), self.n))(g, steps.t)
        log_g = jax.vmap(Gaussian.log_prob)(g, points)
        # 2. second filter
        log_likelihood = jax.vmap(lambda z, row: _log_likelihood(model, z, row))(points, steps)
        before, after = (jax.tree.map(lambda leaf, cut=cut: leaf[cut], (points, log_g, steps)) for cut in (slice(None, -1), slice(1, None)))

        def back(log_v: jax.Array, row: Any) -> tuple[jax.Array, jax.Array]:
            (z, _, _), (z_after, log_g_after, step), log_likelihood = row
            move = Move(model.dynamics, step.u, step.t)
            ahead = _log_sum(lambda one: move.log_prob(z_after, jnp.broadcast_to(one[:, None], z_after.shape)), log_v - log_g_after, z)
            weights = logspace.normalize(jnp.where(_spreads_everywhere(move, z), log_likelihood + ahead, jnp.nan))[0]
            return weights, weights

        last = logspace.normalize(log_likelihood[-1])[0]
        _, earlier = jax.lax.scan(back, last, (before, after, log_likelihood[:-1]), reverse=True)

        # 3. predicted densities
        def arriving(row: Any) -> jax.Array:
            cloud, (z, _, step) = row
            return _log_sum(lambda one: Move(model.dynamics, step.u, step.t).log_prob(one, cloud.particles), cloud.log_weights, z)

        predicted = jax.lax.map(arriving, (jax.tree.map(lambda leaf: leaf[:-1], clouds), after))
        predicted = jnp.concatenate([model.initial_log_prob(points[0])[None], predicted])
        # 4. smoothed weights
        weights = jnp.concatenate([earlier, last[None]]) + predicted - log_g
        return Smoothed(*jax.vmap(lambda w, z: weighted_moments(logspace.normalize(w)[0], z))(weights, points))


def _spreads_everywhere(move: Move, z: jax.Array) -> jax.Array | bool:
    """Tell whether the dynamics have noise in every direction, from all of the points z `(x, n)`; where it is not known, yes."""
    if not isinstance(move.dynamics, AdditiveGaussian):
        return True
    return ~jnp.any(noiseless(matrix_over(move.dynamics.Q, z, move.u, move.t)))


def _log_likelihood(model: StateSpaceModel, z: jax.Array, row: Steps) -> jax.Array:
    assert row.y is not None
    return jnp.where(is_nothing(row.y), 0, model.sensor.log_prob(row.y, z, row.u, row.t))


def _log_sum(log_prob: Callable[[jax.Array], jax.Array], log_weights: jax.Array, z: jax.Array) -> jax.Array:
    """Log of the weighted sum of densities, from each of the points z `(x, n)`."""
    return pairs.against_all(lambda one: jax.nn.logsumexp(log_prob(one) + log_weights), z.T, log_weights.shape[0])
