"""Exact proportional allocation over elements: one comb of systematic resampling over all particles, each element working on its own.

1. The masses of the elements, gathered, say how many children those before each have: where its own begin, in the order of all.
2. Each element finds the ends of its particles' children from where they begin.
3. Children are at home in slots; those of a particle near the border of a device can belong to the neighbor, and travel there.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from motes.core import engine
from motes.core.devices import Crew
from motes.laws.elements import normalized_within, one_by_one
from motes.resampling.schemes import boundaries, last_positive

WIDTH = 16
"""Children that a strip between two devices holds, in units of the square root of the number of particles."""


class Shares(NamedTuple):
    """What each element is allotted of n children; all `(K,)`.

    Attributes:
        whole: children of those before it, the whole part, int32.
        part: and the rest, in [0, 1).
        size: its own, not a whole number.
        start: its first child, int32; of the element K, n, in `(K + 1,)`.
    """

    whole: jax.Array
    part: jax.Array
    size: jax.Array
    start: jax.Array


def allotted(masses: jax.Array, u: jax.Array, n: int) -> Shares:
    """Allot n children to elements in proportion to their masses `(K,)`; u in [0, 1) is where the comb begins."""
    size = masses * (n / jnp.sum(masses))
    floors = jnp.floor(size)
    # an element without mass leaves what comes before it as it is, to the bit
    before = jnp.concatenate([jnp.zeros((1,), size.dtype), jnp.cumsum(size - floors)[:-1]])
    carried = jnp.floor(before)
    floors = floors.astype(jnp.int32)
    whole = jnp.cumsum(floors) - floors + carried.astype(jnp.int32)
    part = before - carried
    start = jnp.clip(whole + jnp.ceil(part - u).astype(jnp.int32), 0, n)
    # sums of rounded numbers must not go down, and the last child is the n-th: of the last element that has a mass
    followed = jax.lax.cummax(masses, reverse=True) > 0
    start = jax.lax.cummax(jnp.where(followed, start, n).at[0].set(0))
    return Shares(whole, part, size, jnp.concatenate([start, jnp.full((1,), n, jnp.int32)]))


def ends_of(crew: Crew, log_weights: jax.Array, log_mass: jax.Array, shares: Shares, u: jax.Array) -> jax.Array:
    """Return where the children of each particle end, in the order of all, `(e, m)` int32.

    Args:
        crew: the elements here.
        log_weights: `(e, m)`, normalized over all.
        log_mass: of the elements here, `(e,)`.
        shares: of all elements.
        u: where the comb begins.
    """
    own = [crew.own(one) for one in (shares.whole, shares.start[:-1], shares.start[1:])]
    return ends(log_weights, jnp.stack([log_mass, crew.own(shares.size), crew.own(shares.part) - u], axis=1), jnp.stack(own, axis=1))


@engine.replaceable
def ends(log_weights: jax.Array, numbers: jax.Array, whole: jax.Array) -> jax.Array:
    """Return where the children of the particles of each element end.

    Args:
        log_weights: `(e, m)`.
        numbers: log of the sum of the weights, number of children, and what is added to their running sum, `(e, 3)`.
        whole: the whole part of what is added, and where the first and the last end, `(e, 3)` int32.
    """

    def one(k: jax.Array) -> jax.Array:
        log_mass, size, part = numbers[k]
        before, start, end = whole[k]
        own = normalized_within(log_weights[k][None], log_mass[None])[0]
        edge = boundaries(own, size)
        found = before + edge.whole + jnp.ceil(edge.part + part).astype(jnp.int32)
        return jnp.where(jnp.arange(found.shape[0]) >= last_positive(jnp.exp(own)), end, jnp.clip(found, start, end))

    return one_by_one(one, log_weights.shape[0])


@engine.replaceable
def parents_of(ends: jax.Array, first: jax.Array | int, count: int) -> jax.Array:
    """Return the parent of each of `count` slots from `first` on, from the ends `(s,)` of the children of particles: indices into these.

    Slots of nobody's children get any index.
    """
    at = jnp.clip(ends - first, 0, count)  # beyond the last slot: dropped
    raised = jnp.zeros((count,), jnp.int32).at[at].add(1, mode="drop")
    return jnp.minimum(jnp.cumsum(raised), ends.shape[0] - 1).astype(jnp.int32)


def strip_width(n: int, devices: int) -> int:
    """Return how many children a strip between two devices holds."""
    return min(int(WIDTH * n**0.5), n // devices)


def as_wide(crew: Crew, lanes: Sequence[jax.Array]) -> list[jax.Array]:
    """Return arrays `(..., m)` with room behind for the strips of both neighbors, where there are other devices."""
    room = 0 if crew.devices == 1 else 2 * strip_width(lanes[0].shape[-1] * crew.devices, crew.devices)
    return [jnp.pad(lane, [(0, 0)] * (lane.ndim - 1) + [(0, room)]) for lane in lanes] if room else list(lanes)


class Children(NamedTuple):
    """Where the children of a device's slots are found.

    Attributes:
        source: arrays with the particle axis, `(..., s)`.
        indices: of each child into the source, `(m,)` int32.
        ancestors: of each child, among all particles, `(m,)` int32.
    """

    source: Sequence[jax.Array]
    indices: jax.Array
    ancestors: jax.Array


def delivered(crew: Crew, lanes: Sequence[jax.Array], ends: jax.Array, starts: jax.Array) -> Children:
    """Return the children that belong to the slots of this device, of all particles.

    Args:
        crew: the elements here.
        lanes: arrays of the particles here, `(..., m)`.
        ends: of the children of each of them, `(m,)`.
        starts: first child of each element, `(K + 1,)`.
    """
    size = ends.shape[0]
    if crew.devices == 1:
        parents = parents_of(ends, 0, size)
        return Children(lanes, parents, parents)
    width = strip_width(size * crew.devices, crew.devices)
    of_devices = starts[:: crew.here]
    moved = jnp.max(jnp.abs(of_devices - jnp.arange(crew.devices + 1) * size))
    given = (crew, lanes, ends, of_devices)
    narrow = moved <= width
    return Children(*jax.lax.cond(narrow, lambda: _by_strips(*given, width), lambda: _by_blocks(*given)))


def _by_strips(crew: Crew, lanes: Sequence[jax.Array], ends: jax.Array, starts: jax.Array, width: int) -> Children:
    """Send the children beyond each border to the neighbor, in strips of fixed width."""
    size = ends.shape[0]
    first = crew.place * size
    parents = parents_of(ends, first - width, size + 2 * width)

    def strip(parents: jax.Array) -> tuple[list[jax.Array], jax.Array]:
        return [lane[..., parents] for lane in lanes], parents + first

    before, of_before = crew.from_device(strip(parents[size + width :]), 1)
    after, of_after = crew.from_device(strip(parents[:width]), -1)
    source = [jnp.concatenate(parts, axis=-1) for parts in zip(lanes, before, after, strict=True)]
    # the strip from before covers the first slots here, that from after the last
    slots = jnp.arange(size, dtype=jnp.int32)
    own = parents[width : size + width]
    early, late = slots + first < starts[crew.place], slots + first >= starts[crew.place + 1]
    indices = jnp.where(early, size + slots, jnp.where(late, 2 * width + slots, own))
    padding = jnp.zeros((size - width,), jnp.int32)
    ancestors = jnp.where(early, jnp.concatenate([of_before, padding]), own + first)
    return Children(source, indices, jnp.where(late, jnp.concatenate([padding, of_after]), ancestors))


def _by_blocks(crew: Crew, lanes: Sequence[jax.Array], ends: jax.Array, starts: jax.Array) -> Children:
    """Let the blocks of all devices go round, and take what belongs here from each."""
    size = ends.shape[0]
    slots = crew.place * size + jnp.arange(size, dtype=jnp.int32)

    def take(offset: jax.Array, held: Any) -> Any:
        (block, block_ends), (children, ancestors) = held
        origin = (crew.place - offset) % crew.devices
        parents = parents_of(block_ends, crew.place * size, size)
        mine = (slots >= starts[origin]) & (slots < starts[origin + 1])
        children = [jnp.where(mine, lane[..., parents], child) for lane, child in zip(block, children, strict=True)]
        ancestors = jnp.where(mine, parents + origin * size, ancestors)
        return crew.from_device((block, block_ends), 1), (children, ancestors)

    held = ((list(lanes), ends), ([jnp.zeros_like(lane) for lane in lanes], jnp.zeros_like(ends)))
    _, (children, ancestors) = jax.lax.fori_loop(0, crew.devices, take, held)
    return Children(as_wide(crew, children), jnp.arange(size, dtype=jnp.int32), ancestors)
