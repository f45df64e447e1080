"""The law of the parameters of a state-space model given its measurements."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

from motes.core import checks, random, user_functions
from motes.core.record import record, replace, static
from motes.filters import keep
from motes.filters.data import checked_data
from motes.filters.interface import Filter
from motes.filters.run import run
from motes.laws.law import Law, as_law, drawn
from motes.models.state_space import StateSpaceModel


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
        example = user_functions.called(f"{type(self).__name__} model(theta)", model, law.sample(random.as_key(0), 1)[:, 0])
        measured, inputs = jax.tree.map(jnp.asarray, checked_data(example, ys, inputs))
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

    def log_likelihood(self, model: StateSpaceModel, X: jax.Array, u: Any, t: Any) -> jax.Array:
        """Return the log density of the measurement of step t at states `(x, n)`, `(n,)`: 0 where nothing was measured, -inf for NaN."""
        found = model.sensor.log_prob(self.ys[t], X, u, t)
        return jnp.where(jnp.all(jnp.isnan(self.ys[t])), 0.0, jnp.where(jnp.isnan(found), -jnp.inf, found))

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
        # a position where all weights vanish is an improbable one, not an error
        quiet = replace(self.filter, on_collapse="predict") if self.filter.on_collapse == "raise" else self.filter
        history = run(key, quiet, user_functions.called("Posterior model(theta)", self.model, theta), self.ys, self.inputs, keep.nothing)
        likelihood = jnp.where(jnp.any(history.info.collapsed), -jnp.inf, history.log_likelihood)
        # outside the prior the model need not make sense
        return jnp.where(jnp.isfinite(prior), prior + likelihood, -jnp.inf)
