"""On how many devices the elements of a filter are shared out, and what a device can ask of the others.

Elements belong to a filter (see `filters/distributed.py`); which device has which is decided here alone, so that no result can depend on
it: each device has as many consecutive elements as any other, and between them go numbers of each element, in the order of elements, and
particles, which are the same wherever they are.
"""

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec

from motes.core import checks

AXIS = "devices"

# part of the key of everything that JAX compiles, as the engine is
_context = jax.make_user_context(None)


def chosen() -> int:
    """Return the number of devices in force: that of the nearest `devices`, else one."""
    return _context.value or 1


def devices(count: int) -> AbstractContextManager[None]:
    """Share out the elements of a `Distributed` filter over devices: `with mo.devices(8): mo.run(...)`.

    Results are the same, to the bit, on any number of them. On a CPU, JAX has one device unless it is told otherwise before it starts:
    `XLA_FLAGS=--xla_force_host_platform_device_count=8`. Filters that are not `Distributed` take no notice.

    Args:
        count: number of devices, one that divides the number of elements of the filter; all of them where processes work as one (`join`).

    Raises:
        MotesError: count is no positive whole number, or there are fewer devices, or other processes would be left without work.
    """
    checks.positive_integer("devices count", count)
    there = jax.device_count()
    if jax.process_count() > 1 and count != there:
        checks.refuse("devices count", f"{there}, all that {jax.process_count()} processes have", count)
    if count > there:
        hint = "On a CPU: XLA_FLAGS=--xla_force_host_platform_device_count=8." if jax.default_backend() == "cpu" else ""
        checks.refuse("devices count", f"at most {there}, as many as JAX has here", count, hint)
    return _context(count)


