"""Posterior Cramer-Rao bound (Tichavsky, Muravchik, Nehorai 1998): no estimator has a smaller mean square error matrix.

The information J of x_t grows by E[H' R^-1 H] (H the slope of the sensor, R its noise) with each measurement, y_0 included, and goes from
step to step, F being the slope and Q the noise of the dynamics, by

    J' = D22 - D12' (J + D11)^-1 D12,   D11 = E[F' Q^-1 F],   D12 = -E[F' Q^-1],   D22 = E[Q^-1],

which is (Q + F J^-1 F')^-1 where F and Q do not depend on the state; in that form Q may be singular. A noise covariance S that depends on
the state adds its own information, 1/2 tr(S^-1 dS/dx_i S^-1 dS/dx_j). Expectations are means over trajectories drawn from the model.

The information is never formed. Each trajectory gives rows A with A' A its share of the information; all rows are turned into one
triangular factor, and what is carried is a factor G of the bound, J^-1 = G G'. So a singular initial covariance is no special case, and the
squares of noise scales, 1e-6 beside 100, do not cost the digits that float32 has.
"""

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from motes.bounds.bound import Bound
from motes.core import checks, linalg, random
from motes.core.loop import loop
from motes.core.types import Inputs, KeyLike
from motes.gaussian.taylor import affine
from motes.laws.conditional import AdditiveGaussian, Conditional
from motes.laws.gaussian import Gaussian
from motes.models.canonical import canonical, one_of
from motes.models.state_space import StateSpaceModel, as_state_space, at_step, checked_inputs
from motes.models.structure import trace
from motes.tracing.compiling import jitted
from motes.tracing.identity import Beside

KIND = "posterior Cramer-Rao bound"

FAULTS = {
    1: ("sensor Q", "a positive definite noise covariance (without noise the information is infinite)", "a singular one"),
    2: ("dynamics Q", "a positive definite noise covariance where slope or noise of the dynamics depend on the state", "a singular one"),
    3: ("model", "finite values and slopes along trajectories drawn from it", "others"),
}
"""What can be wrong at a step of the recursion, in the words of a refusal; 0 stands for nothing."""


def posterior_cramer_rao(key: KeyLike, model: Any, steps: int, trajectories: int = 1_000, inputs: Inputs = None) -> Bound:
    """Bound the error covariance of any estimator of x_t from y_0, ..., y_t.

    It bounds mean square errors over states *and* measurements drawn from the model; for one fixed track see `kalman_at_truth`. Its own
    error falls with the root of the number of trajectories. It is close to the best filter only where the slopes are alike on all tracks,
    and can be far too low otherwise, since it averages information: tracks that are seen from different directions lend each other their
    sharp ones, and a few that pass near a sensor can hold nearly all of it.

    Pure: it can be jitted, vmapped (over keys and array fields of models) and differentiated; inside of these a step that would be refused
    gives NaN.

    Args:
        key: JAX key or integer seed.
        model: state-space or mixed linear model, additive Gaussian noises, Gaussian initial law.
        steps: number of steps t.
        trajectories: how many to average over.
        inputs: tree with the time axis first, or None.

    Raises:
        MotesError: the noises are of another kind, or singular where that cannot be; or the arguments do not fit each other.
    """
    checks.positive_integer("posterior_cramer_rao steps", steps)
    checks.positive_integer("posterior_cramer_rao trajectories", trajectories)
    names = _check_model(model)
    inputs = checked_inputs(inputs, steps, "steps", names=model.input_names)
    known = canonical(model, jax.tree.map(one_of, inputs))
    covs, faults = _recursion(random.as_key(key), known, steps, trajectories, inputs, Beside(known))
    if checks.is_concrete(faults) and np.any(faults):
        step = int(np.argmax(np.asarray(faults) > 0))
        argument, expected, found = FAULTS[int(faults[step])]
        checks.refuse(f"posterior_cramer_rao {argument}", expected, f"{found} at step {step}")
    return Bound(covs, names, KIND)


def _check_model(model: Any) -> tuple[str, ...]:
    """Refuse models without the information that the recursion needs, and return the names of the states."""
    given = as_state_space("posterior_cramer_rao", model)
    for name in ("dynamics", "sensor"):
        part = getattr(given, name)
        if not isinstance(part, AdditiveGaussian):
            checks.refuse(f"posterior_cramer_rao {name}", "LinearGaussian or AdditiveGaussian", type(part).__name__,
                          "The bound is known for additive Gaussian noise only.")
    if not isinstance(given.initial, Gaussian):
        checks.refuse("posterior_cramer_rao initial", "a Gaussian", type(given.initial).__name__)
    if given.correlated:
        checks.refuse("posterior_cramer_rao model", "independent process and measurement noise", "noise_cross_cov")
    return given.names


