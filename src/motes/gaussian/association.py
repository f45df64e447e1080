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
from motes.laws.cluttered import Cluttered
from motes.laws.conditional import Conditional
from motes.laws.gaussian import Correction, Gaussian


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
    if not isinstance(sensor, Cluttered):
        return rule.measured(sensor, law, y, u, t)
    shared, probability = sensor.shared(y.value), sensor.detected(law.center, u, t)
    hit, miss = jnp.log(probability), shared.missed + jnp.log1p(-probability)
    each = jax.vmap(lambda z: rule.measured(sensor.sensor, law, z, u, t))(y.value)
    gains = shared.gains.reshape(-1, *[1] * (law.center.ndim - 1))

    def joined(log_density: jax.Array) -> jax.Array:
        none = jnp.broadcast_to(miss, (1, *log_density.shape[1:]))
        return jnp.concatenate([none, jnp.where(jnp.isfinite(gains), hit + gains + log_density, -jnp.inf)])

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
    return Correction(after, shared.base + total, shared.base + jax.nn.logsumexp(joined(each.max_log_evidence), axis=0))
