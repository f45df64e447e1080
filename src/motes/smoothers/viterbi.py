"""The most probable path of the modes of a hidden Markov model (Viterbi 1967).

A hidden Markov model is a jump-Markov system whose modes know the state: no state is uncertain, and modes differ in what they measure. Its
filter is `InteractingMultipleModel`, which then is the exact forward recursion, and tells how well each mode explains each measurement.

1. e_t(j) = log p(s_t = j | y_0..t) - log p(s_t = j | y_0..t-1), the log density of y_t in mode j but for a constant.
2. d_0(j) = log p(s_0 = j | y_0),   d_t(j) = max over i of d_{t-1}(i) + log transition[i, j], + e_t(j), and the i of the maximum is noted.
3. Follow what was noted, from the largest d at the end.
"""

from typing import Any

import jax
import jax.numpy as jnp

from motes.core import checks
from motes.core.loop import loop
from motes.core.record import record
from motes.filters.history import History
from motes.filters.needs import as_jump_markov
from motes.laws.mode_mixture import ModeMixture
from motes.models.jump_markov import JumpMarkovModel
from motes.smoothers.interface import Smoothed, Smoother, Steps, ask_kind, ask_laws

EPSILONS = 1000
"""Spacings of numbers of the size of a state, as a standard deviation of which it still counts as known."""


@record
class Viterbi(Smoother):
    """The one path of modes that is most probable given all measurements: `smoothed.modes` `(t, 1)`, with its state in `smoothed.paths`.

    Source: Viterbi 1967, Error bounds for convolutional codes and an asymptotically optimum decoding algorithm.

    Example:
        >>> none = [[0.0]]
        >>> parts = [mo.StateSpaceModel(mo.Gaussian([level], none), mo.LinearGaussian([[1.0]], none), mo.LinearGaussian([[1.0]], [[0.5]]))
        ...          for level in (0.0, 0.0)]
        >>> model = mo.JumpMarkovModel([0.5, 0.5], [[0.9, 0.1], [0.2, 0.8]], parts)
        >>> history = mo.run(0, mo.InteractingMultipleModel(), model, [[0.1], [0.3]], keep=mo.keep.laws)
        >>> mo.smooth(1, mo.smoothers.Viterbi(), model, history).modes.shape
        (2, 1)
    """

    lost = ("states that are known, as in a hidden Markov model", "Use MixtureSmoother.")

    def prepare(self, model: Any, history: History, u: Any) -> JumpMarkovModel:
        """Ask for one component for each mode.

        Raises:
            MotesError: the history is of another filter.
        """
        ask_kind("Viterbi", history, ModeMixture)
        ask_laws("Viterbi", history, ModeMixture)
        model = as_jump_markov("Viterbi", model)
        law: ModeMixture = history.law
        if law.log_weights.shape[-1] != model.count:
            checks.refuse("Viterbi history", f"one component for each of {model.count} modes", law.log_weights.shape[-1],
                          "Use MixtureSmoother, or run InteractingMultipleModel.")  # fmt: skip
        return model

    def smooth(self, key: jax.Array, model: JumpMarkovModel, history: History, steps: Steps) -> Smoothed:
        """Find the path."""
        log_weights = history.law.log_weights

        def forward(best: jax.Array, row: Any) -> tuple[jax.Array, jax.Array]:
            before, after, u, t = row
            log_transition = model.log_transition(u, t)
            # 1. how well each mode explains the measurement
            expected = jax.nn.logsumexp(before[:, None] + log_transition, axis=0)
            explained = jnp.where(jnp.isfinite(expected), after - jnp.where(jnp.isfinite(expected), expected, 0), -jnp.inf)
            # 2. the best way into each mode
            ways = best[:, None] + log_transition
            best = jnp.max(ways, axis=0) + explained
            return best - jnp.max(best), jnp.argmax(ways, axis=0).astype(jnp.int32)

        later = jax.tree.map(lambda leaf: leaf[1:], (steps.u, steps.t))
        best, ways = loop(forward, log_weights[0], (log_weights[:-1], log_weights[1:], *later))
        # 3. follow
        last = jnp.argmax(best).astype(jnp.int32)
        _, earlier = jax.lax.scan(lambda mode, way: (way[mode], way[mode]), last, ways, reverse=True)
        path = jnp.concatenate([earlier, last[None]])
        certain = jnp.zeros(1, log_weights.dtype)
        # what rounding leaves of a variance, beside the square of the state, is none
        size = EPSILONS * jnp.finfo(log_weights.dtype).eps * jnp.max(jnp.abs(history.mean), axis=1, keepdims=True)
        uncertain = jnp.any(jnp.diagonal(history.cov, axis1=1, axis2=2) > size**2, axis=1)
        mean = jnp.where(uncertain[:, None], jnp.nan, history.mean)
        return Smoothed(mean, history.cov, mean[..., None], certain, modes=path[:, None])
