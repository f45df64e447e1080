"""Parameters and path of a state-space model as one position, and the contract of kernels that draw the path."""

from abc import abstractmethod
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

from motes.core import checks, random
from motes.core.loop import loop, with_first
from motes.core.record import record
from motes.mcmc.interface import Info, Kernel, Position, State
from motes.models.state_space import StateSpaceModel, as_state_space, at_step
from motes.parameters.posterior import Parametric
from motes.smoothers.parents import Move


@record
class PathPosterior(Parametric):
    """Log density of parameters and path together; positions are {"theta": `(p,)`, "path": `(t, x)`}."""

    def __init__(self, prior: Any, model: Callable[[jax.Array], Any], ys: Any, inputs: Any = None):
        """Check that the parts fit each other; see `Parametric`."""
        Parametric.__init__(self, prior, model, ys, inputs)

    def at(self, theta: jax.Array) -> tuple[StateSpaceModel, Any]:
        """Return the model of these parameters, its noises independent, and the inputs of its steps."""
        model, drive = as_state_space("PathPosterior", self.model(theta)).independent()
        return model, drive.over(self.inputs, self.ys)

    def __call__(self, position: dict[str, jax.Array]) -> jax.Array:
        """Return log p(theta) + log p(path | theta) + log p(ys | path, theta)."""
        theta, path = position["theta"], position["path"]
        model, inputs = self.at(theta)

        def moved(t: jax.Array) -> jax.Array:
            return Move(model.dynamics, at_step(inputs, t), t).among(path.T).log_prob(path[t][:, None], path[t - 1][:, None])[0]

        def measured(t: jax.Array) -> jax.Array:
            return self.log_likelihood(model, path[t][:, None], at_step(inputs, t), t)[0]

        steps = jnp.arange(path.shape[0], dtype=jnp.int32)
        total = model.initial_log_prob(path[0]) + jnp.sum(jax.vmap(moved)(steps[1:])) + jnp.sum(jax.vmap(measured)(steps))
        prior = self.prior.log_prob(theta)
        return jnp.where(jnp.isfinite(prior), prior + total, -jnp.inf)

    def start(self, key: jax.Array) -> dict[str, jax.Array]:
        """Draw parameters from the prior and a path from the model."""
        theta = self.starts(random.child(key, random.INITIAL))
        model, inputs = self.at(theta)
        first = model.initial.sample(random.child(key, random.WORLD), 1)

        def ahead(x: jax.Array, t: jax.Array) -> tuple[jax.Array, jax.Array]:
            x = model.dynamics.sample(random.step_key(key, t), x, at_step(inputs, t), t)
            return x, x[:, 0]

        _, rest = loop(ahead, first, jnp.arange(1, self.ys.shape[0], dtype=jnp.int32))
        return {"theta": theta, "path": with_first(first[:, 0], rest)}


class DrawsPaths(Kernel):
    """A kernel that draws the path of a `PathPosterior` given its parameters; subclasses write `path`."""

    def asked(self, log_density: Any) -> PathPosterior:
        """Return the posterior.

        Raises:
            MotesError: it is no posterior of parameters and path.
        """
        return checks.instance(f"{type(self).__name__} log_density", log_density, PathPosterior, "a mo.parameters.PathPosterior")

    @abstractmethod
    def path(self, key: jax.Array, posterior: PathPosterior, position: Position) -> jax.Array:
        """Draw a path `(t, x)` given parameters and another path, with the path's law left as it is."""

    def step(self, key: jax.Array, log_density: Any, state: State, t: Any) -> tuple[State, Info]:
        """Draw a new path."""
        old = state.position["path"]
        path = self.path(key, log_density, state.position)
        position = {**state.position, "path": path}
        # at how many steps the state that changes least often has changed: the share that tells how well it mixes
        changed = jnp.min(jnp.mean(path != old, axis=0, dtype=jnp.result_type(float)))
        return State(position, log_density(position)), Info.of_one(changed)
