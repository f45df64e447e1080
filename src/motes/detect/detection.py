"""What detectors share: what they take, what they give, and how their thresholds are found.

A detector reads the log-evidence ratio of each step, log p(y_t | y_0..t-1, changed) - log p(y_t | y_0..t-1, as before): the difference of
`log_evidence` of two runs over the same measurements, one with the model after a change and one with that before.
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike

from motes.core import checks
from motes.core.loop import loop
from motes.core.record import record
from motes.filters.data import refuse_infinite


@record
class Detection:
    """What a detector says of each step.

    Attributes:
        statistic: how much speaks for a change by now, in nats, `(..., t)`.
        onset: most likely first step after the change, as seen from each step, `(..., t)`.
        alarm: first step at which the statistic is above the threshold; -1 where it never is, `(...)`.
    """

    statistic: jax.Array
    onset: jax.Array
    alarm: jax.Array

    @property
    def change(self) -> jax.Array:
        """Most likely first step after the change, as seen from the alarm; -1 where there is none, `(...)`."""
        at = jnp.maximum(self.alarm, 0)[..., None]
        return jnp.where(self.alarm < 0, -1, jnp.take_along_axis(self.onset, at, axis=-1)[..., 0])


def ratios_of(argument: str, ratios: ArrayLike) -> jax.Array:
    """Return log-evidence ratios as an array `(..., t)`.

    Raises:
        MotesError: they are no numbers, there are none, or one is infinite.
    """
    given = checks.as_float(argument, ratios)
    if not given.ndim or not given.shape[-1]:
        checks.refuse(argument, "an array (steps,) or (runs, steps)", f"shape {given.shape}")
    if checks.is_concrete(given):
        refuse_infinite(argument, given, given.dtype)
    return given


def told(ratio: ArrayLike) -> jax.Array:
    """Return what one step tells: nothing where nothing was measured (NaN)."""
    return jnp.where(jnp.isnan(ratio), 0, ratio)


def detection(step: Callable[..., jax.Array], first: float, ratios: jax.Array, drift: ArrayLike, above: ArrayLike) -> Detection:
    """Go through ratios `(..., t)`.

    Args:
        step: from the statistic and the ratio of a step to the statistic after it.
        first: the statistic before the first step.
        ratios: `(..., t)`.
        drift: log prior probability of a change at a step, less that of one at the step before.
        above: the threshold.
    """

    def advance(carry: Any, row: tuple[jax.Array, jax.Array]) -> tuple[Any, Any]:
        statistic, best, onset = carry
        t, ratio = row
        # log posterior probability of the best onset so far, less that of one at this step: it stays so as long as it is above zero
        new = best <= 0
        best = jnp.where(new, 0, best) + told(ratio) - drift
        statistic, onset = step(statistic, ratio), jnp.where(new, t, onset)
        return (statistic, best, onset), (statistic, onset)

    rows = (jnp.arange(ratios.shape[-1], dtype=jnp.int32), jnp.moveaxis(ratios, -1, 0))
    none = jnp.zeros(ratios.shape[:-1], ratios.dtype)
    start = (jnp.full_like(none, first), none, jnp.zeros(none.shape, jnp.int32))
    statistic, onset = jax.tree.map(lambda leaf: jnp.moveaxis(leaf, 0, -1), loop(advance, start, rows)[1])
    over = statistic > above
    alarm = jnp.where(jnp.any(over, axis=-1), jnp.argmax(over, axis=-1).astype(jnp.int32), -1)
    return Detection(statistic, onset, alarm)


def threshold(statistics: ArrayLike, share: float) -> float:
    """Return the threshold above which no more than a share of runs without a change ever rise.

    Args:
        statistics: of runs without a change, `(runs, steps)`; the share holds for as many steps.
        share: of the runs that may give a false alarm; among `runs` of them the share of further runs is known to about
            sqrt(share (1 - share) / runs).

    Raises:
        MotesError: the share does not lie between 0 and 1, there are fewer than 1 / share runs, or a statistic is not a number.
    """
    checks.probability("threshold share", share)
    given = np.asarray(checks.as_numbers("threshold statistics", statistics))
    checks.shape("threshold statistics", given, (None, None), "(runs, steps)")
    checks.finite("threshold statistics", given)
    allowed = int(share * len(given) + 1e-9)
    if not allowed or not given.shape[1]:
        checks.refuse("threshold statistics", f"at least {int(np.ceil(1 / share))} runs, one of which is a share of {share:g}",
                      f"shape {given.shape}")
    return float(np.sort(given.max(axis=1))[-1 - allowed])
