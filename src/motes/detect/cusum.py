"""Cumulative sum (Page 1954): the change is at a fixed step of which nothing is known.

With r_t the log-evidence ratio of a step, S_t = max(0, S_{t-1} + r_t) is the largest log likelihood ratio of a change by now: the maximum
over k of r_k + ... + r_t, or 0. Among detectors that give false alarms as rarely it has the least mean delay in the worst case
(Lorden 1971; Moustakides 1986).
"""

from math import inf

import jax
import jax.numpy as jnp
from jax.typing import ArrayLike

from motes.detect.detection import Detection, detection, ratios_of, told


def cusum(ratios: ArrayLike, threshold: float = inf) -> Detection:
    """Detect a change by the cumulative sum of log-evidence ratios.

    Source: Page 1954, Continuous inspection schemes.

    Args:
        ratios: log evidence of each step with the changed model less that with the model as before, `(t,)` or `(runs, t)`; NaN where
            nothing was measured.
        threshold: nats above which the sum gives the alarm.

    Returns:
        Sums, the onset of each (the step after the sum was last zero) and the alarm, all of them for each run.

    Raises:
        MotesError: the ratios are no numbers, or infinite.
    """
    return _cusum(ratios_of("cusum ratios", ratios), threshold)


def cusum_step(statistic: ArrayLike, ratio: ArrayLike) -> jax.Array:
    """Return the sum after one more step; it begins with 0.

    Args:
        statistic: the sum before it, `(...)`.
        ratio: log-evidence ratio of the step, `(...)`; NaN where nothing was measured.
    """
    return jnp.maximum(statistic + told(ratio), 0)


@jax.jit
def _cusum(ratios: jax.Array, threshold: ArrayLike) -> Detection:
    return detection(cusum_step, 0.0, ratios, 0.0, threshold)
