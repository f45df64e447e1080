"""Probabilistic data association (Bar-Shalom, Li 1995, sections 3.4 and 6.2): a Gaussian conditioned on a set of plots.

One may be its own:

1. Condition on each plot alone, as if it were the target's: m_j, P_j, and the predictive density p(z_j).
2. Weigh them: beta_j = P_D p(z_j) / kappa(z_j), and beta_0 = 1 - P_D for none of them, brought to the sum of one.
3. Keep mean and covariance of the mixture, P = sum_j beta_j (P_j + (m_j - m)(m_j - m)'), in which is the spread of the innovations.

Of several targets (JPDA) the weights of step 2 are those of all associations together, in which each plot is of one target at most; each
target is then conditioned as above, and what else there is follows its correlation with it.

Conditioning is by any rule for moments. The probability of detection is taken at the predicted mean.
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from motes.core import linalg
from motes.gaussian.rule import Rule
from motes.laws.association import associated, gained, missed
from motes.laws.cluttered import Cluttered
from motes.laws.conditional import Conditional
from motes.laws.gaussian import Correction, Gaussian
from motes.laws.independent import Together
from motes.laws.near_plots import CHUNK, over_few
from motes.laws.several_targets import SeveralTargets


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
    if isinstance(sensor, SeveralTargets):
        return _of_several(rule, sensor, law, y, u, t)
    if not isinstance(sensor, Cluttered):
        return rule.measured(sensor, law, y, u, t)
    shared, probability = sensor.shared(y.value), sensor.detected(law.center, u, t)
    hit, miss = jnp.log(probability), shared.missed + missed(probability, -jnp.inf)

    def over(rows: jax.Array, gains: jax.Array) -> Correction:
        each = _of_each_plot(rule, sensor, law, rows, u, t)

        def total(log_density: jax.Array) -> jax.Array:
            terms = hit + jnp.where(jnp.isfinite(_by_plot(gains, law)), _by_plot(gains, law) + log_density, -jnp.inf)
            return jnp.concatenate([jnp.broadcast_to(miss, (1, *terms.shape[1:])), terms])

        terms = total(each.log_evidence)
        evidence, highest = (jax.nn.logsumexp(one, axis=0) for one in (terms, total(each.max_log_evidence)))
        shares = jnp.exp(terms - jnp.where(jnp.isfinite(evidence), evidence, 0))
        after = _collapsed(law, each.law, shares, ~jnp.isfinite(evidence))
        return Correction(after, shared.base + evidence, shared.base + highest)

    wanted = _wanted(sensor, rule.through(sensor.sensor, law, u, t), y.value, shared.gains, miss)
    return over_few(over, wanted, CHUNK, y.value, shared.gains)


def _of_several(rule: Rule, sensor: SeveralTargets, law: Gaussian, y: Any, u: Any, t: Any) -> Correction:
    """Condition on a scan of several targets, which are an axis, the first."""
    one, shared, own = sensor.one, sensor.shared(y.value), np.array(sensor.indices)
    parts = jax.vmap(law.reordered)(own)

    def seen(part: Gaussian) -> jax.Array:
        return jnp.broadcast_to(one.detected(part.center, u, t), law.center.shape[1:])

    probabilities = jax.vmap(seen)(parts)
    hit, miss = jnp.log(probabilities), missed(probabilities)

    def needs(part: Gaussian, miss: jax.Array) -> jax.Array:
        return _wanted(one, rule.through(one.sensor, part, u, t), y.value, shared.gains, miss)

    def over(rows: jax.Array, gains: jax.Array, false: jax.Array) -> Correction:
        each = jax.vmap(lambda part: _of_each_plot(rule, one, part, rows, u, t))(parts)

        def associations(log_density: jax.Array) -> tuple[jax.Array, jax.Array]:
            return associated(hit[:, None] + gained(_by_plot(gains, law), log_density), miss, false)

        (evidence, shares), (highest, _) = associations(each.log_evidence), associations(each.max_log_evidence)

        def take_in(law: Gaussian, target: tuple[jax.Array, jax.Array]) -> tuple[Gaussian, None]:
            # targets that are correlated have moved with those before
            order, share = target
            law = law.reordered(order)
            part = law.reordered(np.arange(own.shape[1]))
            after = _collapsed(part, _of_each_plot(rule, one, part, rows, u, t).law, share, ~jnp.isfinite(evidence))
            return law.with_first(after).reordered(jnp.argsort(order)), None

        orders = np.array([[*states, *np.setdiff1d(np.arange(law.center.shape[0]), states)] for states in own])
        after, _ = jax.lax.scan(take_in, law, (jnp.asarray(orders), shares))
        return Correction(after, shared.base + evidence, shared.base + highest)

    wanted = shared.certain | jnp.any(jax.vmap(needs)(parts, miss), axis=0)
    return over_few(over, wanted, CHUNK * len(own), y.value, shared.gains, shared.false)


def _of_each_plot(rule: Rule, sensor: Cluttered, law: Gaussian, rows: jax.Array, u: Any, t: Any) -> Correction:
    """Condition on each plot `(K, z)` as if it were the target's; the axis of plots is the first."""
    return jax.vmap(lambda z: rule.measured(sensor.sensor, law, z, u, t))(rows)


def _by_plot(values: jax.Array, law: Gaussian) -> jax.Array:
    """Give numbers of plots `(K,)` the axes of a batch of laws."""
    return values.reshape(-1, *[1] * (law.center.ndim - 1))


def _wanted(sensor: Cluttered, expected: Gaussian, rows: jax.Array, gains: jax.Array, miss: jax.Array) -> jax.Array:
    """Tell which plots a Gaussian, or any of a batch, can tell from clutter, `(K,)`, given the law of its own."""
    means = expected.center[:, None] if expected.center.ndim == 1 else expected.center
    return sensor.wanted(rows, gains, jnp.min(miss), means, expected.covariance)


def _in_turn(rule: Rule, sensor: Together, law: Gaussian, y: Any, u: Any, t: Any) -> Correction:
    """Condition on what each of several sensors measured, one after the other."""
    evidence, highest = (jnp.zeros(law.center.shape[1:], law.center.dtype),) * 2
    for part, own, there in sensor.measured(y):
        done = conditioned(rule, part, law, own, u, t)
        law = jax.tree.map(lambda new, old, there=there: jnp.where(there, new, old), done.law, law)
        evidence = evidence + jnp.where(there, done.log_evidence, 0)
        highest = highest + jnp.where(there, done.max_log_evidence, 0)
    return Correction(law, evidence, highest)


def _collapsed(law: Gaussian, each: Gaussian, shares: jax.Array, lost: jax.Array) -> Gaussian:
    """Keep mean and covariance of a Gaussian and of what each plot makes of it (step 3).

    Args:
        law: before.
        each: given each plot, the axis of plots first.
        shares: probabilities of no plot and of each, `(1 + K, *n)`.
        lost: where nothing explains the scan, `(*n)`; the law stays: zero weight would not hide moments of zero.
    """
    centers = jnp.concatenate([law.center[None], each.center])
    covs = jnp.concatenate([jnp.broadcast_to(law.covariance, each.covariance.shape[1:])[None], each.covariance])
    off = centers - law.center
    middle = jnp.sum(shares[:, None] * off, axis=0)
    off = off - middle
    spread = jnp.sum(shares[:, None, None] * (covs + off[:, :, None] * off[:, None]), axis=0)
    return Gaussian(jnp.where(lost, law.center, law.center + middle), jnp.where(lost, covs[0], linalg.symmetric(spread)))
