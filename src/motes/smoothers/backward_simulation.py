"""Backward simulation (Godsill, Doucet, West 2004): whole trajectories are drawn from filtered clouds, the last state first.

1. Draw the last state of each trajectory from the last cloud, by weight.
2. Going back, draw its state at t among the particles of the cloud at t: x_i with probability w_i p(x_{t+1} | x_i).
3. Mean and covariance at each step are those of the trajectories, all of equal weight.

Unlike a genealogy, a trajectory may change over to other ancestors at every step. Along directions without process noise a state is mapped,
not drawn: only the true ancestor leads to it, and the trajectory follows the genealogy there.
"""

from typing import Any

import jax
import jax.numpy as jnp

from motes.core import checks, logspace, random
from motes.core.record import record, static
from motes.filters.history import History
from motes.laws.cloud import Cloud, draw
from motes.models.state_space import StateSpaceModel, as_state_space, at_step
from motes.smoothers.interface import Smoothed, Smoother, Steps, ask_backward_density, ask_laws, summed_up
from motes.smoothers.parents import ExactParents, Move, Parents


@record
class BackwardSimulationSmoother(Smoother):
    """Backward simulation; it works with clouds. Without process noise in some direction it is no better than a genealogy.

    Source: Godsill, Doucet, West 2004, Monte Carlo smoothing for nonlinear time series.

    Example:
        >>> model = mo.textbook.growth()
        >>> xs, ys = mo.simulate(0, model, 50)
        >>> history = mo.run(1, mo.ParticleFilter(n=500), model, ys, keep=mo.keep.laws)
        >>> mo.smooth(2, mo.smoothers.BackwardSimulationSmoother(n=200), model, history).mean.shape
        (50, 1)

    Attributes:
        n: number of trajectories.
        parents: how a state's parent is drawn: `ExactParents()`, `RejectedParents()` or `SteppedParents()`.
    """

    n: int = static()
    parents: Parents = ExactParents()
    lost = ("states that the dynamics alone led to", "The filter moved them off what dynamics without noise in some direction allow "
            "(a kernel, an ensemble): smooth a ParticleFilter's clouds.")  # fmt: skip

    def check_parameters(self) -> None:
        """Check the parameters.

        Raises:
            MotesError: n is not a positive whole number, or parents is no rule for drawing them.
        """
        super().check_parameters()
        if not isinstance(self.parents, Parents):
            checks.refuse("BackwardSimulationSmoother parents", "a rule such as ExactParents()", type(self.parents).__name__)

    def prepare(self, model: Any, history: History, u: Any) -> StateSpaceModel:
        """Ask for clouds, and for dynamics with a density.

        Raises:
            MotesError: one is missing.
        """
        ask_laws("BackwardSimulationSmoother", history, Cloud)
        model = as_state_space("BackwardSimulationSmoother", model)
        ask_backward_density("BackwardSimulationSmoother", model, history.descends)
        self.parents.check(model.dynamics)
        return model

    def smooth(self, key: jax.Array, model: StateSpaceModel, history: History, steps: Steps) -> Smoothed:
        """Draw trajectories backward."""
        clouds: Cloud = history.law
        # 1. last states
        last = at_step(clouds, -1)
        chosen = draw(random.child(key, random.INITIAL), last.log_weights, self.n)

        # 2. going back
        def back(held: tuple[jax.Array, jax.Array], row: Any) -> tuple[tuple[jax.Array, jax.Array], jax.Array]:
            after, ancestors = held
            cloud, u, t = row
            parents, known = self.parents.draw(random.step_key(key, t), cloud, Move(model.dynamics, u, t), after, ancestors)
            before = jnp.where(known, cloud.particles[:, parents], jnp.nan)
            return (before, cloud.ancestors[parents]), before

        start = (last.particles[:, chosen], last.ancestors[chosen])
        rows = jax.tree.map(lambda leaf: leaf[:-1], clouds), *jax.tree.map(lambda leaf: leaf[1:], (steps.u, steps.t))
        _, earlier = jax.lax.scan(back, start, rows, reverse=True)
        # 3. moments
        paths = jnp.concatenate([earlier, start[0][None]])
        equal = logspace.uniform_weights(self.n, paths.dtype)
        mean, cov, probabilities = jax.vmap(lambda X: summed_up(equal, X, model.modes))(paths)
        return Smoothed(mean, cov, paths, equal, probabilities)
