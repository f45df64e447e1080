"""Rao-Blackwellized backward simulation (Fong, Godsill, Doucet, West 2002; Lindsten, Schon 2013), after a marginalized particle filter.

1. Draw a particle of the last cloud by weight, and x_k from its Gaussian.
2. Going back, take a particle with probability in proportion to w_i N(x'; f + A l_i, A P_i A' + Q), where x' = (x_p', x_k') is the state
   drawn at the next step, and l_i, P_i are mean and covariance of x_k given the particle.
3. Condition its Gaussian on x', and draw x_k from it.
4. Mean and covariance are those of the conditioned Gaussians, not of the draws, so that less of them is left to chance.
"""

from typing import Any

import jax
import jax.numpy as jnp

from motes.core import linalg, logspace, pairs, random
from motes.core.record import record, replace, static
from motes.filters.history import History
from motes.laws.circular import wrap
from motes.laws.cloud import draw, pick
from motes.laws.density import log_normal, noiseless
from motes.laws.gaussian import Gaussian
from motes.laws.marginal_cloud import MarginalCloud
from motes.models.split import SplitModel, split
from motes.models.state_space import at_step
from motes.smoothers.interface import Smoothed, Smoother, Steps, ask_laws


@record
class RaoBlackwellizedSmoother(Smoother):
    """Rao-Blackwellized backward simulation; it works with marginal clouds.

    Along directions in which neither process noise nor the Gaussians leave anything open a trajectory follows the genealogy.

    Source: Fong, Godsill, Doucet, West 2002, Monte Carlo smoothing with application to audio signal enhancement; Lindsten, Schon 2013,
    Backward simulation methods for Monte Carlo statistical inference.

    Example:
        >>> model = mo.textbook.radar_tracking()
        >>> xs, ys = mo.simulate(0, model, 50)
        >>> history = mo.run(1, mo.MarginalizedParticleFilter(n=200), model, ys, keep=mo.keep.laws)
        >>> mo.smooth(2, mo.smoothers.RaoBlackwellizedSmoother(n=100), model, history).mean.shape
        (50, 6)

    Attributes:
        n: number of trajectories.
    """

    n: int = static()

    def prepare(self, model: Any, history: History, u: Any) -> SplitModel:
        """Split the model as the filter did.

        Raises:
            MotesError: the history has no marginal clouds, or the model does not split so.
        """
        ask_laws("RaoBlackwellizedSmoother", history, MarginalCloud)
        state: MarginalCloud = history.state
        own = state.particles.shape[0]
        return split(model, tuple(i for i, place in enumerate(state.order) if place >= own), u)

    def smooth(self, key: jax.Array, model: SplitModel, history: History, steps: Steps) -> Smoothed:
        """Draw trajectories of both parts backward."""
        clouds: MarginalCloud = history.law
        # 1. last particle
        last: MarginalCloud = at_step(clouds, -1)
        opening = random.step_key(key, steps.t[-1])
        chosen = last.resampled(draw(random.child(opening, random.RESAMPLE), last.log_weights, self.n))

        def back(held: tuple[jax.Array, jax.Array], row: Any) -> tuple[tuple[jax.Array, jax.Array], tuple[jax.Array, MarginalCloud]]:
            (after, ancestors), (cloud, u, t, t_after) = held, row
            step_key = random.step_key(key, t)
            # 2. particle; 3. condition and draw
            chosen = self._conditioned(random.child(step_key, random.RESAMPLE), model, cloud, (after, ancestors), u, t_after)
            states = self._drawn(random.child(step_key, random.NOISE), chosen)
            return (states, cloud.ancestors[chosen.ancestors]), (states, chosen)

        start = self._drawn(random.child(opening, random.NOISE), chosen)
        rows = jax.tree.map(lambda leaf: leaf[:-1], clouds), jax.tree.map(lambda leaf: leaf[1:], steps.u), steps.t[:-1], steps.t[1:]
        _, earlier = jax.lax.scan(back, (start, last.ancestors[chosen.ancestors]), rows, reverse=True)
        full = replace(chosen, kalman=_each(chosen.kalman, self.n))
        paths, laws = jax.tree.map(lambda some, one: jnp.concatenate([some, one[None]]), earlier, (start, full))
        # 4. moments
        mean, cov = jax.vmap(lambda law: (law.mean(), law.cov()))(laws)
        return Smoothed(mean, cov, linalg.take(paths, last.order, axis=1), logspace.uniform_weights(self.n, mean.dtype))

    def _drawn(self, key: jax.Array, cloud: MarginalCloud) -> jax.Array:
        """One draw of (x_p, x_k) for each particle."""
        return jnp.concatenate([cloud.particles, cloud.kalman.sample(key, self.n)])

    def _conditioned(
        self, key: jax.Array, model: SplitModel, cloud: MarginalCloud, held: tuple[jax.Array, jax.Array], u: Any, t: Any
    ) -> MarginalCloud:
        """Draw a particle for each of the states `(x_p + x_k, m)` that follow, and condition its Gaussian on what follows.

        `held` are these states and the particle that each came from, which is taken where none has a density.
        """
        (after, _), (f, A, Q) = held, _stacked(model, cloud.particles, u, t)
        expected, exact = cloud.kalman.through(A, f, Q), noiseless(Q)
        points = random.uniform(key, (self.n,), f.dtype)
        size = jnp.maximum(jnp.max(jnp.abs(after), axis=1), jnp.max(jnp.abs(expected.center), axis=1))

        # 2. draw the particle
        def parent(row: tuple[jax.Array, ...]) -> jax.Array:
            state, ancestor, point = row
            density = log_normal(wrap(state[:, None] - expected.center, model.places), expected.covariance, None, size, exact)
            weights, total = logspace.normalize(cloud.log_weights + density)
            return jnp.where(jnp.isfinite(total), pick(jnp.exp(weights), point), ancestor)

        parents = pairs.against_all(parent, (after.T, *held[1:], points), cloud.log_weights.shape[0])
        chosen = cloud.resampled(parents)
        f, A, Q, prediction = (leaf[..., parents] if batched else leaf for leaf, batched in (
            (f, True), (A, A.ndim == 3), (Q, Q.ndim == 3), (expected.center, True)))  # fmt: skip
        # 3. condition
        conditioned = chosen.kalman.corrected(wrap(after - prediction, model.places), A, Q).law
        return replace(chosen, kalman=_each(conditioned, self.n))


