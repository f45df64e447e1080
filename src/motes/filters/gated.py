"""Filters that leave out measurements too far off their prediction: every one that keeps Gaussians, since its claims are chi-square."""

from collections.abc import Callable, Mapping
from typing import Any

import jax.numpy as jnp

from motes.core import checks
from motes.core.record import record, replace, static
from motes.filters.info import Info
from motes.filters.interface import Filter
from motes.models.interface import Model

Gates = tuple[tuple[int, int, float | None], ...]
"""Where the components of each sensor begin and end, and its gate."""
Take = Callable[[Filter, Any], tuple[Any, Info]]


@record
class Gated:
    """What a filter with a gate has; `Filter` checks the gate and applies it.

    Attributes:
        gate: share of measurements that lie inside the gate where the filter's claims are right, such as 0.9999; one outside is not used,
            and counts in `info.gated`. Of several sensors by name (`Independent`) each is held against it alone; a dictionary, such as
            `{"radar": 0.999}`, gives each a gate of its own, and the others none. None for no gate.
    """

    gate: float | Mapping[str, float] | None = static(default=None, kw_only=True)


def gates_of(filter: Filter, model: Model) -> Gates:
    """Return the places and the gate of each of several sensors; nothing where the measurement is held against the gate as a whole.

    Raises:
        MotesError: the filter has gates for sensors that the model has not.
    """
    gate, sensors = filter.gate, next(iter(model.each_mode())).sensor.sensors
    given = dict(gate) if isinstance(gate, tuple) else {name: gate for name, _ in sensors}
    unknown = [name for name in given if name not in dict(sensors)]
    if unknown:
        known = f"gates of {', '.join(dict(sensors))}" if sensors else "one number: the model has no sensors by name"
        checks.refuse(f"{type(filter).__name__} gate", known, repr(unknown[0]))
    if gate is None or len(sensors) < 2:
        return ()
    found, begin = [], 0
    for name, size in sensors:
        found.append((begin, begin + size, given.get(name)))
        begin += size
    return tuple(found)


def taken(filter: Filter, gates: Gates, y: Any, take: Take) -> tuple[Any, Info]:
    """Take in a measurement; of several sensors each alone is held against its gate first, and left out where it lies outside.

    Args:
        filter: the filter.
        gates: see `gates_of`.
        y: the measurement.
        take: gives state and info of a filter that takes in a measurement.
    """
    if not gates:
        return take(filter, y)
    kept, count, nis, freedom = y, jnp.int32(0), 0.0, 0.0
    for begin, end, gate in gates:
        if gate is None:
            continue
        here = jnp.zeros(y.shape[0], bool).at[begin:end].set(True)
        _, info = take(filter.with_gate(gate), jnp.where(here, y, jnp.nan))
        outside = info.gated > 0
        kept = jnp.where(outside & here, jnp.nan, kept)
        count = count + outside
        # how far off it was is told all the same: a filter that is lost must not fall silent
        nis, freedom = (total + jnp.where(outside, one, 0) for total, one in ((nis, info.nis), (freedom, info.freedom)))
    state, info = take(filter.with_gate(None), kept)
    return state, replace(info, gated=count.astype(jnp.int32), nis=info.nis + nis, freedom=info.freedom + freedom)
