"""Several runs as one: filters that shared the load, or filters of several models (Bolic, Djuric, Hong 2005)."""

from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from motes.core import checks
from motes.filters.history import History

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
    histories = list(histories)
    if not histories:
        checks.refuse("combined histories", "at least one", "none")
    for history in histories:
        checks.instance("combined histories", history, History, "what mo.run gave, or History.load")
        if checks.is_concrete(history.start) and int(history.start) != 0:
            hint = "Put pieces together with mo.filters.joined."
            checks.refuse("combined histories", "runs from step 0 on", f"one from step {int(history.start)}", hint)
    shapes = {tuple(np.shape(history.mean)) for history in histories}
    if len(shapes) > 1:
        checks.refuse("combined histories", "runs over the same steps, of models with the same states", f"means of shapes {sorted(shapes)}")
    evidence = jnp.stack([history.log_evidence for history in histories], axis=1)
    so_far = jnp.cumsum(evidence, axis=0)
    likelihood = jax.nn.logsumexp(so_far, axis=1) - jnp.log(len(histories))
    found = jnp.where(jnp.isfinite(likelihood), likelihood, -jnp.inf)
    log_evidence = jnp.concatenate([found[:1], jnp.where(jnp.isfinite(found[:-1]), found[1:] - found[:-1], -jnp.inf)])
    weights = jax.nn.softmax(so_far, axis=1) if by == "evidence" else jnp.full(evidence.shape, 1 / len(histories))
    if by == "evidence" and len(histories) > 1 and checks.is_concrete(weights):
        _warn(np.asarray(weights))
    means, covs = (jnp.stack([getattr(history, name) for history in histories], axis=1) for name in ("mean", "cov"))
    mean = jnp.einsum("tr,trx->tx", weights, means)
    off = means - mean[:, None]
    cov = jnp.einsum("tr,trxz->txz", weights, covs + off[..., :, None] * off[..., None, :])
    return Combined(mean, cov, log_evidence, weights)


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
