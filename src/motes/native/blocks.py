"""Native kernels that need no model, offered in place of the operations of the lower rooms that they replace."""

from collections.abc import Callable, Sequence
from functools import cache, partial
from typing import Any

import jax
import jax.numpy as jnp

from motes.core import engine, logspace, random
from motes.core.engine import CompileError
from motes.core.record import replace
from motes.laws import cloud, elements
from motes.native import report
from motes.native.compile import HEADERS, begun, call_kernel, call_on_particles, finished
from motes.native.rules import kind_of
from motes.resampling import allotment
from motes.resampling.policy import ESS, Always, Entropy, Never, Policy
from motes.resampling.schemes import Given, Scheme, Systematic

FEWEST = 256
"""With fewer particles JAX is as fast."""

ENOUGH = 1_000
"""From so many particles on kernels are used without being asked for: with fewer, what is gained does not make up for compiling them."""

PRECISIONS = (jnp.float32, jnp.float64)
"""Types of particles that kernels work on."""

MOST_ROWS = 32
"""States that the kernel of moments has room for."""


def standing(tried: bool = False) -> str:
    """Why native kernels cannot be used here; empty when they can, or when nothing speaks against them so far.

    Args:
        tried: whether to wait for the compiler, which may still be at work.
    """
    if jax.default_backend() != "cpu":
        return f"the device is a {jax.default_backend()}"
    try:
        mark = begun(_without_model(jnp.float32))
        if tried:
            finished(mark)
    except CompileError as reason:
        return str(reason)
    return ""


@cache
def _without_model(dtype: Any) -> str:
    return f"#define MOTES_REAL {kind_of(dtype)}\n" + (HEADERS / "blocks.cpp").read_text()


def fewest() -> int:
    """Return the number of particles from which on kernels are used, for the engine that is chosen."""
    return FEWEST if engine.chosen() == "native" else ENOUGH


def usable(n: int, *dtypes: Any) -> bool:
    """Tell whether the engine that is chosen has native kernels work on arrays of n particles of these types, and says so."""
    if engine.chosen() == "jax" or n < fewest() or len(set(dtypes)) != 1 or dtypes[0] not in PRECISIONS:
        return False
    against = standing()
    if against:
        report.note_absence(against)
    else:
        report.note_kernel()
    return not against


def _call(symbol: str, dtype: Any, results: Any, *operands: jax.Array) -> Any:
    return call_kernel(_without_model(dtype), f"motes_{symbol}", results, *operands)


def differentiable(native: Callable[..., Any], pure: Callable[..., Any]) -> Callable[..., Any]:
    """Return the native function with the derivatives of the pure one; neither may close over arrays."""
    function = jax.custom_jvp(native)
    # values of the kernel: JAX takes the batch axes of its results to be those of the rule's
    function.defjvp(lambda primals, tangents: (function(*primals), jax.jvp(pure, primals, tangents)[1]))
    return function


def normal_block(key: jax.Array, rows: int, n: int, dtype: Any) -> jax.Array | None:
    """See `random.normal_block`."""
    if not rows or not usable(n, dtype):
        return None
    shapes = [jax.ShapeDtypeStruct((rows, n), dtype)]
    return call_on_particles(_without_model(dtype), "motes_normal_block", shapes, [key], ([False], [True]))[0]


def weighted_moments(log_weights: jax.Array, *parts: jax.Array) -> tuple[jax.Array, jax.Array] | None:
    """See `cloud.weighted_moments`."""
    size = sum(part.shape[0] for part in parts)
    dtype = log_weights.dtype
    if not 0 < size <= MOST_ROWS or not usable(log_weights.shape[0], dtype, *(part.dtype for part in parts)):
        return None
    full = [part for part in parts if part.shape[0]]
    shapes = (jax.ShapeDtypeStruct((size,), dtype), jax.ShapeDtypeStruct((size, size), dtype))

    def native(*given: jax.Array) -> tuple[jax.Array, jax.Array]:
        of_particles = ([True] * len(given), [False, False])
        mean, cov = call_on_particles(_without_model(dtype), "motes_moments", shapes, given, of_particles)
        return mean, cov

    return differentiable(native, engine.original(cloud.weighted_moments))(log_weights, *full)


def ancestors(key: jax.Array, scheme: Scheme, policy: Policy, log_weights: jax.Array) -> tuple[jax.Array, jax.Array] | None:
    """Return ancestors `(n,)` and log weights `(n,)`, resampled where the policy asks for it; None for schemes and policies not known."""
    if isinstance(scheme, Given):
        return (scheme.indices, scheme.log_weights) if usable(scheme.indices.shape[0], scheme.log_weights.dtype) else None
    codes = {Always: 0, Never: 1, ESS: 2, Entropy: 3}
    n, dtype = log_weights.shape[0], log_weights.dtype
    if type(scheme) is not Systematic or type(policy) not in codes or not usable(n, dtype):
        return None
    threshold = getattr(policy, "share", getattr(policy, "threshold", 0.0))
    uniform = random.uniform(key, (), dtype)
    parameters = jnp.stack([uniform, jnp.asarray(threshold, dtype), jnp.full((), codes[type(policy)], dtype)])
    shapes = (jax.ShapeDtypeStruct((n,), jnp.int32), jax.ShapeDtypeStruct((n,), dtype))

    def native(log_weights: jax.Array, parameters: jax.Array, policy: Policy) -> tuple[jax.Array, jax.Array]:
        return tuple(_call("ancestors", dtype, shapes, log_weights, parameters))

    def pure(log_weights: jax.Array, parameters: jax.Array, policy: Policy) -> tuple[jax.Array, jax.Array]:
        needed = policy.needed(log_weights)
        drawn = scheme.at(parameters[0], log_weights, n)
        equal = logspace.uniform_weights(n, log_weights.dtype)
        return jnp.where(needed, drawn, jnp.arange(n, dtype=jnp.int32)), jnp.where(needed, equal, log_weights)

    return differentiable(native, pure)(log_weights, parameters, policy)


