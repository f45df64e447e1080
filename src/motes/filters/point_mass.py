"""Point-mass filter: Bayes' recursion on a grid of one or two dimensions (Bucy, Senne 1971); the exact answer other filters are held to.

1. Predict: each node's new weight is the sum over all nodes of weight times transition density.
2. Correct: multiply each weight by the likelihood of y, and normalize.

The predicted weights times the volume of a cell sum to one less what has left the grid. The law is that of a state on the grid, with
weights that sum to one; the likelihood counts what has left as explaining nothing, so that it is too small by no more than that explains.
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from motes.core import checks, logspace, pairs
from motes.core.record import record, replace, static
from motes.filters import alarm
from motes.filters.info import Info, weigh, with_innovation
from motes.filters.interface import Guide, TwoStageFilter
from motes.filters.needs import ask_density
from motes.filters.sharp import ask_full_noise, ask_noise
from motes.laws.cloud import Cloud
from motes.laws.conditional import AdditiveGaussian, matrix_over
from motes.laws.density import noiseless, slack
from motes.laws.gaussian import Gaussian
from motes.laws.grid_cloud import GridCloud
from motes.laws.switching import SwitchingDynamics
from motes.models.state_space import StateSpaceModel, as_state_space


@record
class PointMassFilter(TwoStageFilter[GridCloud]):
    """Point-mass filter; its state is a `GridCloud`, whose particles are the nodes of a fixed grid.

    The cost of a step grows with the square of the number of nodes. The grid must cover the state and be finer than the noise: the share of
    the probability that has left it, or that falls between its nodes, is counted in `info.lost`, and `run` warns of it. A step with
    no noise at all that leaves every node where it is (two measurements at one time, or states that never change) is exact; other steps
    without noise in some direction miss the nodes: they are refused, or collapse where they are met in the run alone.

    Source: Bucy, Senne 1971, Digital synthesis of non-linear filters.

    Example:
        >>> model = mo.textbook.growth()
        >>> xs, ys = mo.simulate(0, model, 50)
        >>> mo.run(1, mo.PointMassFilter(lower=(-30.0,), upper=(30.0,), nodes=(300,)), model, ys).mean.shape
        (50, 1)

    Attributes:
        lower: lower ends of the grid, one number per state, in the units of the state.
        upper: upper ends.
        nodes: numbers of nodes per state.
    """

    guide = Guide(
        needs="densities of initial law, dynamics and sensor; one or two states",
        cost="the square of the number of nodes",
        use="one or two states: the exact answer others are held to",
    )

    descends = False
    lower: tuple[float, ...] = static()
    upper: tuple[float, ...] = static()
    nodes: tuple[int, ...] = static()

    def check_parameters(self) -> None:
        """Check the grid.

        Raises:
            MotesError: lengths differ, an end is not below the other, or there are more than two states.
        """
        for name in ("lower", "upper", "nodes"):
            object.__setattr__(self, name, tuple(np.atleast_1d(getattr(self, name)).tolist()))
        if not len(self.lower) == len(self.upper) == len(self.nodes) or not 1 <= len(self.nodes) <= 2:
            given = f"{len(self.lower)}, {len(self.upper)} and {len(self.nodes)}"
            checks.refuse("PointMassFilter lower, upper, nodes", "one or two numbers each", given)
        if any(not low < high for low, high in zip(self.lower, self.upper, strict=True)):
            checks.refuse("PointMassFilter lower", "numbers below those of upper", f"{self.lower} and {self.upper}")
        for count in self.nodes:
            checks.positive_integer("PointMassFilter nodes", count)

    def prepare(self, model: Any, u: Any) -> StateSpaceModel:
        """Ask for densities of the initial law, the dynamics and the sensor, and for as many states as the grid has dimensions.

        Raises:
            MotesError: one is missing.
        """
        model = as_state_space("PointMassFilter", model)
        if model.size != len(self.nodes):
            checks.refuse("PointMassFilter nodes", f"{model.size} dimensions (states of the model)", len(self.nodes))
        for name in ("dynamics", "sensor"):
            ask_density(f"PointMassFilter {name}", getattr(model, name))
        if model.modes and tuple(axis[-1] for axis in (self.lower, self.upper, self.nodes)) != (0, max(model.modes - 1, 1), model.modes):
            wanted = f"0, {max(model.modes - 1, 1)} and {model.modes} for the mode (a node for each)"
            checks.refuse("PointMassFilter lower, upper, nodes", wanted, f"{self.lower[-1]}, {self.upper[-1]} and {self.nodes[-1]}")
        return model

    def grid(self, dtype: jnp.dtype) -> jax.Array:
        """Return the nodes, `(x, n)`."""
        axes = [np.linspace(low, high, count) for low, high, count in zip(self.lower, self.upper, self.nodes, strict=True)]
        return jnp.asarray(np.stack([axis.ravel() for axis in np.meshgrid(*axes, indexing="ij")]), dtype)

    def ask(self, model: Any, u: Any) -> None:
        """Refuse a sensor without noise, and dynamics whose noise misses some direction.

        Raises:
            MotesError: it has none in some component.
        """
        ask_noise(type(self).__name__, model)
        ask_full_noise(type(self).__name__, model)

    def _cell(self, model: StateSpaceModel) -> float:
        """Volume of a cell; along the number of a mode, of which there are probabilities and no densities, it counts as one."""
        axes = list(zip(self.lower, self.upper, self.nodes, strict=True))[: -1 if model.modes else None]
        return float(np.prod([(high - low) / max(count - 1, 1) for low, high, count in axes]))

    def _gridded(self, model: StateSpaceModel, state: GridCloud, density: jax.Array, exact: jax.Array | bool) -> GridCloud:
        """Weigh the nodes by a density `(n,)`, and count what the grid lacks of it; `exact` where nothing, though it is none."""
        log_weights, total = logspace.normalize(density)
        short = 1 - jnp.exp(total) * self._cell(model)
        lost = jnp.where((short > slack(short.dtype)) & ~jnp.asarray(exact), jnp.minimum(short, 1), 0)
        return replace(state, log_weights=log_weights, lost=lost, held=state.held * (1 - lost))

    def init(self, key: jax.Array, model: StateSpaceModel) -> GridCloud:
        """Weigh the nodes by the initial density."""
        nodes = Cloud.equal(self.grid(model.dtype))
        state = GridCloud(nodes.particles, nodes.log_weights, nodes.ancestors, jnp.zeros((), model.dtype), jnp.ones((), model.dtype))
        laws = getattr(model.initial, "laws", (model.initial,))
        exact = [jnp.any(noiseless(law.covariance)) for law in laws if isinstance(law, Gaussian)]
        return self._gridded(model, state, model.initial_log_prob(nodes.particles), jnp.any(jnp.array(exact, bool)))

    def predict(self, key: jax.Array, model: StateSpaceModel, state: GridCloud, u: Any, t: Any) -> GridCloud:
        """Sum over all transitions (step 1)."""
        points = state.particles

        def arriving(node: jax.Array) -> jax.Array:
            return jax.nn.logsumexp(model.dynamics.log_prob(node, points, u, t) + state.log_weights)

        weights = pairs.against_all(arriving, points.T, points.shape[-1])
        # dynamics without noise in some direction miss the nodes
        parts, states = [(model.dynamics, u)], points
        if isinstance(model.dynamics, SwitchingDynamics):
            parts, states = model.dynamics.of_modes(u), points[:-1]
        found = [_noise_gaps(part, states, seen, t) for part, seen in parts if isinstance(part, AdditiveGaussian)]
        missing, still = (jnp.stack(each) for each in zip(*found, strict=True)) if found else (jnp.zeros(1, bool),) * 2
        misses = jnp.any(missing) & ~(jnp.all(still) & (len(found) == len(parts)))
        return self._gridded(model, state, jnp.where(misses, jnp.nan, weights), jnp.any(missing))

    def correct(
        self, key: jax.Array, model: StateSpaceModel, state: GridCloud, y: jax.Array, u: Any, t: Any
    ) -> tuple[GridCloud, Info]:
        """Weigh the nodes by the likelihood of y; what has left the grid explains nothing of it (step 2)."""
        log_likelihood = model.sensor.log_prob(y, state.particles, u, t)
        weights, info = weigh(state.log_weights, log_likelihood, model.sensor.max_log_prob(y, state.particles, u, t))
        found = alarm.of_cloud(key, model.sensor, state.particles, state.log_weights, y, u, t)
        info = replace(with_innovation(info, found), log_evidence=info.log_evidence + jnp.log(state.held), lost=state.lost)
        return replace(state, log_weights=weights, held=jnp.ones_like(state.held)), info


def _noise_gaps(dynamics: AdditiveGaussian, points: jax.Array, u: Any, t: Any) -> tuple[jax.Array, jax.Array]:
    """Tell whether a step has no noise in some direction, and whether it has none at all and leaves the nodes `(x, n)` where they are."""
    without = noiseless(matrix_over(dynamics.Q, points, u, t))
    still = jnp.max(jnp.abs(dynamics.means(points, u, t) - points)) <= slack(points.dtype) * jnp.max(jnp.abs(points))
    return jnp.any(without), jnp.all(without) & still
