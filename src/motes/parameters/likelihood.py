"""The log likelihood of parameters by a filter, in float64 whatever the session works in, with its slope and curvature.

A maximum is found by differences of log likelihoods: of a thousand nats float32 leaves four digits behind the point, and none of the
curvature.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from motes.core import checks, engine, user_functions
from motes.core.record import record, replace, static
from motes.core.types import Inputs
from motes.filters import keep
from motes.filters.data import checked_data, steps_of
from motes.filters.interface import Filter
from motes.filters.kalman import KalmanFilter
from motes.filters.needs import as_linear_model
from motes.filters.particle import ParticleFilter
from motes.filters.run import run
from motes.models.canonical import one_of
from motes.models.interface import Model
from motes.models.times import parted
from motes.parameters.named import Parameters
from motes.resampling.differentiable import StopGradient
from motes.tracing.compiling import jitted
from motes.tracing.identity import Beside

FEW = 8
"""Up to so many parameters derivatives are taken forward: in half the time to compile, and with no memory of the steps."""


class Series(NamedTuple):
    """Some sequences of one length.

    Attributes:
        ys: measurements with the axes sequence and time first.
        inputs: likewise, or None.
    """

    ys: Any
    inputs: Inputs


@record
class Likelihood:
    """A log likelihood as a function of coordinates.

    Attributes:
        parameters: their form.
        model_of: the user's function.
        filter: whose likelihood is taken.
        series: all sequences.
        burn: steps at the beginning of each that do not count.
    """

    parameters: Parameters
    model_of: Callable[[Any], Any] = static()
    filter: Filter
    series: tuple[Series, ...]
    burn: int = static()

    @property
    def steps(self) -> int:
        """Number of steps at which something was measured, without those that do not count."""
        count = 0
        for leaf in (np.asarray(jax.tree.leaves(one.ys)[0])[:, self.burn :] for one in self.series):
            rows = leaf.reshape(*leaf.shape[:2], -1)
            count += int(np.any(~np.isnan(rows) if rows.dtype.kind == "f" else np.ones_like(rows, bool), axis=2).sum())
        return count

    def at(self, z: jax.Array) -> Model:
        """Return the model at coordinates `(p,)`, in double precision."""
        return model_at(self.model_of, self.parameters.given(self.parameters.natural(z)))

    def __call__(self, key: jax.Array, z: jax.Array) -> jax.Array:
        """Return the log likelihood at coordinates `(p,)`; minus infinity where nothing explains a measurement."""
        model = self.at(z)

        def of_one(ys: Any, inputs: Inputs) -> jax.Array:
            info = run(key, self.filter, model, ys, inputs, keep.nothing).info
            return jnp.where(jnp.any(info.collapsed), -jnp.inf, jnp.sum(info.log_evidence[self.burn :]))

        total = jnp.zeros((), jnp.float64)
        for ys, inputs in self.series:
            if jax.tree.leaves(ys)[0].shape[0] == 1:
                total += of_one(*jax.tree.map(lambda leaf: leaf[0], (ys, inputs)))
            else:
                # a native kernel inside another's vmap loses its derivative
                with engine.using("jax"):
                    total += jnp.sum(jax.vmap(of_one)(ys, inputs))
        return total


def model_at(model_of: Callable[[Any], Any], theta: Any) -> Model:
    """Return the model of parameters, its arrays in double precision.

    Raises:
        MotesError: the function fails, or returns no model.
    """
    found = user_functions.called("fit model_of(parameters)", model_of, theta)
    return in_double(checks.instance("fit model_of(parameters)", found, Model, "a model such as mo.StateSpaceModel"))  # type: ignore[type-abstract]


def in_double(tree: Any) -> Any:
    """Return a tree with all real numbers in float64."""
    return jax.tree.map(lambda leaf: jnp.asarray(leaf, jnp.float64) if jnp.issubdtype(jnp.result_type(leaf), jnp.floating) else leaf, tree)


def _averaged(keys: jax.Array, given: Likelihood, z: jax.Array) -> jax.Array:
    return given(keys[0], z) if keys.shape[0] == 1 else jnp.mean(jax.lax.map(lambda key: given(key, z), keys))


@jitted
def heights(keys: jax.Array, given: Likelihood, z: jax.Array, beside: Beside) -> jax.Array:
    """Return the log likelihood by each of several keys, `(k,)`."""
    return jax.lax.map(lambda key: given(key, z), keys)


@jitted
def height(keys: jax.Array, given: Likelihood, z: jax.Array, beside: Beside) -> jax.Array:
    """Return the log likelihood, averaged over keys `(k,)`."""
    return _averaged(keys, given, z)


@jitted
def slope(keys: jax.Array, given: Likelihood, z: jax.Array, beside: Beside) -> tuple[jax.Array, jax.Array]:
    """Return the log likelihood, averaged over keys `(k,)`, and its slope `(p,)`."""
    if z.size > FEW:
        return jax.value_and_grad(lambda z: _averaged(keys, given, z))(z)
    up, found = jax.jacfwd(lambda z: (_averaged(keys, given, z),) * 2, has_aux=True)(z)
    return found, up


@jitted
def curvature(keys: jax.Array, given: Likelihood, z: jax.Array, beside: Beside) -> jax.Array:
    """Return the second derivatives `(p, p)` of the log likelihood, averaged over keys `(k,)`."""
    once = jax.jacfwd if z.size <= FEW else jax.grad
    return jax.jacfwd(once(lambda z: _averaged(keys, given, z)))(z)


def likelihood_of(parameters: Parameters, model_of: Any, ys: Any, inputs: Inputs, filter: Filter | None, burn: int) -> Likelihood:
    """Return the likelihood of measurements; in double precision, which must be in force.

    Raises:
        MotesError: data, model and filter do not fit each other; the message says which.
    """
    if not callable(model_of):
        checks.refuse("fit model_of", "a function of the parameters that returns a model", type(model_of).__name__)
    model = model_at(model_of, parameters.given(jnp.asarray(parameters.values)))
    ys, inputs = parted("fit", ys, inputs)
    sequences = [checked_data(model, *one) for one in _sequences(model, ys, inputs)]
    checks.natural("fit burn", burn)
    shortest = min(steps_of(one) for one, _ in sequences)
    if burn >= shortest:
        checks.refuse("fit burn", f"fewer steps than there are, {shortest}", burn)
    used: Filter = in_double(_chosen(filter, model, jax.tree.map(one_of, sequences[0][1])))
    series: dict[Any, list[Any]] = {}
    for one in sequences:
        series.setdefault(str(jax.tree.map(np.shape, one)), []).append(one)
    stacked = tuple(Series(*jax.tree.map(lambda *leaves: jnp.stack(leaves), *alike)) for alike in series.values())
    return Likelihood(parameters, model_of, used, stacked, burn)


def _sequences(model: Model, ys: Any, inputs: Inputs) -> list[tuple[Any, Inputs]]:
    """Return measurements and inputs of each sequence: a list of arrays `(t, y)` is of several."""
    of_vectors = not any(part.sensor.measures_anything for part in model.each_mode())
    several = of_vectors and isinstance(ys, (list, tuple)) and bool(ys) and all(np.ndim(one) == 2 for one in ys)
    if not several:
        return [(ys, inputs)]
    if inputs is None:
        return [(one, None) for one in ys]
    if not isinstance(inputs, (list, tuple)) or len(inputs) != len(ys):
        given = f"{len(inputs)}" if isinstance(inputs, (list, tuple)) else type(inputs).__name__
        checks.refuse("fit inputs", f"a list with the inputs of each of the {len(ys)} sequences", given)
    return list(zip(ys, inputs, strict=True))


def _chosen(filter: Filter | None, model: Model, u: Inputs) -> Filter:
    """Return the filter, or one that suits the model, such that a collapse is no error."""
    if filter is None:
        try:
            as_linear_model("fit", model, u)
            filter = KalmanFilter()
        except checks.MotesError:
            filter = ParticleFilter(n=1_000, scheme=StopGradient())
    if not isinstance(filter, Filter) or not filter.has_evidence:
        checks.refuse("fit filter", "a filter with a likelihood, such as KalmanFilter()", type(filter).__name__)
    if filter.loses_derivatives:
        checks.refuse("fit filter", "a likelihood with a derivative", f"{type(filter).__name__}, whose resampling loses it",
                      "Say scheme=mo.resampling.StopGradient().")
    return replace(filter, on_collapse="predict") if filter.on_collapse == "raise" else filter
