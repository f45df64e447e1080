"""SMC^2 (Chopin, Jacob, Papaspiliopoulos 2013): a cloud of parameters, each with a particle filter of its own, through time.

1. Draw parameters from the prior; start a filter for each.
2. Take in the next measurement with every filter; multiply the weights of the parameters by its log evidence.
3. Where the effective size falls below a share, resample parameters together with their filters, and move each by particle marginal
   Metropolis-Hastings over the measurements so far.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from motes.core import checks, logspace, random
from motes.core.loop import loop
from motes.core.progress import tracked
from motes.core.types import KeyLike
from motes.filters.history import Carry
from motes.filters.setup import Setup, setup
from motes.laws.cloud import Cloud, weighted_moments
from motes.mcmc.interface import State, accept_or_stay
from motes.mcmc.metropolis import RandomWalkMetropolis
from motes.models.state_space import at_step
from motes.montecarlo.tempering import shaped
from motes.parameters.posterior import Posterior
from motes.resampling.schemes import Systematic
from motes.tracing.compiling import jitted
from motes.tracing.identity import Beside


class Sequential(NamedTuple):
    """What `smc_squared` gives.

    Attributes:
        cloud: of parameters `(p, n)` given all measurements.
        log_evidence: of the measurements so far, `(t,)`.
        mean: of the parameters given the measurements so far, `(t, p)`.
        cov: likewise, `(t, p, p)`.
        ess: effective number of parameters, `(t,)`.
        acceptance: of the moves at the steps that had some, NaN elsewhere, `(t,)`.
    """

    cloud: Cloud
    log_evidence: np.ndarray
    mean: np.ndarray
    cov: np.ndarray
    ess: np.ndarray
    acceptance: np.ndarray


def smc_squared(key: KeyLike, posterior: Posterior, n: int, moves: int = 3, ess: float = 0.5) -> Sequential:
    """Draw parameters from their posterior at every time, and estimate the evidence of the model.

    Args:
        key: JAX key or integer seed.
        posterior: prior, model, measurements and the filter that each parameter gets.
        n: number of parameters.
        moves: Metropolis-Hastings steps after each resampling.
        ess: share of n below which parameters are resampled.

    Raises:
        MotesError: an argument cannot be used, or no parameter explains a measurement.
    """
    if not isinstance(posterior, Posterior):
        checks.refuse("smc_squared posterior", "a mo.parameters.Posterior", type(posterior).__name__)
    for name, value in (("n", n), ("moves", moves)):
        checks.positive_integer(f"smc_squared {name}", value)
    checks.above_zero("smc_squared ess", ess, 1.0)
    key, beside = random.as_key(key), Beside(posterior)
    thetas = posterior.prior.sample(random.child(key, random.INITIAL), n)
    keys = random.step_keys(random.child(key, random.FILTER), n)
    state, log_weights = _begun(posterior, thetas.T, keys, beside), logspace.uniform_weights(n, thetas.dtype)
    stages: list[tuple[Any, ...]] = []
    total = 0.0
    for t in tracked(range(posterior.ys.shape[0]), "SMC^2", None):
        state, log_weights, gain = _taken_in(posterior, state, log_weights, jnp.int32(t), beside)
        total += float(gain)
        if not np.isfinite(total):
            checks.refuse("smc_squared prior", "parameters that explain the measurements", f"none of {n} at step {t}",
                          "Use more parameters or particles, or a prior that fits.", checks.CollapseError)
        size, rate = float(logspace.effective_size(log_weights)), np.nan
        mean, cov = weighted_moments(log_weights, state.position.T)
        stages.append((total, np.asarray(mean), np.asarray(cov), size))
        if size < ess * n:
            state, accepted = _moved(random.step_key(key, t), posterior, state, log_weights, (jnp.int32(t), beside), moves)
            log_weights, rate = logspace.uniform_weights(n, thetas.dtype), float(accepted)
        stages[-1] = (*stages[-1], rate)
    cloud = Cloud(state.position.T, log_weights, jnp.arange(n, dtype=jnp.int32))
    return Sequential(cloud, *(np.array(column) for column in zip(*stages, strict=True)))


def _ready(posterior: Posterior, key: jax.Array, theta: jax.Array) -> Setup:
    return setup(key, posterior.filter, posterior.model(theta), at_step(posterior.inputs, 0), posterior.ys[0])


def _begin(posterior: Posterior, ready: Setup) -> Carry:
    """Return the filter before the first measurement."""
    return ready.start(at_step(posterior.inputs, 0), posterior.ys[0])


def _next(ready: Setup, carry: Carry, y: jax.Array, u: Any, t: Any) -> tuple[Carry, jax.Array]:
    """Take in the measurement of step t; return its log evidence too."""
    carry, info = jax.lax.cond(t == 0, lambda: ready.update(carry, y), lambda: ready.step(carry, y, u))
    return carry, jnp.where(info.collapsed, -jnp.inf, info.log_evidence)


@jitted
def _begun(posterior: Posterior, thetas: jax.Array, keys: jax.Array, beside: Beside) -> State:
    """Return what each parameter carries along: itself, its log posterior so far, its filter."""

    def one(theta: jax.Array, key: jax.Array) -> State:
        return State(theta, posterior.prior.log_prob(theta), (key, _begin(posterior, _ready(posterior, key, theta))))

    return jax.vmap(one)(thetas, keys)


@jitted
def _taken_in(
    posterior: Posterior, state: State, log_weights: jax.Array, t: jax.Array, beside: Beside
) -> tuple[State, jax.Array, jax.Array]:
    def one(state: State) -> tuple[State, jax.Array]:
        key, carry = state.kernel_state
        carry, gain = _next(_ready(posterior, key, state.position), carry, posterior.ys[t], at_step(posterior.inputs, t), t)
        return State(state.position, state.log_density + gain, (key, carry)), gain

    state, gains = jax.vmap(one)(state)
    weights, gain = logspace.normalize(log_weights + jnp.where(jnp.isnan(gains), -jnp.inf, gains))
    return state, weights, gain


def _moved(
    key: jax.Array, posterior: Posterior, state: State, log_weights: jax.Array, at: tuple[jax.Array, Beside], moves: int
) -> tuple[State, jax.Array]:
    walk = shaped(RandomWalkMetropolis(), log_weights, state.position.T)
    ancestors = Systematic().ancestors(random.child(key, random.RESAMPLE), log_weights, log_weights.shape[0])
    state = jax.tree.map(lambda leaf: leaf[ancestors], state)
    rates = []
    for turn in range(moves):
        state, rate = _once(random.step_key(random.child(key, random.PREDICT), turn), posterior, state, walk, *at)
        rates.append(rate)
    return state, jnp.mean(jnp.stack(rates))


@jitted
def _once(
    key: jax.Array, posterior: Posterior, state: State, walk: RandomWalkMetropolis, t: jax.Array, beside: Beside
) -> tuple[State, jax.Array]:
    """Move all parameters once, each with a new filter over the measurements so far."""

    def one(key: jax.Array, state: State) -> tuple[State, jax.Array]:
        theta, _ = walk.proposed(random.child(key, random.NOISE), state.position, t)
        fresh = random.child(key, random.FILTER)
        ready = _ready(posterior, fresh, theta)

        def advance(held: tuple[Carry, jax.Array], row: Any) -> tuple[tuple[Carry, jax.Array], None]:
            carry, gain = _next(ready, held[0], *row)
            return (carry, held[1] + gain), None

        begun = (_begin(posterior, ready), jnp.zeros_like(state.log_density))
        steps = jnp.arange(posterior.ys.shape[0], dtype=jnp.int32)
        (carry, likelihood), _ = loop(advance, begun, (posterior.ys, posterior.inputs, steps), count=t + 1)
        prior = posterior.prior.log_prob(theta)
        density = jnp.where(jnp.isfinite(prior), prior + likelihood, -jnp.inf)
        there, log_ratio = State(theta, density, (fresh, carry)), density - state.log_density
        state, info = accept_or_stay(random.child(key, random.UPDATE), state, there, log_ratio)
        return state, info.accepted[0]

    state, accepted = jax.vmap(one)(random.step_keys(key, state.log_density.shape[0]), state)
    return state, jnp.mean(accepted)
