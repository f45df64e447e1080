"""The law of the parameters of a state-space model given its measurements."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

from motes.core import checks, random
from motes.core.record import record, static
from motes.filters import keep
from motes.filters.interface import Filter, as_state_space
from motes.filters.run import checked_measurements, run
from motes.laws.law import Law, as_law, drawn
from motes.models.state_space import StateSpaceModel, at_step


@record
class Parametric:
    """What all posteriors share: a prior, a model for each value of the parameters, measurements.

    Attributes:
        prior: law of the parameters `(p,)`; a parameter that must be positive is best given by its logarithm.
        model: function of the parameters that returns a model.
        ys: measurements `(t, y)`.
        inputs: of the model, with the time axis first, or None.
    """

    prior: Law
    model: Callable[[jax.Array], Any] = static()
    ys: jax.Array
    inputs: Any

    def __init__(self, prior: Any, model: Callable[[jax.Array], Any], ys: Any, inputs: Any = None):
        """Check that the model fits the measurements at a draw of the prior.

        Raises:
            MotesError: naming what does not fit.
        """
        law = as_law(f"{type(self).__name__} prior", prior)
        if not callable(model):
            checks.refuse(f"{type(self).__name__} model", "a function of the parameters that returns a model", type(model).__name__)
        example = model(law.sample(random.as_key(0), 1)[:, 0])
        measured = jnp.asarray(checked_measurements(example, ys, inputs))
        for name, value in (("prior", law), ("model", model), ("ys", measured), ("inputs", inputs)):
            object.__setattr__(self, name, value)

    @property
    def size(self) -> int:
        """Number of parameters."""
        return drawn(self.prior).shape[0]

    @property
    def steps(self) -> int:
        """Number of measurements."""
        return self.ys.shape[0]

    def starts(self, key: jax.Array) -> jax.Array:
        """Draw parameters `(p,)` from the prior: for `init` of `mo.sample`."""
        return self.prior.sample(key, 1)[:, 0]


@record
class Posterior(Parametric):
    """Log prior plus log likelihood by a filter: exact with a Kalman or a point-mass filter, an estimate with a particle filter.

    Called with parameters it uses the same random numbers each time; `estimate` takes a key. Differentiable where the filter is.

    Attributes:
        prior: see `Parametric`.
        model: likewise.
        ys: likewise.
        inputs: likewise.
        filter: whose likelihood is taken.
    """

    filter: Filter

    def __init__(self, prior: Any, model: Callable[[jax.Array], Any], filter: Filter, ys: Any, inputs: Any = None):
        """Check that the parts fit each other.

        Raises:
            MotesError: naming what does not fit.
        """
        Parametric.__init__(self, prior, model, ys, inputs)
        if not isinstance(filter, Filter) or not filter.has_evidence:
            checks.refuse("Posterior filter", "a filter with a likelihood, such as ParticleFilter(n=200)", type(filter).__name__)
        object.__setattr__(self, "filter", filter)

    def __call__(self, theta: jax.Array) -> jax.Array:
        """Return the log density at parameters `(p,)`, up to a constant, with fixed random numbers."""
        return self.estimate(random.as_key(0), theta)

    def estimate(self, key: jax.Array, theta: jax.Array) -> jax.Array:
        """Return log prior plus an estimate of the log likelihood; -inf where no particle explains a measurement.

        Args:
            key: of the run, or one for each step `(t,)`.
            theta: parameters `(p,)`.
        """
        prior = self.prior.log_prob(theta)
        history = run(key, self.filter, self.model(theta), self.ys, self.inputs, keep.nothing)
        likelihood = jnp.where(jnp.any(history.info.collapsed), -jnp.inf, history.log_likelihood)
        # outside the prior the model need not make sense
        return jnp.where(jnp.isfinite(prior), prior + likelihood, -jnp.inf)


@record
class PathPosterior(Parametric):
    """Log density of parameters and path together; positions are {"theta": `(p,)`, "path": `(t, x)`}."""

    def __init__(self, prior: Any, model: Callable[[jax.Array], Any], ys: Any, inputs: Any = None):
        """Check that the parts fit each other; see `Parametric`."""
        Parametric.__init__(self, prior, model, ys, inputs)

    def __call__(self, position: dict[str, jax.Array]) -> jax.Array:
        """Return log p(theta) + log p(path | theta) + log p(ys | path, theta)."""
        theta, path = position["theta"], position["path"]
        model: StateSpaceModel = as_state_space("PathPosterior", self.model(theta))

        def moved(t: jax.Array) -> jax.Array:
            return model.dynamics.log_prob(path[t][:, None], path[t - 1][:, None], at_step(self.inputs, t), t)[0]

        def measured(t: jax.Array) -> jax.Array:
            return model.sensor.log_prob(self.ys[t], path[t][:, None], at_step(self.inputs, t), t)[0]

        steps = jnp.arange(path.shape[0], dtype=jnp.int32)
        total = model.initial.log_prob(path[0]) + jnp.sum(jax.vmap(moved)(steps[1:])) + jnp.sum(jax.vmap(measured)(steps))
        prior = self.prior.log_prob(theta)
        return jnp.where(jnp.isfinite(prior), prior + total, -jnp.inf)

    def start(self, key: jax.Array) -> dict[str, jax.Array]:
        """Draw parameters from the prior and a path from the model."""
        theta = self.starts(random.child(key, random.INITIAL))
        model = as_state_space("PathPosterior", self.model(theta))
        first = model.initial.sample(random.child(key, random.WORLD), 1)

        def ahead(x: jax.Array, t: jax.Array) -> tuple[jax.Array, jax.Array]:
            x = model.dynamics.sample(random.step_key(key, t), x, at_step(self.inputs, t), t)
            return x, x[:, 0]

        _, rest = jax.lax.scan(ahead, first, jnp.arange(1, self.ys.shape[0], dtype=jnp.int32))
        return {"theta": theta, "path": jnp.concatenate([first.T, rest])}
