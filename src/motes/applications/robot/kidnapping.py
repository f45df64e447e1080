"""A robot that is carried elsewhere: its recording with a part of the way cut out, and the filter that finds it again."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from motes.core import checks
from motes.core.record import replace
from motes.filters.particle import ParticleFilter
from motes.filters.recovering import Recovering
from motes.io.recordings import RangeOnlyRecording

CARRIED, LEAST = 31.0, 5.0
"""Meters that the robot is carried, or nearly as far as it goes, but no less than that."""
TRUST = 1.5
"""Ranges count with a standard deviation so many times theirs: 5 000 particles are few for six states."""
NEAR, STAYS = 2.0, 10.0
"""The robot counts as found where the error stays below so many meters for so many seconds."""


def carried(recording: RangeOnlyRecording, turns: np.ndarray, after: float) -> tuple[RangeOnlyRecording, np.ndarray]:
    """Cut out a part of the way, so that the robot is elsewhere from one step to the next; its odometry says that it stood.

    Args:
        recording: the whole way.
        turns: of the odometry, `(t - 1,)`, radians.
        after: when it is carried, seconds.

    Returns:
        The recording without the part, and its turns.

    Raises:
        MotesError: it is not under way then, or never comes far from where it is.
    """
    times = recording.truth[:, 0]
    if not 0 < after < times[-1]:
        checks.refuse("kidnap", f"0, or seconds within the recording, which has {times[-1]:.0f}", after)
    at = int(np.searchsorted(times, after, "right")) - 1
    apart = np.hypot(*(recording.truth[at:, 1:3] - recording.truth[at, 1:3]).T)
    if apart.max() < LEAST:
        checks.refuse("kidnap", f"a time after which the robot goes {LEAST:.0f} m at least", f"{after:g}, and then {apart.max():.1f} m")
    away = at + int(np.argmax(apart >= min(CARRIED, 0.9 * apart.max())))
    kept = np.r_[0 : at + 1, away : len(times)]
    # the step that remains leads from one place to the other and counts no turn of a wheel
    gone = times[away] - times[at] - np.median(np.diff(times))
    truth, drifting = recording.truth[kept], recording.drifting_path[kept]
    odometry, turned = (np.concatenate([rows[:at], 0 * rows[away - 1 : away], rows[away:]]) for rows in (recording.odometry, turns))
    ranges = recording.ranges[(recording.ranges[:, 0] <= times[at]) | (recording.ranges[:, 0] >= times[away])].copy()
    truth[at + 1 :, 0] -= gone
    ranges[ranges[:, 0] > times[at], 0] -= gone
    odometry[:, 0] = truth[1:, 0]
    return replace(recording, truth=truth, odometry=odometry, drifting_path=drifting, ranges=ranges), turned


def recovering(beacons: np.ndarray, states: int) -> Recovering:
    """Return the filter of a robot that may be carried anywhere: particles are drawn anew on the ring of the present range.

    Args:
        beacons: places, `(b, 2)`, meters.
        states: of the model; those behind place and heading, which no kidnapper changes, the particles keep.
    """
    return Recovering(ParticleFilter(n=5_000, on_collapse="predict"), _on_the_ring(beacons, states))


def _on_the_ring(beacons: np.ndarray, states: int) -> Callable[..., jax.Array]:
    places = jnp.asarray(beacons, jnp.result_type(float))

    def drawn(key: jax.Array, y: jax.Array, u: Any, t: Any) -> jax.Array:
        bearing, heading = jax.random.uniform(key, (2,), minval=-jnp.pi, maxval=jnp.pi)
        beacon = jnp.argmax(~jnp.isnan(y))
        place = places[beacon] + y[beacon] * jnp.stack([jnp.cos(bearing), jnp.sin(bearing)])
        return jnp.concatenate([place, heading[None], jnp.full((states - 3,), jnp.nan)])

    return drawn


def found_after(times: np.ndarray, error: np.ndarray, begin: int) -> float:
    """Return the seconds after a step until the error, meters, stays small; infinite where it never does."""
    good = error < NEAR
    for step in range(begin, len(times)):
        if good[step : np.searchsorted(times, times[step] + STAYS)].all():
            return float(times[step] - times[begin])
    return np.inf
