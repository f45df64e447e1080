"""The record of a step: what a reader wants to know of it, and how weights and corrections say so."""

import jax
import jax.numpy as jnp

from motes.core import logspace
from motes.core.record import record, replace
from motes.filters.alarm import Innovation
from motes.laws.gaussian import Correction

HOPELESS = 1e4
"""A measurement this many nats below a perfect fit (141 standard deviations) for the best particle counts as a collapse."""


@record
class Info:
    """What a reader wants to know of one step; the next step does not need it.

    Attributes:
        log_evidence: log density of the measurement given those before it; 0 when nothing was measured.
        ess: effective sample size after the measurement; infinite for laws without sampling error.
        collapsed: whether all weights vanished, so that the measurement was not used.
        invalid: number of particles whose likelihood was not a number; they get no weight.
        lowest: smallest log likelihood over the particles.
        highest: largest log likelihood over the particles.
        shortfall: nats by which the best particle falls short of a perfect fit; half the squared normalized innovation of filters whose
            law has no weights; 0 where the largest possible likelihood is not known.
        nis: squared distance of the measurement from what was predicted of it; chi-square where the filter's claims are right.
        freedom: degrees of freedom of `nis`; 0 where nothing was measured, or where no prediction is known.
        alarm: whether measurements have by now scattered so much more than predicted that the filter's claims are wrong (`alarm.py`).
        gated: 1 where the filter's `gate` left the measurement out, else 0.
        lost: share of the probability that left the filter's grid on the way to this step; 0 of filters without a grid.
        recovered: share of the particles that `Recovering` drew anew; 0 of other filters.
    """

    log_evidence: jax.Array
    ess: jax.Array
    collapsed: jax.Array
    invalid: jax.Array
    lowest: jax.Array
    highest: jax.Array
    shortfall: jax.Array
    nis: jax.Array
    freedom: jax.Array
    alarm: jax.Array
    gated: jax.Array
    lost: jax.Array
    recovered: jax.Array


def weigh(log_weights: jax.Array, log_likelihood: jax.Array, max_log_likelihood: jax.Array) -> tuple[jax.Array, Info]:
    """Multiply weights by likelihoods, and tell whether that is still meaningful.

    Weights have collapsed when they sum to nothing or to infinity, when the best particle is `HOPELESS` nats below the maximum of its
    likelihood, or when the log likelihoods are so large that rounding hides their differences. NaN likelihoods count as zero and are
    reported.

    Args:
        log_weights: normalized, `(n,)`.
        log_likelihood: `(n,)`.
        max_log_likelihood: largest value the log likelihood can take, `()` or `(n,)`; infinite when not known.

    Returns:
        Normalized log weights `(n,)` (not usable where collapsed) and the record of the step.
    """
    weights, found = logspace.joint_weights(log_weights, log_likelihood, max_log_likelihood)
    return weights, info_of(found)


def info_of(found: jax.Array) -> Info:
    """Return the record of a step from the six numbers of `logspace.joint_weights`."""
    log_evidence, ess, invalid, lowest, highest, shortfall = found
    unresolved = jnp.abs(highest) * jnp.finfo(found.dtype).eps > 1
    collapsed = ~jnp.isfinite(log_evidence) | (shortfall > HOPELESS) | unresolved
    none, quiet, count = jnp.zeros_like(ess), jnp.zeros((), bool), invalid.astype(jnp.int32)
    return Info(log_evidence, ess, collapsed, count, lowest, highest, shortfall, none, none, quiet, jnp.int32(0), none, none)


def single(done: Correction) -> Info:
    """Return the record of a step of a filter whose law has no weights."""
    evidence = done.log_evidence
    _, info = weigh(jnp.zeros((1,), evidence.dtype), evidence[None], done.max_log_evidence)
    freedom = jnp.asarray(done.count, evidence.dtype)
    square = jnp.where(freedom > 0, 2 * (done.max_log_evidence - evidence), 0)
    return replace(info, ess=jnp.full_like(evidence, jnp.inf), nis=square, freedom=freedom)


def with_innovation(info: Info, found: Innovation) -> Info:
    """Add to the record of a step how far its measurement lies from the prediction."""
    return replace(info, nis=found.square, freedom=found.freedom)
