"""Tracks of targets whose number is not known and changes, each with a probability of existence (Musicki, Evans, Stankovic 1994).

Scan by scan, for all tracks at once:

1. Each is filtered on its own with all plots of the scan. With L the likelihood of the scan with its target over that of false plots alone,
   its existence is r L / (1 - r + r L), where r has fallen since the scan before by the probability that the target went away.
2. Those that hardly exist end, and of two that are one and the same the younger does. Those that exist almost surely are confirmed.
3. Plots that no track explains begin new ones, M of N.

What a radar does not see in its notch speaks for no target nor against: there L is near one. Plots of other targets are false ones to a
track, so that targets that fly together within the accuracy of the radar for long may end as one track.
"""

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from motes.applications.target_tracking.beginning import SCANS, Beginning, beginnings, explained
from motes.applications.target_tracking.settings import Radar
from motes.core import random
from motes.core.logspace import RunningSum
from motes.core.record import replace
from motes.filters.history import Carry, History
from motes.filters.info import Info
from motes.filters.interface import Filter
from motes.filters.setup import setup
from motes.laws.observed import Observed
from motes.tracing.compiling import jitted

BEGINS, CONFIRMED, ENDS = 0.2, 0.99, 0.01
"""Existence of a track that begins, above which it is confirmed for good, and below which it ends."""
STAYS = 600.0
"""Mean time for which a target is there, s."""
SAME = 4.0
"""Squared distance of the states of two tracks in standard deviations below which they are one."""
SLOTS = 8
"""Tracks that there is room for at first; the room doubles when it is full."""
STATES = 4


class Tracks(NamedTuple):
    """The tracks at a scan, in slots of which some are free.

    Attributes:
        number: of each track in the order in which they began, `(slots,)`; -1 of a free slot.
        confirmed: whether it is, `(slots,)`.
        carries: what its filter hands from step to step, slots first.
        exists: probability of existence, `(slots,)`.
        mean: states, `(slots, 4)`.
        cov: their covariance, `(slots, 4, 4)`.
    """

    number: np.ndarray
    confirmed: np.ndarray
    carries: Carry
    exists: np.ndarray
    mean: np.ndarray
    cov: np.ndarray

    @property
    def living(self) -> np.ndarray:
        """Slots that hold a track."""
        return np.flatnonzero(self.number >= 0)


def existence(before: Any, log_ratio: Any) -> jax.Array:
    """Probability of existence after a scan, by that before and the log of the scan's likelihood ratio L."""
    return jax.nn.sigmoid(jax.scipy.special.logit(before) + log_ratio)


def follow(seed: int, filter: Filter, tracker: Any, times: np.ndarray, ys: Observed, radar: Radar) -> History:
    """Follow all targets through some scans.

    Args:
        seed: of the filters.
        filter: of each track.
        tracker: gives the model of a track by mean and covariance where it begins, whose inputs are the durations of the steps,
            `{"dt": ...}`; has the `sensor` of scans in that model. Equal ones share compiled code.
        times: of the scans, s, `(t,)`.
        ys: the scans, `(t, K, 3)`.
        radar: its accuracy.

    Returns:
        A history that keeps, of the m tracks that were confirmed, `states` `(t, m, 4)`, `exists` and `confirmed` `(t, m)`; states are NaN
        and existence is 0 where a track is not there. `info` tells of all tracks together: the largest numbers, the smallest effective
        size.
    """
    follower = Follower(random.as_key(seed), filter, tracker, jax.tree.map(lambda leaf: jnp.asarray(leaf[0]), ys))
    tracks, left, begun, rows, infos = follower.none(), [], 0, [], []
    for scan, dt in enumerate(np.diff(times, prepend=times[0])):
        plots = ys.value[scan]
        tracks, info = follower.advanced(tracks, jax.tree.map(lambda leaf, scan=scan: leaf[scan], ys), dt)
        tracks = confirmed(merged(ended(tracks)))
        left = [*left, unexplained(tracks, plots[~np.isnan(plots).any(axis=1)], radar)][-SCANS:]
        for begin in beginnings(times[scan + 1 - len(left) : scan + 1], left, radar):
            tracks, begun = follower.begun(tracks, begin, begun), begun + 1
        rows.append([(tracks.number[slot], tracks.exists[slot], tracks.confirmed[slot], tracks.mean[slot]) for slot in tracks.living])
        infos.append(info)
    return _history(filter, rows, infos, tracks, jax.tree.map(lambda leaf: jnp.asarray(leaf[-1]), ys), times)


