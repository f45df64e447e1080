"""Posterior of a change (Shiryaev 1963): the change comes with the same probability at every step.

With L_t the evidence ratio of a step and p the rate, the posterior odds of a change by now are O_t = (O_{t-1} + p) / (1 - p) L_t. Among
detectors that give false alarms with the same probability it has the least mean delay.
"""

from math import inf

import jax
import jax.numpy as jnp
from jax.typing import ArrayLike

from motes.core import checks
from motes.detect.detection import Detection, detection, ratios_of, told


def shiryaev(ratios: ArrayLike, rate: float | jax.Array, threshold: float = inf) -> Detection:
    """Detect a change by its posterior probability, where it has a geometric prior.

    The statistic is the log odds: `jax.nn.sigmoid` of it is the probability, which rounding soon makes 1.

    Source: Shiryaev 1963, On optimum methods in quickest detection problems.

    Args:
        ratios: log evidence of each step with the changed model less that with the model as before, `(t,)` or `(runs, t)`; NaN where
            nothing was measured.
        rate: probability that the change comes at a step, the first included, if it has not come before.
        threshold: log odds above which there is an alarm; log 19 for a probability of 0.95.

    Returns:
        Log odds, the onset (the most probable step of the change) and the alarm, all of them for each run.

    Raises:
        MotesError: the ratios are no numbers, or infinite, or the rate does not lie between 0 and 1.
    """
    checks.probability("shiryaev rate", rate)
    ratios = ratios_of("shiryaev ratios", ratios)
    return _shiryaev(ratios, jnp.asarray(rate, ratios.dtype), threshold)


def shiryaev_step(statistic: ArrayLike, ratio: ArrayLike, rate: float | jax.Array) -> jax.Array:
    """Return the log odds after one more step; they begin with minus infinity.

    Args:
        statistic: the log odds before it, `(...)`.
        ratio: log-evidence ratio of the step, `(...)`; NaN where nothing was measured: time goes on.
        rate: as in `shiryaev`.

    Raises:
        MotesError: the rate does not lie between 0 and 1.
    """
    checks.probability("shiryaev_step rate", rate)
    return jnp.logaddexp(statistic, jnp.log(rate)) - jnp.log1p(-rate) + told(ratio)


@jax.jit
def _shiryaev(ratios: jax.Array, rate: jax.Array, threshold: ArrayLike) -> Detection:
    return detection(lambda odds, ratio: shiryaev_step(odds, ratio, rate), -jnp.inf, ratios, jnp.log1p(-rate), threshold)