class Crew(NamedTuple):
    """The elements that a device has, seen from it, and what it can ask of the others.

    Attributes:
        elements: number of elements, K.
        devices: number of devices.
    """

    elements: int
    devices: int

    @property
    def here(self) -> int:
        """Number of elements on each device."""
        return self.elements // self.devices

    @property
    def place(self) -> Any:
        """Number of this device."""
        return 0 if self.devices == 1 else jax.lax.axis_index(AXIS)

    @property
    def first(self) -> Any:
        """Number of the first element here."""
        return self.place * self.here

    def own(self, numbers: jax.Array) -> jax.Array:
        """Return of numbers of all elements `(K, ...)` those of the elements here."""
        return numbers if self.devices == 1 else jax.lax.dynamic_slice_in_dim(numbers, self.first, self.here)

    def gathered(self, tree: Any) -> Any:
        """Return numbers of all elements, `(K, ...)`, from those of the elements here; a barrier keeps both sides apart."""
        tree = jax.lax.optimization_barrier(tree)
        if self.devices > 1:
            leaves, form = jax.tree.flatten(tree)
            dtype = jnp.result_type(*leaves)
            rows = self._gathered(jnp.concatenate([leaf.astype(dtype).reshape(self.here, -1) for leaf in leaves], axis=1))
            sizes = np.cumsum([leaf[0].size for leaf in leaves])[:-1]
            parts = jnp.split(rows, sizes, axis=1)
            whole = [part.reshape(self.elements, *leaf.shape[1:]).astype(leaf.dtype) for part, leaf in zip(parts, leaves, strict=True)]
            tree = jax.tree.unflatten(form, whole)
        return jax.lax.optimization_barrier(tree)

    def _gathered(self, rows: jax.Array) -> jax.Array:
        """Return the rows `(K, k)` of all elements from those here, in ceil(log2 of the devices) rounds.

        Each round doubles what a device has of those after it. Between processes on CPUs a collective takes ten times as long as a message
        from one device to another.
        """
        held = rows
        while (reached := held.shape[0] // self.here) < self.devices:
            more = self.from_device(held[: (self.devices - reached) * self.here], -reached)
            held = jnp.concatenate([held, more])
        return jnp.roll(held, self.first, axis=0)

    def from_device(self, tree: Any, offset: int) -> Any:
        """Return what the device so many places before this one, in a ring, has."""
        return self._sent(tree, [(i, (i + offset) % self.devices) for i in range(self.devices)])

    def from_partner(self, tree: Any, distance: int) -> Any:
        """Return what the device has whose number differs in the bit `distance`, a power of two."""
        return self._sent(tree, [(i, i ^ distance) for i in range(self.devices)])

    def _sent(self, tree: Any, pairs: list[tuple[int, int]]) -> Any:
        """Send arrays from device to device in one message: what takes time between processes is, for few numbers, that there is one."""
        if self.devices == 1:
            return tree
        leaves, form = jax.tree.flatten(tree)
        words = [_as_words(leaf) for leaf in leaves]
        message = jax.lax.ppermute(jnp.concatenate(words), AXIS, pairs)
        parts = jnp.split(message, np.cumsum([part.size for part in words])[:-1])
        return jax.tree.unflatten(form, [_of_words(part, leaf) for part, leaf in zip(parts, leaves, strict=True)])


def _as_words(array: jax.Array) -> jax.Array:
    """Return the bits of an array of numbers of 32 or 64 bits, `(k,)` uint32."""
    return jax.lax.bitcast_convert_type(array, jnp.uint32).reshape(-1)


def _of_words(words: jax.Array, like: jax.Array) -> jax.Array:
    """Undo `_as_words` for an array like the given one."""
    return jax.lax.bitcast_convert_type(words.reshape(*like.shape, *([2] if like.dtype.itemsize == 8 else [])), like.dtype)


def shared_out(
    work: Callable[[Crew, Sequence[Any], Any], tuple[Any, Any]], elements: int, cut: Sequence[jax.Array], whole: Any, ranks: Sequence[int]
) -> tuple[Any, Any]:
    """Have each device do its part of a work on all elements.

    Args:
        work: from the crew, the device's part of what is cut, and what is whole, to a list of arrays that are cut, and a tree of
            what is the same on all devices.
        elements: number of elements.
        cut: arrays whose last axis is shared out.
        whole: tree of arrays that each device sees whole.
        ranks: number of axes of each array that comes out cut.

    Raises:
        MotesError: the number of devices does not divide that of elements.
    """
    count = chosen()
    if elements % count:
        checks.refuse("devices count", f"a divisor of the filter's {elements} elements", count)
    if count == 1:
        return work(Crew(elements, 1), cut, whole)

    def last(rank: int) -> PartitionSpec:
        return PartitionSpec(*[None] * (rank - 1), AXIS)

    given = ([last(array.ndim) for array in cut], jax.tree.map(lambda leaf: PartitionSpec(), whole))
    shared = jax.shard_map(partial(work, Crew(elements, count)), mesh=_mesh(count), in_specs=given,
                           out_specs=([last(rank) for rank in ranks], PartitionSpec()), check_vma=False)  # fmt: skip
    return shared(list(cut), whole)


def laid_out(tree: Any, count: int, what: str) -> Any:
    """Return arrays `(count, ...)` shared out by their first axis over the devices in force; what is computed of each stays where it is.

    Processes that work as one each do all of it.

    Raises:
        MotesError: the number of devices does not divide theirs.
    """
    if chosen() == 1 or jax.process_count() > 1:
        return tree
    if count % chosen():
        checks.refuse("devices count", f"a divisor of the number of {what}, {count}", chosen())
    return jax.device_put(tree, NamedSharding(_mesh(chosen()), PartitionSpec(AXIS)))


def _mesh(count: int) -> Mesh:
    return Mesh(np.array(jax.devices()[:count]), (AXIS,))


def brought_here(tree: Any) -> Any:
    """Return arrays that other devices than those in force hold as arrays of these; a run goes on where another left off."""
    wanted = set(jax.devices()[: chosen()])

    def brought(leaf: Any) -> Any:
        there = leaf.sharding.device_set if isinstance(leaf, jax.Array) and checks.is_concrete(leaf) else set()
        if len(there) < 2 or there == wanted:
            return leaf
        return jnp.asarray(np.asarray(leaf))

    return jax.tree.map(brought, tree)