@partial(jitted, static_argnums=(2, 3))
def _recursion(
    key: jax.Array, given: Any, steps: int, trajectories: int, inputs: Inputs, beside: Beside
) -> tuple[jax.Array, jax.Array]:
    """Return the bounds `(t, x, x)` and the first fault so far `(t,)`."""
    model: StateSpaceModel = as_state_space("posterior_cramer_rao", given)
    model.check(at_step(inputs, 0))
    traced = trace(model, at_step(inputs, 0))
    states = slice(model.size)
    noise_varies = {name: bool(uses[states].any()) for name, uses in traced.noise_uses.items()}
    linear = not traced.slope_pairs["dynamics"][:, states, states].any() and not noise_varies["dynamics"]
    identity = jnp.eye(model.size, dtype=model.dtype)

    def measured(G: jax.Array, X: jax.Array, u: Any, t: Any) -> tuple[jax.Array, jax.Array]:
        rows, _, regular = _information(model.sensor, X, u, t, noise_varies["sensor"])
        turned = linalg.cholesky_update(identity, linalg.product(G.T, _columns(rows)))
        return linalg.solve_lower(turned, G.T).T, _fault(rows, regular, 1)

    def moved(G: jax.Array, X: jax.Array, u: Any, t: Any) -> tuple[jax.Array, jax.Array]:
        if linear:
            _, F, Q = affine(model.dynamics, X[:, 0], u, t)
            return linalg.cholesky_update(linalg.cholesky(Q), linalg.product(F, G)), _fault(F, True, 2)
        rows, ends, regular = _information(model.dynamics, X, u, t, noise_varies["dynamics"])
        # rows of the joint information of z and x_t, where x_{t-1} = constant - G z and z has the information I
        joint = jnp.concatenate([linalg.product(G.T, _columns(rows)), _columns(ends)])
        start = jnp.zeros((2 * model.size, 2 * model.size), G.dtype).at[states, states].set(identity)
        factor = linalg.cholesky_update(start, joint)[model.size :, model.size :]
        return linalg.solve_upper(factor, identity), _fault(rows, regular, 2)

    def advance(carry: tuple[jax.Array, jax.Array, jax.Array], t: jax.Array) -> tuple[Any, Any]:
        X, G, fault = carry
        G, in_sensor = measured(G, X, at_step(inputs, t), t)
        fault = jnp.where(fault > 0, fault, in_sensor)
        # on to the next step; of the one after the last nothing is kept
        later, u = t + 1, at_step(inputs, jnp.minimum(t + 1, steps - 1))
        ahead, in_dynamics = moved(G, X, u, later)
        X = model.dynamics.sample(random.child(random.step_key(key, later), random.PREDICT), X, u, later)
        return (X, ahead, jnp.where(fault > 0, fault, in_dynamics)), (G, fault)

    X = model.initial.sample(random.child(random.step_key(key, 0), random.INITIAL), trajectories)
    start = (X, linalg.cholesky(model.initial.cov()), jnp.int32(0))
    _, (Gs, faults) = loop(advance, start, jnp.arange(steps, dtype=jnp.int32))
    covs = jax.vmap(lambda G: linalg.product_transposed(G, G))(Gs)
    return jnp.where(faults[:, None, None] > 0, jnp.nan, covs), faults


def _information(part: Conditional, X: jax.Array, u: Any, t: Any, varies: bool) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Rows of the information on the state that a value of a conditional holds, for each of n states X `(x, n)`.

    Returns:
        Rows `(r, x, n)` of the state with its sign turned, rows `(r, z, n)` of the value in the joint information of both, and whether the
        noise covariance is regular, `(n,)`. With `varies`, that is a noise covariance that depends on the state, r is z + z z, else z.
    """

    def of(x: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
        mean, slope, noise = affine(part, x, u, t)
        factor = linalg.cholesky(noise)
        rows, ends = linalg.solve_lower(factor, slope), linalg.solve_lower(factor, jnp.eye(mean.shape[0], dtype=x.dtype))
        if varies:
            change = jax.jacfwd(lambda x: part.cov(x, u, t))(x)
            # the trace of a product of symmetric matrices is the sum over the products of their entries
            white = linalg.solve_lower(factor, linalg.transpose(linalg.solve_lower(factor, change)))
            own = white.reshape(-1, x.shape[0]) / np.sqrt(2)
            rows, ends = jnp.concatenate([rows, own]), jnp.concatenate([ends, jnp.zeros((own.shape[0], ends.shape[1]), x.dtype)])
        return rows, ends, jnp.all(jnp.diagonal(factor) > 0)

    return jax.vmap(of, in_axes=-1, out_axes=-1)(X)


def _columns(rows: jax.Array) -> jax.Array:
    """Rows `(r, x, n)` of each of n states as the columns `(x, r n)` of a factor of the mean information."""
    return jnp.swapaxes(rows, 0, 1).reshape(rows.shape[1], -1) / np.sqrt(rows.shape[2])


def _fault(numbers: jax.Array, regular: Any, singular: int) -> jax.Array:
    return jnp.where(jnp.all(regular), jnp.where(jnp.all(jnp.isfinite(numbers)), 0, 3), singular).astype(jnp.int32)
