"""Sequential Monte Carlo samplers with adaptive tempering (Neal 2001; Del Moral, Doucet, Jasra 2006).

1. Draw particles from the prior.
2. Find the largest step of the exponent b, from 0 up to 1, at which the weights L^(db) keep the effective size wanted.
3. Weigh, resample, and move each particle by a Markov kernel that leaves prior times L^b as it is; go to 2.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree

from motes.core import checks, linalg, logspace, random
from motes.core.record import replace
from motes.core.types import KeyLike
from motes.laws.cloud import Cloud, weighted_moments
from motes.laws.law import Law, as_law
from motes.mcmc.adaptive import Adaptive
from motes.mcmc.compose import Repeat
from motes.mcmc.interface import Kernel, Tunable, as_kernel
from motes.montecarlo.estimate import densities_at
from motes.resampling.schemes import Scheme, Systematic
from motes.tracing.compiling import jitted

MOST_STEPS = 1_000
HALVINGS = 40


class Tempered(NamedTuple):
    """What `temper` gives.

    Attributes:
        cloud: particles with the law of the posterior, equally weighted.
        log_evidence: log of the mean of the likelihood under the prior.
        exponents: the steps that were taken, from 0 to 1.
        ess: effective size after each weighing.
        acceptance: of the moves after each.
    """

    cloud: Cloud
    log_evidence: float
    exponents: np.ndarray
    ess: np.ndarray
    acceptance: np.ndarray


class Tempering(NamedTuple):
    """How `temper` works.

    Attributes:
        kernel: moves particles; a tunable one is scaled and shaped to the particles, others are used as they are.
        moves: steps of the kernel after each weighing.
        ess: share of the particles that the effective size keeps.
        scheme: how particles are drawn.
    """

    kernel: Kernel
    moves: int = 10
    ess: float = 0.5
    scheme: Scheme = Systematic()


def temper(key: KeyLike, prior: Any, log_likelihood: Any, n: int, how: Tempering) -> Tempered:
    """Draw particles from a posterior and estimate its evidence, through a chain of laws between prior and posterior.

    Args:
        key: JAX key or integer seed.
        prior: law with `sample` and `log_prob`.
        log_likelihood: function of one point `(x,)`.
        n: particles.
        how: kernel and parameters, such as `Tempering(mo.mcmc.RandomWalkMetropolis())`.

    Raises:
        MotesError: an argument cannot be used, or no particle of the prior has any likelihood.
    """
    checks.positive_integer("temper n", n)
    if not isinstance(how, Tempering) or not isinstance(how.kernel, Kernel):
        checks.refuse("temper how", "mo.montecarlo.Tempering(a kernel)", type(how).__name__)
    as_kernel("Tempering kernel", how.kernel, of_many=True)
    checks.above_zero("Tempering ess", how.ess, 1.0)
    checks.positive_integer("Tempering moves", how.moves)
    law, key = as_law("temper prior", prior), random.as_key(key)
    particles = law.sample(random.child(key, random.INITIAL), n)
    how.kernel.check(random.child(key, random.WORLD), Between(law, log_likelihood, jnp.ones(())), particles[:, 0])
    values = densities_at(log_likelihood, particles)
    if not bool(jnp.isfinite(values).any()):
        checks.refuse("temper prior", "one under which some particle has a likelihood", f"none of {n}",
                      "Use more particles, or check log_likelihood.")

    @jitted
    def advance(key: jax.Array, b: jax.Array, particles: jax.Array, values: jax.Array) -> Any:
        values = jnp.where(jnp.isnan(values), -jnp.inf, values)
        db = _largest_step(values, b, how.ess)
        weights, gain = logspace.normalize(db * values + logspace.uniform_weights(n, values.dtype))
        ancestors = how.scheme.ancestors(random.child(key, random.RESAMPLE), weights, n)
        kernel = shaped(how.kernel, weights, particles)
        target = Between(law, log_likelihood, b + db)
        particles, share = _after_moves(random.child(key, random.PREDICT), kernel, target, particles[:, ancestors], how.moves)
        return b + db, particles, densities_at(log_likelihood, particles), gain, logspace.effective_size(weights), share

    b, total, steps = jnp.zeros((), values.dtype), 0.0, []
    for turn in range(MOST_STEPS):
        b, particles, values, gain, size, share = advance(random.step_key(key, turn), b, particles, values)
        total += float(gain)
        steps.append((float(b), float(size), float(share)))
        if float(b) >= 1:
            exponents, sizes, shares = np.array(steps).T
            return Tempered(Cloud.equal(particles), total, np.append(0.0, exponents), sizes, shares)
    given = f"an exponent of {float(b):.3g} after them"
    checks.refuse("temper log_likelihood", f"one that {MOST_STEPS} steps lead to", given, "Use more particles.")


def _largest_step(values: jax.Array, b: jax.Array, share: float) -> jax.Array:
    """Largest step of the exponent that keeps the effective size of the particles with a likelihood, by bisection of its logarithm.

    Likelihoods may differ by any number of nats: the step is looked for at every scale, not in equal parts of what is left.
    """
    counted = jnp.isfinite(values)
    wanted = share * jnp.sum(counted)
    known = jnp.where(counted, values - jnp.max(jnp.where(counted, values, -jnp.inf)), -jnp.inf)

    def size(db: jax.Array) -> jax.Array:
        return logspace.effective_size(logspace.normalize(jnp.where(counted, db * jnp.where(counted, known, 0), -jnp.inf))[0])

    def halve(_: Any, ends: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
        middle = (ends[0] + ends[1]) / 2
        keeps = size(jnp.exp(middle)) >= wanted
        return jnp.where(keeps, middle, ends[0]), jnp.where(keeps, ends[1], middle)

    top = jnp.log(1 - b)
    low, _ = jax.lax.fori_loop(0, HALVINGS, halve, (jnp.log(jnp.finfo(values.dtype).tiny), top))
    return jnp.where(size(1 - b) >= wanted, 1 - b, jnp.exp(low))


def shaped(kernel: Kernel, log_weights: jax.Array, particles: jax.Array) -> Any:
    """Return a kernel whose tunable part is scaled and shaped to weighted particles `(x, n)`; they teach it what `Adaptive` would learn."""
    if isinstance(kernel, Adaptive):
        return shaped(kernel.kernel, log_weights, particles)
    if isinstance(kernel, Repeat):
        return replace(kernel, kernel=shaped(kernel.kernel, log_weights, particles))
    if not isinstance(kernel, Tunable):
        return kernel
    size = particles.shape[0]
    cov = weighted_moments(log_weights, particles)[1]
    least = 1e-6 * jnp.diag(jnp.diag(cov)) + 1e-20 * jnp.eye(size, dtype=cov.dtype)
    return kernel.tuned(jnp.asarray(kernel.initial_scale(size), cov.dtype), linalg.cholesky(linalg.symmetric(cov + least)))


class Between(NamedTuple):
    """Log density of prior times likelihood^b, at one point."""

    prior: Law
    log_likelihood: Any
    b: jax.Array

    def __call__(self, x: jax.Array) -> jax.Array:
        """Return it; outside the prior the likelihood need not be a number."""
        prior = self.prior.log_prob(x)
        return jnp.where(jnp.isfinite(prior), prior + self.b * self.log_likelihood(x), -jnp.inf)


def _after_moves(key: jax.Array, kernel: Kernel, log_density: Between, particles: jax.Array, moves: int) -> tuple[jax.Array, jax.Array]:
    repeated = Repeat(kernel, moves)

    def one(key: jax.Array, x: jax.Array) -> tuple[jax.Array, jax.Array]:
        state, info = repeated.step(key, log_density, repeated.init(key, log_density, x), 0)
        return ravel_pytree(state.position)[0], jnp.sum(info.accepted) / jnp.maximum(jnp.sum(info.tried), 1)

    keys = random.step_keys(key, particles.shape[-1])
    moved, shares = jax.vmap(one, in_axes=(0, -1), out_axes=(-1, 0))(keys, particles)
    return moved, jnp.mean(shares)