def resampled(key: jax.Array, scheme: Scheme, policy: Policy, law: Any, log_score: jax.Array | None) -> Any:
    """See `policy.resampled`."""
    chosen = ancestors(key, scheme, policy, law.log_weights) if log_score is None else None
    return None if chosen is None else replace(law.resampled(chosen[0]), log_weights=chosen[1])


def joint_weights(log_weights: jax.Array, log_likelihood: jax.Array, max_log_likelihood: jax.Array) -> tuple[jax.Array, jax.Array] | None:
    """See `logspace.joint_weights`."""
    dtype = log_weights.dtype
    if not usable(log_weights.shape[0], dtype, log_likelihood.dtype):
        return None
    shapes = (jax.ShapeDtypeStruct(log_weights.shape, dtype), jax.ShapeDtypeStruct((6,), dtype))
    max_log_likelihood = jnp.broadcast_to(max_log_likelihood, log_likelihood.shape).astype(dtype)

    def native(log_weights: jax.Array, log_likelihood: jax.Array, max_log_likelihood: jax.Array) -> tuple[jax.Array, jax.Array]:
        return tuple(_call("weigh", dtype, shapes, log_likelihood, log_weights, max_log_likelihood))

    return differentiable(native, engine.original(logspace.joint_weights))(log_weights, log_likelihood, max_log_likelihood)


def innovation(n: int, pure: Callable[..., Any], angles: tuple[int, ...], *given: jax.Array) -> tuple[jax.Array, jax.Array] | None:
    """Return square and degrees of freedom of an innovation, see `alarm.of_mixture`; None where each particle has its own covariance.

    Args:
        n: number of particles, some of which were asked for predictions.
        pure: the same in JAX.
        angles: components of the measurement that are angles.
        *given: predictions `(y, m)`, covariance `(y, y)`, log weights `(m,)` and measurement `(y,)`.
    """
    centers, cov, *_ = given
    size, dtype = centers.shape[0], centers.dtype
    if cov.ndim != 2 or not 0 < size <= MOST_ROWS or not usable(n, *(array.dtype for array in given)):
        return None

    def native(*given: jax.Array) -> tuple[jax.Array, jax.Array]:
        turning = jnp.asarray([i in angles for i in range(size)], dtype)
        return tuple(_call("innovation", dtype, jax.ShapeDtypeStruct((2,), dtype), *given, turning))

    return differentiable(native, lambda *given: tuple(pure(*given)))(*given)


def masses_of(log_weights: jax.Array) -> jax.Array | None:
    """See `elements.masses_of`."""
    (count, n), dtype = log_weights.shape, log_weights.dtype
    if not usable(n, dtype):
        return None
    native = partial(_call, "masses", dtype, jax.ShapeDtypeStruct((count, 4), dtype))
    return differentiable(native, engine.original(elements.masses_of))(log_weights)


def moments_of(log_weights: jax.Array, points: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array] | None:
    """See `elements.moments_of`."""
    if points.shape[0] > MOST_ROWS or not usable(log_weights.shape[1], log_weights.dtype, points.dtype):
        return None
    dtype, x = points.dtype, points.shape[0]
    shapes = [jax.ShapeDtypeStruct(shape, dtype) for shape in ((x,), (x, x), ())]

    def native(log_weights: jax.Array, points: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
        def one(log_weights: jax.Array, points: jax.Array) -> Sequence[jax.Array]:
            of_particles = ([True, True], [False] * 3)
            return call_on_particles(_without_model(dtype), "motes_moments", shapes, [log_weights, points], of_particles)

        with engine.for_elements():
            mean, cov, mass = jax.vmap(one, (0, 1))(log_weights, points)
        return mass, mean, cov

    return differentiable(native, engine.original(elements.moments_of))(log_weights, points)


def ends(log_weights: jax.Array, numbers: jax.Array, whole: jax.Array) -> jax.Array | None:
    """See `allotment.ends`."""
    if not usable(log_weights.shape[1], log_weights.dtype, numbers.dtype):
        return None
    native = partial(_call, "ends", log_weights.dtype, jax.ShapeDtypeStruct(log_weights.shape, jnp.int32))
    return differentiable(native, engine.original(allotment.ends))(log_weights, numbers, whole)


def parents_of(ends: jax.Array, first: jax.Array | int, count: int) -> jax.Array | None:
    """See `allotment.parents_of`."""
    if not usable(ends.shape[0], jnp.float32):
        return None
    return _call("parents", jnp.float32, jax.ShapeDtypeStruct((count,), jnp.int32), ends, jnp.asarray(first, jnp.int32))


for implementation in (normal_block, weighted_moments, resampled, joint_weights, masses_of, moments_of, ends, parents_of):
    engine.offer(implementation.__name__, implementation)
