"""Running a filter over measurements."""

from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp

from motes.core import checks, devices, random
from motes.core.loop import loop, with_first
from motes.core.record import record, replace, static
from motes.core.types import Inputs, KeyLike, Measurements
from motes.filters import keep as keeping
from motes.filters import notices, precision
from motes.filters.data import labelled_data, steps_of
from motes.filters.history import Carry, History, MadeBy, joined
from motes.filters.info import Info
from motes.filters.interface import Filter
from motes.filters.keep import Keep
from motes.filters.pair import Form, pair
from motes.filters.pieces import pieces
from motes.filters.setup import carry_like, setup
from motes.io import archive
from motes.laws.law import LawT
from motes.laws.observed import Observed
from motes.models.canonical import one_of, shape_of
from motes.models.interface import Model
from motes.models.state_space import at_step
from motes.models.times import Timeline, parted
from motes.native import report
from motes.resampling import gradients
from motes.tracing.compiling import jitted, sharing_traces
from motes.tracing.identity import Beside


def run(
    key: KeyLike,
    filter: Filter[LawT],
    model: Model,
    ys: Measurements,
    inputs: Inputs = None,
    keep: Keep = keeping.moments,
    after: History | None = None,
) -> History[LawT]:
    """Run a filter over measurements.

    Pure: it can be jitted, vmapped (over keys, data and array fields of models) and differentiated. The second call with the same kinds of
    arguments does not compile again.

    Args:
        key: JAX key or integer seed, or a key for each step `(t,)`; the same key gives the same numbers, bit for bit, as `stream` with it.
        filter: the filter.
        model: state-space, mixed linear or jump-Markov model.
        ys: measurements `(t, y)`, or, of a `Custom` sensor, arrays of any shape and type or trees of them, time axis first, or a list with
            one for each step; NaN, None, masked and NA mean not measured; the first is of x_0. Tables of pandas, polars and xarray keep
            times and names. An iterator of measurements, or of lists of them, is gone through in pieces; what `times` gives has inputs.
        inputs: tree with the time axis first, or None; finite numbers in every row.
        keep: what to keep of each law (see `keep`).
        after: history of the steps before, to continue from with the same key; the result equals the uncut run, bit for bit.

    Raises:
        MotesError: measurements, inputs, filter and model do not fit each other.
        CollapseError: all weights vanished and the filter's `on_collapse` is "raise" (outside jit only).
    """
    if isinstance(ys, (Timeline, Iterator)):
        return (_run_along if isinstance(ys, Timeline) else _run_through)(key, filter, model, ys, inputs, keep, after)  # type: ignore[operator]
    key = random.key_or_data(key)
    filter = keeping.remembering(checks.instance("run filter", filter, Filter, "a filter such as ParticleFilter(n=1000)"), keep)
    ys, inputs, labels = labelled_data(model, ys, inputs)
    if isinstance(key, jax.Array) and key.ndim and after is None:
        checks.shape("run key", key, (steps_of(ys),), "(one for each step)")
    u = jax.tree.map(one_of, inputs)
    y = jax.tree.map(one_of, ys)
    first = None if after is None else _end_of(after, filter, model, u, y)
    # functions that are equal for inputs of one shape need not be so for those that a run before had
    known = pair(filter, model, u, y, alike=first is None or jax.tree.map(shape_of, first.u) == u)
    parts = known.parts
    if not checks.is_concrete((parts, ys, inputs)) and filter.loses_derivatives:
        # what is compiled is traced, and tells of a derivative, but once
        parts, ys, inputs = gradients.noticed((parts, ys, inputs))
    try:
        found = _run(key, known.form, parts, ys, inputs, (keep, Beside(keep)), first)
    except Exception:
        if first is not None:
            _check_end(first, filter, model, u, y)
        raise
    found.last.evidence.remember(found.evidence)
    made_by = MadeBy(filter, model) if checks.is_concrete((parts, ys, inputs)) else None
    history = History(found.kept, found.info, found.last, found.start, model.names, known.label, engine=found.engine, made_by=made_by,
                      circular=model.circular, rounding=found.rounding, **filter.traits).labelled(labels)  # fmt: skip
    if filter.on_collapse == "raise" and checks.is_concrete(history.info.collapsed):
        history.raise_on_collapse()
    if checks.is_concrete(history.info):
        notices.warn(history, after)
    return history


def _run_along(
    key: KeyLike, filter: Filter, model: Model, line: Timeline, inputs: Inputs, keep: Keep, after: History | None
) -> History:
    """Run over measurements that have times."""
    ys, inputs = parted("run", line, inputs)
    return replace(run(key, filter, model, ys, inputs, keep, after), times=line.start + line.seconds, labels=line.labels)


def _run_through(
    key: KeyLike, filter: Filter, model: Model, ys: Iterator[Any], inputs: Inputs, keep: Keep, after: History | None
) -> History:
    """Run over measurements that come one after the other; what was kept is put together at the end."""
    checks.instance("run model", model, Model, "a model such as StateSpaceModel")
    found: list[History] = []
    for piece, rows in pieces(model, ys, inputs):
        part = run(key, filter, model, piece, rows, keep, found[-1] if found else after)
        # where it ended goes with the last one alone: laws and measurements can be large
        found[-1:] = [replace(one, last=None) for one in found[-1:]] + [part]
    return joined(found)