def ended(tracks: Tracks) -> Tracks:
    """Free the slots of tracks that hardly exist, or whose filter failed."""
    return tracks._replace(number=np.where(tracks.exists >= ENDS, tracks.number, -1))


def merged(tracks: Tracks) -> Tracks:
    """Free the slot of the younger of two tracks that are one and the same: near beside their uncertainty, velocities too."""
    number = tracks.number.copy()
    ages = tracks.living[np.argsort(number[tracks.living])]
    for place, young in enumerate(ages):
        older = [old for old in ages[:place] if number[old] >= 0]
        off = tracks.mean[older] - tracks.mean[young]
        squares = np.sum(off * np.linalg.solve(tracks.cov[older] + tracks.cov[young], off[..., None])[..., 0], axis=-1)
        if (squares < SAME).any():
            number[young] = -1
    return tracks._replace(number=number)


def confirmed(tracks: Tracks) -> Tracks:
    """Confirm tracks that exist almost surely; they stay so until they end."""
    return tracks._replace(confirmed=(tracks.confirmed | (tracks.exists > CONFIRMED)) & (tracks.number >= 0))


def unexplained(tracks: Tracks, plots: np.ndarray, radar: Radar) -> np.ndarray:
    """Return the plots `(k, 3)` of a scan that are near no track."""
    free = np.ones(len(plots), bool)
    for slot in tracks.living:
        free &= ~explained(tracks.mean[slot], tracks.cov[slot], plots, radar)
    return plots[free]


class Follower(NamedTuple):
    """What filters all tracks; compiled once for each number of slots.

    Attributes:
        key: of the run.
        filter: of each track.
        tracker: see `follow`.
        y: a scan; only shapes and types matter.
    """

    key: jax.Array
    filter: Filter
    tracker: Any
    y: Observed

    def none(self) -> Tracks:
        """Return slots all of which are free."""
        mean, cov = jnp.zeros(STATES), jnp.eye(STATES)
        carry = _started(self.key, self.filter, self.tracker, self.y, 0, mean, cov)
        carries, mean, cov = jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, (SLOTS, *leaf.shape)), (carry, mean, cov))
        return Tracks(np.full(SLOTS, -1), np.zeros(SLOTS, bool), carries, np.zeros(SLOTS), np.asarray(mean), np.asarray(cov))

    def advanced(self, tracks: Tracks, y: Observed, dt: float) -> tuple[Tracks, Info]:
        """Filter a scan."""
        slots = tracks.carries, tracks.number, tracks.exists
        carries, *found, info = _advanced(self.key, self.filter, self.tracker, slots, y, {"dt": dt})
        exists, mean, cov = (np.array(leaf, np.float64) for leaf in found)
        return tracks._replace(carries=carries, exists=exists, mean=mean, cov=cov), info

    def begun(self, tracks: Tracks, begin: Beginning, number: int) -> Tracks:
        """Put a track into a free slot."""
        if (tracks.number >= 0).all():
            more = tracks._replace(number=np.full_like(tracks.number, -1), confirmed=np.zeros_like(tracks.confirmed))
            tracks = jax.tree.map(lambda *parts: (jnp if isinstance(parts[0], jax.Array) else np).concatenate(parts), tracks, more)
        slot = int(np.argmin(tracks.number))
        carries = _put(tracks.carries, slot, self.key, self.filter, self.tracker, self.y, number, begin.mean, begin.cov)
        filled = {"number": number, "exists": BEGINS, "mean": begin.mean, "cov": begin.cov}
        for name, value in filled.items():
            filled[name] = np.array(getattr(tracks, name))
            filled[name][slot] = value
        return tracks._replace(carries=carries, **filled)


