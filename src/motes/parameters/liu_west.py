"""The filter of Liu and West (2001): parameters and state in one pass, the parameters smoothed by a kernel that keeps their spread.

1. Resample where the effective size is low.
2. Draw each particle's parameters from N(a theta + (1 - a) mean, (1 - a^2) covariance), with the mean and covariance of all particles.
3. Move the state by the model with these parameters; weigh by the measurement.

One pass in constant memory, but an approximation: kernels forget slowly, and correlations of parameters with the past are lost.
"""

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from motes.core import checks, linalg, random
from motes.core.loop import loop, with_first
from motes.core.record import replace
from motes.core.types import KeyLike
from motes.filters.info import weigh
from motes.laws.cloud import Cloud, weighted_moments
from motes.models.state_space import at_step
from motes.parameters.augmented import augmented
from motes.parameters.posterior import Parametric
from motes.resampling.policy import ESS, resample
from motes.resampling.schemes import Systematic
from motes.tracing.compiling import jitted
from motes.tracing.identity import Beside


class Tracked(NamedTuple):
    """What `liu_west` gives.

    Attributes:
        cloud: of parameters and state `(p + x, n)` given all measurements.
        mean: of parameters and state given the measurements so far, `(t, p + x)`.
        cov: likewise, `(t, p + x, p + x)`.
        log_likelihood: of the measurements, with the parameters averaged out, `()`.
        ess: effective number of particles, `(t,)`.
    """

    cloud: Cloud
    mean: np.ndarray
    cov: np.ndarray
    log_likelihood: float
    ess: np.ndarray


def liu_west(key: KeyLike, given: Parametric, n: int, discount: float = 0.98) -> Tracked:
    """Filter parameters and state together.

    Args:
        key: JAX key or integer seed.
        given: a `parameters.Posterior` or `PathPosterior`; no filter of its own is used.
        n: particles.
        discount: d between 0 and 1; a = (3 d - 1) / (2 d). Near 1 kernels are narrow and particles die out, lower values forget.

    Raises:
        MotesError: an argument cannot be used.
        CollapseError: no particle explains a measurement.
    """
    if not isinstance(given, Parametric):
        checks.refuse("liu_west given", "a mo.parameters.Posterior", type(given).__name__)
    checks.positive_integer("liu_west n", n)
    if not 0.5 < discount < 1:
        checks.refuse("liu_west discount", "a number between 0.5 and 1", discount)
    cloud, (mean, cov, gains, sizes) = _filtered(random.as_key(key), given, n, (3 * discount - 1) / (2 * discount), Beside(given))
    total = float(np.sum(np.asarray(gains, np.float64)))
    if not np.isfinite(total):
        checks.refuse("liu_west given", "particles that explain the measurements", f"none at step {int(np.argmax(~np.isfinite(gains)))}",
                      "Use more particles, or a prior that fits.", checks.CollapseError)
    return Tracked(cloud, np.asarray(mean), np.asarray(cov), total, np.asarray(sizes))


@partial(jitted, static_argnames="n")
def _filtered(key: jax.Array, given: Parametric, n: int, a: Any, beside: Beside) -> tuple[Cloud, tuple[jax.Array, ...]]:
    size = given.size
    opening = random.step_key(key, 0)
    thetas = given.prior.sample(random.child(opening, random.INITIAL), n)
    model = augmented(given, thetas, random.child(opening, random.WORLD), jnp.zeros(size, thetas.dtype))

    def weighed(cloud: Cloud, t: Any) -> tuple[Cloud, tuple[jax.Array, ...]]:
        likelihood = given.log_likelihood(model, cloud.particles, at_step(given.inputs, t), t)
        log_weights, info = weigh(cloud.log_weights, likelihood, jnp.full((), jnp.inf, likelihood.dtype))
        cloud = replace(cloud, log_weights=log_weights).gathered(model.circular)
        return cloud, (cloud.mean(), cloud.cov(), info.log_evidence, info.ess)

    def ahead(cloud: Cloud, t: jax.Array) -> tuple[Cloud, tuple[jax.Array, ...]]:
        step = random.step_key(key, t)
        cloud = resample(random.child(step, random.RESAMPLE), Systematic(), ESS(0.5), cloud)
        thetas = cloud.particles[:size]
        mean, cov = weighted_moments(cloud.log_weights, thetas)
        noise = random.normal(random.child(step, random.NOISE), thetas.shape, thetas.dtype)
        shrunk = a * thetas + (1 - a) * mean[:, None] + jnp.sqrt(1 - a**2) * (linalg.cholesky(cov) @ noise)
        moved = model.dynamics.sample(random.child(step, random.PREDICT), jnp.concatenate([shrunk, cloud.particles[size:]]),
                                      at_step(given.inputs, t), t)  # fmt: skip
        return weighed(Cloud(moved, cloud.log_weights, cloud.ancestors), t)

    cloud, first = weighed(Cloud.equal(model.initial.particles), 0)  # type: ignore[attr-defined]
    cloud, rest = loop(ahead, cloud, jnp.arange(1, given.ys.shape[0], dtype=jnp.int32))
    return cloud, with_first(first, rest)