def _end_of(after: History, filter: Filter, model: Any, u: Inputs, y: Any) -> Carry:
    """Return what to continue from; inputs and laws that a file gave without their classes get them."""
    checks.instance("run after", after, History, "what mo.run gave, or History.load")
    before, now = after.particles if after.made_by is None else after.made_by.filter.particle_count, filter.particle_count
    if before and now and before != now:
        checks.refuse("run after", f"the history of a run with {now} particles, as the filter has", before,
                      f"Go on with filter.with_particles({before}).")  # fmt: skip
    end, wanted = after.last, jax.tree.structure(u)
    if jax.tree.structure(end.u) != wanted and isinstance(end.u, dict) and not jax.tree_util.treedef_is_leaf(wanted):
        end = replace(end, u=archive.fill(Path("run after: inputs"), u, end.u))
    if isinstance(end.y, Observed) and jax.tree.structure(end.y) != jax.tree.structure(y) and isinstance(y, Observed):
        end = replace(end, y=archive.fill(Path("run after: measurements"), y, {"value": end.y.value, "there": end.y.there}))
    if isinstance(end.state, dict):
        end = replace(end, state=archive.fill(Path("run after: state"), carry_like(filter, model, u, y).state, end.state))
    return devices.brought_here(end)


def _check_end(end: Carry, filter: Filter, model: Any, u: Inputs, y: Any) -> None:
    """Refuse to continue from a run of another filter or model, or with other inputs."""
    like = carry_like(filter, model, u, y)
    for name in ("state", "y", "u"):
        one, other = (jax.tree.map(lambda leaf: f"{leaf.dtype}{list(leaf.shape)}", getattr(carry, name)) for carry in (like, end))
        if jax.tree.structure(one) != jax.tree.structure(other) or one != other:
            checks.refuse("run after", f"the history of a run with the same filter and model, its {name} {one}"[:250], f"{other}"[:150])


def run_in_chunks(  # noqa: PLR0913 (those of run, and the length of a chunk)
    key: KeyLike,
    filter: Filter,
    model: Model,
    ys: Measurements,
    inputs: Inputs = None,
    keep: Keep = keeping.moments,
    chunk: int = 100,
    after: History | None = None,
) -> Iterator[History]:
    """Run in chunks of steps and yield the history of each: for progress, checkpoints and early stops. `joined` puts them together.

    Arguments and errors are those of `run`; chunk is the number of steps at a time.
    """
    checks.positive_integer("run_in_chunks chunk", chunk)
    ys, inputs, labels = labelled_data(model, ys, inputs)
    part = after
    for begin in range(0, steps_of(ys), chunk):
        piece = slice(begin, begin + chunk)
        rows = jax.tree.map(lambda leaf, piece=piece: leaf[piece], (ys, inputs))
        part = run(key, filter, model, rows[0], rows[1], keep, part)
        part = part.labelled(labels and labels.rows(piece))
        yield part


@record
class _Found:
    """What the compiled program of a run gives."""

    kept: dict[str, Any]
    info: Info
    last: Carry
    evidence: jax.Array
    start: jax.Array
    rounding: jax.Array
    engine: str = static()


def _is_light(key: jax.Array, form: Form, *rest: Any) -> bool:
    return form.light


@partial(jitted, few=_is_light, static_argnames=("form", "kept"))
def _run(  # noqa: PLR0913 (those of run, and what is known of filter and model)
    key: jax.Array, form: Form, parts: list[Any], ys: Any, inputs: Inputs, kept: tuple[Keep, Beside], first: Carry | None
) -> _Found:
    filter, model = jax.tree.unflatten(form.structure, parts)
    keep = keeping.with_modes(kept[0], model.modes)
    with report.collected() as notes, sharing_traces():
        ready = setup(random.as_key(key), filter, model, at_step(inputs, 0), at_step(ys, 0))

        def step(carry: Carry, row: tuple[Any, Inputs]) -> tuple[Carry, tuple[Any, Info]]:
            carry, info = ready.step(carry, *row)
            return carry, (keep(carry.state), info)

        if first is None:
            start = jnp.int32(0)
            carry, info = ready.begin(at_step(ys, 0), at_step(inputs, 0))
            last, rest = loop(step, carry, jax.tree.map(lambda leaf: leaf[1:], (ys, inputs)))
            of_steps, infos = with_first((keep(carry.state), info), rest)
        else:
            start = first.step + 1
            last, (of_steps, infos) = loop(step, first, (ys, inputs))
        report.complete(notes, type(filter).__name__)
    seen = filter.seen_inputs(at_step(inputs, 0))
    evidence = jax.lax.optimization_barrier(last.evidence).value()
    return _Found(of_steps, infos, last, evidence, start, precision.rounding(model, ys, seen), report.engine_used(notes))