@partial(jitted, static_argnums=2)
def _started(key: jax.Array, filter: Filter, tracker: Any, y: Observed, number: Any, mean: Any, cov: Any) -> Carry:
    """What the filter of a track hands to its first step."""
    u = {"dt": jnp.zeros(())}
    return setup(random.step_key(key, number), filter, tracker(mean, cov), u, y).start(u, y)


@partial(jitted, static_argnums=4)
def _put(carries: Carry, slot: Any, key: jax.Array, filter: Filter, tracker: Any, *track: Any) -> Carry:
    return jax.tree.map(lambda every, one: every.at[slot].set(one), carries, _started(key, filter, tracker, *track))


@partial(jitted, static_argnums=2)
def _advanced(key: jax.Array, filter: Filter, tracker: Any, slots: Any, y: Observed, u: Any) -> tuple[Any, ...]:
    """Filter a scan; of slots what is handed on, number and existence are given.

    Returns:
        What is handed on, existence, mean and covariance of each slot, and the record of all together.
    """
    carries, numbers, exists = slots
    ready, stays = setup(key, filter, tracker(jnp.zeros(STATES), jnp.eye(STATES)), u, y), jnp.exp(-u["dt"] / STAYS)

    def one(carry: Carry, number: jax.Array, exists: jax.Array) -> tuple[Any, ...]:
        after, info = replace(ready, key=random.step_key(key, number)).step(carry, y, u)
        ratio = jnp.where(y.there, info.log_evidence - tracker.sensor.all_false(y.value)[0], 0)
        mean, cov = after.state.mean()[:STATES], after.state.cov()[:STATES, :STATES]
        return after, existence(stays * exists, ratio), mean, cov, info

    after, exists, mean, cov, info = jax.vmap(one)(carries, numbers, exists)
    return after, exists, mean, cov, _together(info, numbers >= 0)


def _together(info: Info, living: jax.Array) -> Info:
    """Return one record of all tracks at a scan."""
    largest = jax.tree.map(lambda leaf: jnp.max(jnp.where(living, leaf, jnp.zeros_like(leaf)), axis=0), info)
    nothing = jnp.zeros_like(largest.log_evidence)
    return replace(largest, ess=jnp.min(jnp.where(living, info.ess, jnp.inf)), log_evidence=nothing, nis=nothing,
                   freedom=jnp.zeros_like(largest.freedom))  # fmt: skip


def _history(filter: Filter, rows: list[Any], infos: list[Info], tracks: Tracks, y: Any, times: np.ndarray) -> History:
    """Keep the tracks that were confirmed; `rows` holds number, existence, whether confirmed, and states of each at each scan."""
    numbers = sorted({int(number) for row in rows for number, _, confirmed, _ in row if confirmed})
    places = {number: place for place, number in enumerate(numbers)}
    shape = len(rows), len(numbers)
    kept = {"states": np.full((*shape, STATES), np.nan), "exists": np.zeros(shape), "confirmed": np.zeros(shape, bool)}
    for scan, row in enumerate(rows):
        for number, *values in row:
            if int(number) in places:
                for name, value in zip(("exists", "confirmed", "states"), values, strict=True):
                    kept[name][scan, places[int(number)]] = value
    info = jax.tree.map(lambda *leaves: jnp.stack(leaves), *infos)
    zero = jnp.zeros((), info.log_evidence.dtype)
    last = Carry(tracks.carries.state, RunningSum.zero(zero.dtype), zero, y, None, jnp.int32(len(rows) - 1))
    traits: dict[str, Any] = filter.traits | {"has_evidence": False}
    return History(kept, info, last, jnp.int32(0), ("east", "north", "v_east", "v_north"), repr(filter), **traits, times=np.asarray(times))
