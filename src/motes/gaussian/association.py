"""Probabilistic data association (Bar-Shalom, Li 1995, section 3.4): a Gaussian conditioned on a set of plots of which one may be its own.

1. Condition on each plot alone, as if it were the target's: m_j, P_j, and the predictive density p(z_j).
2. Weigh them: beta_j = P_D p(z_j) / kappa(z_j), and beta_0 = 1 - P_D for none of them, brought to the sum of one.
3. Keep mean and covariance of the mixture, P = sum_j beta_j (P_j + (m_j - m)(m_j - m)'), in which is the spread of the innovations.

Conditioning is by any rule for moments. The probability of detection is taken at the predicted mean.
"""

from typing import Any

import jax
import jax.numpy as jnp

from motes.core import linalg
from motes.gaussian.rule import Rule
from motes.laws.cluttered import CHUNK, Cluttered
from motes.laws.conditional import Conditional
from motes.laws.gaussian import Correction, Gaussian
from motes.laws.independent import Together


def conditioned(rule: Rule, sensor: Conditional, law: Gaussian, y: Any, u: Any, t: Any) -> Correction:
    """Condition a Gaussian, or each of a batch, on a measurement of any sensor: sets of plots by data association, others by the rule.

    Args:
        rule: for moments.
        sensor: of the model.
        law: mean `(x,)` or `(x, n)`.
        y: the measurement `(y,)`, or the scan.
        u: inputs of the step.
        t: the time.

    Returns:
        The correction, `count` 0 of a scan: no innovation has a freedom of so many components.
    """
    if isinstance(sensor, Together):
        return _in_turn(rule, sensor, law, y, u, t)
    if not isinstance(sensor, Cluttered):
        return rule.measured(sensor, law, y, u, t)
    shared, probability = sensor.shared(y.value), sensor.detected(law.center, u, t)
    hit, miss = jnp.log(probability), shared.missed + jnp.log1p(-probability)
    rows, gains, own = y.value, shared.gains, sensor.sensor

    def over(rows: jax.Array, gains: jax.Array) -> Correction:
        each = jax.vmap(lambda z: rule.measured(own, law, z, u, t))(rows)
        done = _mixture(law, each, hit + gains.reshape(-1, *[1] * (law.center.ndim - 1)), miss)
        return done._replace(log_evidence=shared.base + done.log_evidence, max_log_evidence=shared.base + done.max_log_evidence)

    if rows.shape[0] <= CHUNK:
        return over(rows, gains)
    # of many plots those that no Gaussian can tell from clutter are left out, where few are left then
    expected = rule.through(own, law, u, t)
    means, cov = (expected.center[:, None], expected.covariance) if law.center.ndim == 1 else (expected.center, expected.covariance)
    wanted = sensor.wanted(rows, gains, jnp.min(miss), means, cov)
    order = jnp.argsort(~wanted)
    few = order[:CHUNK]
    return jax.lax.cond(jnp.sum(wanted) <= CHUNK, lambda: over(rows[few], gains[few]), lambda: over(rows, gains))


def _in_turn(rule: Rule, sensor: Together, law: Gaussian, y: Any, u: Any, t: Any) -> Correction:
    """Condition on what each of several sensors measured, one after the other."""
    evidence, highest = (jnp.zeros(law.center.shape[1:], law.center.dtype),) * 2
    for part, own, there in sensor.measured(y):
        done = conditioned(rule, part, law, own, u, t)
        law = jax.tree.map(lambda new, old, there=there: jnp.where(there, new, old), done.law, law)
        evidence = evidence + jnp.where(there, done.log_evidence, 0)
        highest = highest + jnp.where(there, done.max_log_evidence, 0)
    return Correction(law, evidence, highest)


def _mixture(law: Gaussian, each: Correction, gains: jax.Array, miss: jax.Array) -> Correction:
    """Keep mean and covariance of a Gaussian and of what each plot makes of it (steps 2 and 3).

    Args:
        law: before.
        each: given each plot, the axis of plots first.
        gains: logs of what each plot's density is multiplied by, `(K, *n)`; minus infinity where there is no plot.
        miss: log weight of no plot.
    """

    def joined(log_density: jax.Array) -> jax.Array:
        none = jnp.broadcast_to(miss, (1, *log_density.shape[1:]))
        return jnp.concatenate([none, jnp.where(jnp.isfinite(gains), gains + log_density, -jnp.inf)])

    terms = joined(each.log_evidence)
    total = jax.nn.logsumexp(terms, axis=0)
    shares = jnp.exp(terms - jnp.where(jnp.isfinite(total), total, 0))
    centers = jnp.concatenate([law.center[None], each.law.center])
    covs = jnp.concatenate([jnp.broadcast_to(law.covariance, each.law.covariance.shape[1:])[None], each.law.covariance])
    off = centers - law.center
    middle = jnp.sum(shares[:, None] * off, axis=0)
    off = off - middle
    spread = jnp.sum(shares[:, None, None] * (covs + off[:, :, None] * off[:, None]), axis=0)
    # where nothing explains the scan the law stays: zero weight would not hide moments of zero
    lost = ~jnp.isfinite(total)
    after = Gaussian(jnp.where(lost, law.center, law.center + middle), jnp.where(lost, covs[0], linalg.symmetric(spread)))
    return Correction(after, total, jax.nn.logsumexp(joined(each.max_log_evidence), axis=0))
