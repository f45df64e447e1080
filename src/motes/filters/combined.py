"""Several runs as one: filters that shared the load, or filters of several models (Bolic, Djuric, Hong 2005)."""

from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from motes.core import checks
from motes.filters.history import History
from motes.laws import circular

ALONE = 0.9
"""Weight of one run from which on the others count for little."""


class Combined(NamedTuple):
    """What several runs say together.

    Attributes:
        mean: `(t, x)`.
        cov: `(t, x, x)`: what the runs leave, and how far their means lie apart.
        log_evidence: of each measurement given those before it, `(t,)`.
        weights: of the runs at each step, `(t, r)`; those by evidence are proportional to the likelihood of all measurements so far.
    """

    mean: jax.Array
    cov: jax.Array
    log_evidence: jax.Array
    weights: jax.Array

    @property
    def log_likelihood(self) -> jax.Array:
        """Log density of all measurements, `()`."""
        return jnp.sum(self.log_evidence)


def combined(histories: Sequence[History], by: str = "evidence") -> Combined:
    """Combine runs over the same measurements: of one filter with several keys, which shared the load, or of several models.

    The evidence of all is the mean of their likelihoods in any case, which is unbiased where each is: log of the mean of exp of the log
    likelihood (`logmeanexp`). By "evidence" the weights of the runs are their likelihoods so far: the law given the data where models are
    equally probable beforehand, or where many small filters stand for a large one. Such weights degenerate: log likelihoods of
    independent runs drift apart, and soon one run has all; a warning says so. By "average" all count alike: of independent filters of one
    model the mean then keeps the bias of each, and lost ones spoil it.

    Source: Bolic, Djuric, Hong 2005, Resampling algorithms and architectures for distributed particle filters; Crisan, Miguez, Rios-Munoz
    2018, On the performance of parallelisation schemes for particle filtering.

    Example:
        >>> model = mo.textbook.growth()
        >>> xs, ys = mo.simulate(0, model, 50)
        >>> runs = [mo.run(key, mo.ParticleFilter(n=500), model, ys) for key in range(4)]
        >>> mo.combined(runs, by="average").mean.shape
        (50, 1)

    Args:
        histories: from step 0 on, with means and covariances.
        by: "evidence" or "average".

    Raises:
        MotesError: there is no history, they do not begin at step 0 or differ in length or states, or their filters know no evidence.
    """
    checks.option("combined by", by, ("evidence", "average"))
    histories = _combinable(histories)
    evidence = jnp.stack([history.log_evidence for history in histories], axis=1)
    by_evidence = _log_weights(evidence)
    equal = jnp.full_like(evidence, -jnp.log(len(histories)))
    log_evidence = jax.nn.logsumexp(jnp.concatenate([equal[:1], by_evidence[:-1]]) + evidence, axis=1)
    log_weights = by_evidence if by == "evidence" else equal
    weights = jnp.exp(log_weights)
    if by == "evidence" and len(histories) > 1 and checks.is_concrete(weights):
        _warn(np.asarray(weights))
    means, covs = (jnp.stack([getattr(history, name) for history in histories], axis=1) for name in ("mean", "cov"))
    # each run has its angles on a branch of its own
    means = circular.gathered(jnp.transpose(means, (2, 1, 0)), log_weights.T, histories[0].circular).T
    mean = jnp.einsum("tr,trx->tx", weights, means)
    off = means - mean[:, None]
    cov = jnp.einsum("tr,trxz->txz", weights, covs + off[..., :, None] * off[..., None, :])
    return Combined(mean, cov, log_evidence, weights)


def _combinable(histories: Any) -> list[History]:
    """Return what can be combined as a list, or refuse it."""
    if isinstance(histories, History) or not isinstance(histories, Iterable):
        checks.refuse("combined histories", "a list of what mo.run gave", type(histories).__name__)
    histories = list(histories)
    if not histories:
        checks.refuse("combined histories", "at least one", "none")
    for history in histories:
        checks.instance("combined histories", history, History, "what mo.run gave, or History.load")
        if np.ndim(history.start):
            checks.refuse("combined histories", "single runs, one after the other", f"a batch of {np.size(history.start)}")
        if checks.is_concrete(history.start) and int(history.start) != 0:
            hint = "Put pieces together with mo.filters.joined."
            checks.refuse("combined histories", "runs from step 0 on", f"one from step {int(history.start)}", hint)
    expected = "runs over the same steps, of models with the same states"
    shapes = {tuple(np.shape(history.mean)) for history in histories}
    if len(shapes) > 1:
        checks.refuse("combined histories", expected, f"means of shapes {sorted(shapes)}")
    states = {(history.names, history.circular) for history in histories}
    if len(states) > 1:
        told = " and ".join(sorted(f"{', '.join(names)} (angles: {list(angles)})" for names, angles in states))
        checks.refuse("combined histories", expected, f"states {told}")
    return histories


def _log_weights(evidence: jax.Array) -> jax.Array:
    """Log weights of the runs after each step, `(t, r)`, in proportion to their likelihoods so far; equal where all of these vanish.

    What is added up is how far each stays behind the best of a step: sums of log evidences themselves would leave no digits in long runs.
    """
    best = jnp.max(evidence, axis=1, keepdims=True)
    behind = jnp.cumsum(jnp.where(jnp.isfinite(best), evidence - best, 0), axis=0)
    lost = jnp.max(behind, axis=1, keepdims=True) == -jnp.inf
    return jax.nn.log_softmax(jnp.where(lost, 0, behind), axis=1)


def _warn(weights: np.ndarray) -> None:
    """Warn where one of the runs has nearly all of the weight."""
    heaviest = weights.max(axis=1)
    if heaviest[-1] > ALONE:
        step = int(np.argmax(heaviest > ALONE))
        checks.warn(
            f"combined: evidence weights degenerate: one of {weights.shape[1]} runs has {heaviest[-1]:.2f} of the weight at the end (more "
            f"than {ALONE} first at step {step}). Of several models this may be the answer; of filters that share the load, let them "
            "exchange particles: mo.Distributed with mo.Proportional() or mo.Ring(0.1)."
        )