def _each(laws: Gaussian, n: int) -> Gaussian:
    """Give each law a covariance of its own."""
    cov = laws.covariance
    return laws if cov.ndim == 3 else Gaussian(laws.center, jnp.broadcast_to(cov[..., None], (*cov.shape, n)))


def _stacked(model: SplitModel, X_p: jax.Array, u: Any, t: Any) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Dynamics of both parts as one: (x_p, x_k)' = f + A x_k + noise of covariance Q."""
    example = X_p[:, 0]
    of_p, of_k = (model.over(part, X_p, example, u, t) for part in ("particle", "kalman"))
    cross = model.cross_cov(X_p, example, u, t)
    f = jnp.concatenate([of_p.f, of_k.f])
    A = _blocks([[of_p.A], [of_k.A]])
    nothing = jnp.zeros((of_p.f.shape[0], of_k.f.shape[0]), f.dtype)
    cross = nothing if cross is None else cross
    return f, A, _blocks([[of_p.Q, cross], [linalg.transpose(cross), of_k.Q]])


def _blocks(rows: list[list[jax.Array]]) -> jax.Array:
    """Put blocks together, some with a particle axis and some without."""
    n = max((block.shape[2] for row in rows for block in row if block.ndim == 3), default=0)
    if n:
        rows = [[block if block.ndim == 3 else jnp.broadcast_to(block[..., None], (*block.shape, n)) for block in row] for row in rows]
    return jnp.concatenate([jnp.concatenate(row, axis=1) for row in rows])
