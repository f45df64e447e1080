"""The Kalman filter that knows the slopes of the model along one true track.

P <- F P F' + Q with F and Q at the true x_{t-1}, then P <- P - P H' (H P H' + R)^-1 H P with H and R at the true x_t; y_0 included.
"""

from typing import Any

import jax
import jax.numpy as jnp
from jax.typing import ArrayLike

from motes.bounds.bound import Bound
from motes.core import checks
from motes.core.loop import loop, with_first
from motes.core.types import Inputs
from motes.gaussian.taylor import Taylor, affine
from motes.laws.gaussian import Gaussian
from motes.models.canonical import canonical, one_of
from motes.models.interface import Model
from motes.models.state_space import StateSpaceModel, as_state_space, at_step, checked_inputs
from motes.tracing.compiling import jitted
from motes.tracing.identity import Beside

KIND = "Kalman filter at the true track"


def kalman_at_truth(model: Model, xs: ArrayLike, inputs: Inputs = None) -> Bound:
    """Covariance of the linear Kalman filter with Jacobians taken at one given track.

    The yardstick for runs that share a fixed track, for which the posterior Cramer-Rao bound, an average over tracks, says nothing. It is
    no strict bound: a filter can use what linearization leaves out, and can be lucky with a track that its prior favors.

    Pure: it can be jitted, vmapped (over tracks and array fields of models) and differentiated.

    Args:
        model: state-space or mixed linear model whose noises have covariances and are independent of each other.
        xs: the track, `(t, x)`.
        inputs: tree with the time axis first, or None.

    Raises:
        MotesError: track, inputs and model do not fit each other, or the model has no Jacobian.
    """
    given = as_state_space("kalman_at_truth", model)
    for name in ("dynamics", "sensor"):
        part = getattr(given, name)
        if not part.has_moments:
            checks.refuse(f"kalman_at_truth {name}", "a mean function and a noise covariance (it uses the Jacobian)", type(part).__name__)
    if given.correlated:
        checks.refuse("kalman_at_truth model", "independent process and measurement noise", "noise_cross_cov")
    xs = checks.as_float("kalman_at_truth xs", xs).astype(given.dtype)
    checks.shape("kalman_at_truth xs", xs, (None, given.size), "(steps, states)")
    inputs = checked_inputs(inputs, xs.shape[0], "xs", names=given.input_names)
    known = canonical(model, jax.tree.map(one_of, inputs))
    return Bound(_covariances(known, xs, inputs, Beside(known)), given.names, KIND)


@jitted
def _covariances(given: Any, xs: jax.Array, inputs: Inputs, beside: Beside) -> jax.Array:
    model: StateSpaceModel = as_state_space("kalman_at_truth", given)
    model.check(at_step(inputs, 0))

    def measure(cov: jax.Array, t: Any) -> jax.Array:
        prediction, H, R = affine(model.sensor, xs[t], at_step(inputs, t), t)
        return Gaussian(xs[t], cov).corrected(jnp.zeros_like(prediction), H, R).law.covariance

    def advance(cov: jax.Array, t: jax.Array) -> tuple[jax.Array, jax.Array]:
        ahead = Taylor().through(model.dynamics, Gaussian(xs[t - 1], cov), at_step(inputs, t), t)
        cov = measure(ahead.covariance, t)
        return cov, cov

    first = measure(model.initial.cov(), jnp.int32(0))
    _, rest = loop(advance, first, jnp.arange(1, xs.shape[0], dtype=jnp.int32))
    return with_first(first, rest)
