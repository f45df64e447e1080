"""The one loop over time."""

from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from motes.core import checks, random
from motes.core.logspace import RunningSum
from motes.core.record import replace, values
from motes.core.types import Inputs, KeyLike
from motes.filters import alarm, notices, precision
from motes.filters import keep as keeping
from motes.filters.history import Carry, History
from motes.filters.interface import Filter, Info
from motes.filters.keep import Keep
from motes.filters.needs import as_state_space
from motes.io import archive
from motes.laws.conditional import Conditional
from motes.models.canonical import canonical, canonical_conditional, one_of, shape_of
from motes.models.jump_markov import JumpMarkovModel, modes_of
from motes.models.mixed_linear import MixedLinearModel
from motes.models.state_space import Previous, StateSpaceModel, at_step, checked_inputs, circular, decorrelated, measurement_size
from motes.native import report
from motes.resampling import gradients
from motes.tracing.compiling import jitted
from motes.tracing.identity import Beside


def run(
    key: KeyLike,
    filter: Filter,
    model: Any,
    ys: jax.Array,
    inputs: Inputs = None,
    keep: Keep = keeping.moments,
    after: History | None = None,
) -> History:
    """Run a filter over measurements.

    Pure: it can be jitted, vmapped (over keys, data and array fields of models) and differentiated. The second call with the same kinds of
    arguments does not compile again.

    Args:
        key: JAX key or integer seed, or a key for each step `(t,)`; the same key gives the same numbers, bit for bit, as `stream` with it.
        filter: the filter.
        model: state-space, mixed linear or jump-Markov model.
        ys: measurements `(t, y)`; NaN, None, masked and NA mean not measured; the first is of x_0.
        inputs: tree with the time axis first, or None; finite numbers in every row.
        keep: what to keep of each law (see `keep`).
        after: history of the steps before, to continue from with the same key; the result equals the uncut run, bit for bit.

    Raises:
        MotesError: measurements, inputs, filter and model do not fit each other.
        CollapseError: all weights vanished and the filter's `on_collapse` is "raise" (outside jit only).
    """
    key = random.key_or_data(key)
    if not isinstance(filter, Filter):
        checks.refuse("run filter", "a filter such as ParticleFilter(n=1000)", type(filter).__name__)
    ys, inputs = checked_data(model, ys, inputs)
    if isinstance(key, jax.Array) and key.ndim and after is None:
        checks.shape("run key", key, (np.shape(ys)[0],), "(one for each step)")
    u = jax.tree.map(one_of, inputs)
    first = None if after is None else _end_of(after, filter, model, u, one_of(ys))
    filter.ask(model, u)
    # functions that are equal for inputs of one shape need not be so for those that a run before had
    alike = first is None or jax.tree.map(shape_of, first.u) == u
    known = canonical_parts(filter, model, u, one_of(ys)) if alike else (filter, model)
    if not checks.is_concrete((known, ys, inputs)) and filter.loses_derivatives:
        # what is compiled is traced, and tells of a derivative, but once
        known, ys, inputs = gradients.noticed((known, ys, inputs))
    try:
        found = _run(key, *known, ys, inputs, (keep, Beside((*known, keep))), first)
    except Exception:
        if first is not None:
            _check_end(first, filter, model, u, one_of(ys))
        raise
    # outside of jit the knobs print as numbers
    history = replace(found, label=repr(filter))
    if filter.on_collapse == "raise" and checks.is_concrete(history.info.collapsed):
        history.raise_on_collapse()
    if checks.is_concrete(history.info):
        notices.warn(history, after)
    return history


def _end_of(after: History, filter: Filter, model: Any, u: Inputs, y: Any) -> Carry:
    """Return what to continue from; inputs and laws that a file gave without their classes get them."""
    checks.instance("run after", after, History, "what mo.run gave, or History.load")
    end, wanted = after.last, jax.tree.structure(u)
    if jax.tree.structure(end.u) != wanted and isinstance(end.u, dict) and not jax.tree_util.treedef_is_leaf(wanted):
        end = replace(end, u=archive.fill(Path("run after: inputs"), u, end.u))
    if isinstance(end.state, dict):
        like = jax.eval_shape(lambda u, y: Engine(random.as_key(0), filter, model).initial(u, y), u, y).state
        end = replace(end, state=archive.fill(Path("run after: state"), like, end.state))
    return end


def _check_end(end: Carry, filter: Filter, model: Any, u: Inputs, y: Any) -> None:
    """Refuse to continue from a run of another filter or model, or with other inputs."""
    like = jax.eval_shape(lambda u, y: Engine(random.as_key(0), filter, model).initial(u, y), u, y)
    for name in ("state", "y", "u"):
        one, other = (jax.tree.map(lambda leaf: f"{leaf.dtype}{list(leaf.shape)}", getattr(carry, name)) for carry in (like, end))
        if jax.tree.structure(one) != jax.tree.structure(other) or one != other:
            checks.refuse("run after", f"the history of a run with the same filter and model, its {name} {one}"[:250], f"{other}"[:150])


def run_in_chunks(
    key: KeyLike, filter: Filter, model: Any, ys: jax.Array, inputs: Inputs = None, keep: Keep = keeping.moments, chunk: int = 100
) -> Iterator[History]:
    """Run in chunks of steps and yield the history of each: for progress, checkpoints and early stops. `joined` puts them together.

    Arguments and errors are those of `run`; chunk is the number of steps at a time.
    """
    checks.positive_integer("run_in_chunks chunk", chunk)
    ys, inputs = checked_data(model, ys, inputs)
    part = None
    for begin in range(0, np.shape(ys)[0], chunk):
        piece = slice(begin, begin + chunk)
        part = run(key, filter, model, ys[piece], jax.tree.map(lambda leaf, piece=piece: leaf[piece], inputs), keep, part)
        yield part


@partial(jitted, static_argnames=("kept",))
def _run(
    key: jax.Array, filter: Filter, model: Any, ys: jax.Array, inputs: Inputs, kept: tuple[Keep, Beside], first: Carry | None
) -> History:
    with report.collected() as notes:
        history = _scanned(Engine(random.as_key(key), filter, model), ys, inputs, kept[0], first)
        report.complete(notes, type(filter).__name__)
    return replace(history, engine=report.summary(notes))


def _scanned(engine: "Engine", ys: jax.Array, inputs: Inputs, keep: Keep, first: Carry | None) -> History:
    keep = keeping.told(keep, getattr(engine.given, "modes", 0))

    def advance(held: tuple[Carry, Any], after: Any) -> tuple[tuple[Carry, Any], tuple[Any, Info]]:
        carry, now = held
        carry, info = engine.step(carry, *now)
        return (carry, after), (keep(carry.state), info)

    if first is None:
        carry, info = engine.begin(ys[0], at_step(inputs, 0))
        opening = (keep(carry.state), info)
        start = jnp.int32(0)
        carry, rest = _over(advance, carry, jax.tree.map(lambda leaf: leaf[1:], (ys, inputs)))
        kept, infos = jax.tree.map(lambda one, more: jnp.concatenate([one[None], more]), opening, rest)
    else:
        start = first.step + 1
        carry, (kept, infos) = _over(advance, first, (ys, inputs))
    known = engine.filter.traits | {"circular": engine.circular, "rounding": precision.rounding(engine.given, ys, at_step(inputs, 0))}
    return History(kept, infos, carry, start, engine.given.names, "", **known)


def _over(advance: Callable[[Any, Any], Any], carry: Carry, rows: Any) -> tuple[Carry, Any]:
    """Scan over rows, each fetched a step ahead: compilers would look a row up again for every particle and state that uses it."""
    count = jax.tree.leaves(rows)[0].shape[0]
    after = jax.tree.map(lambda leaf: jnp.concatenate([leaf[1:], leaf[-1:]]), rows)
    now = jax.tree.map(lambda leaf: leaf[0] if count else jnp.zeros(leaf.shape[1:], leaf.dtype), rows)
    (carry, _), out = jax.lax.scan(advance, (carry, now), after)
    return carry, out


def canonical_parts(filter: Filter, model: Any, u: Inputs, y: Any) -> tuple[Filter, Any]:
    """Return filter and model such that code compiled for equal ones is used again; u and y are one step's, or their shapes."""
    u, y = jax.tree.map(shape_of, (u, y))
    model = canonical(model, u, y)
    x = jax.ShapeDtypeStruct((model.size,), model.dtype)
    # a conditional among the knobs is a proposal: its functions see the pair of inputs and measurement
    proposals = {name: canonical_conditional(f"{type(filter).__name__} {name}", knob, x, (u, y), x)
                 for name, knob in values(filter).items() if isinstance(knob, Conditional)}  # fmt: skip
    return replace(filter, **proposals) if proposals else filter, model


class Engine:
    """One filter on one model: the single place that gives each step its key, its inputs and its number."""

    def __init__(self, key: jax.Array, filter: Filter, model: Any):
        """Take the parts; models with correlated noises are decorrelated here."""
        self.key, self.filter, self.given = key, filter, model
        self.correlated = isinstance(model, StateSpaceModel) and model.noise_cross_cov is not None
        self.model = decorrelated(model) if isinstance(model, StateSpaceModel) else model
        self.circular = circular(model)

    def prepared(self, u: Any) -> Any:
        """Return the model in the filter's own form."""
        return self.filter.prepare(self.model, u)

    def driven(self, u: Inputs, before: Inputs, y: jax.Array) -> Any:
        """Return the inputs as the model wants them: with the measurement before, where noises are correlated."""
        return Previous(u, before, y) if self.correlated else u

    def initial(self, u: Inputs, y: jax.Array) -> Carry:
        """Check that the parts fit, and return the law before y_0; of y only shape and type matter."""
        if isinstance(self.given, (StateSpaceModel, JumpMarkovModel)):
            self.given.check(u)
            size = measurement_size(modes_of(self.given)[0], u)
            if size not in (None, y.shape[0]):
                checks.refuse("ys", f"shape (t, {size}), as the sensor measures", f"{y.shape[0]} components")
        nothing = jnp.full_like(y, jnp.nan)
        model = self.prepared(self.driven(u, u, nothing))
        state = self.filter.init(random.child(random.step_key(self.key, 0), random.INITIAL), model)
        return Carry(state.gathered(self.circular), RunningSum.zero(y.dtype), jnp.zeros((), y.dtype), nothing, u, jnp.int32(0))

    def take_in(self, carry: Carry, y: jax.Array) -> tuple[Carry, Info]:
        """Update with a measurement of the present step."""
        driven = self.driven(carry.u, carry.u, carry.y)
        key = random.child(random.step_key(self.key, carry.step), random.UPDATE)
        state, info = self.filter.update(key, self.prepared(driven), carry.state, y, driven, carry.step)
        return self._handed_on(carry, state, info, y, carry.u, carry.step)

    def begin(self, y: jax.Array, u: Inputs) -> tuple[Carry, Info]:
        """Take step 0."""
        return self.take_in(_apart(self.initial(u, y)), y)

    def move(self, carry: Carry, u: Inputs) -> Carry:
        """Predict only; the measurement of the new step counts as missing until it is taken in."""
        t = carry.step + 1
        driven = self.driven(u, carry.u, carry.y)
        key = random.child(random.step_key(self.key, t), random.PREDICT)
        state = self.filter.predict(key, self.prepared(driven), carry.state, driven, t)  # type: ignore[attr-defined]
        return replace(carry, state=state.gathered(self.circular), y=jnp.full_like(carry.y, jnp.nan), u=u, step=t)

    def step(self, carry: Carry, y: jax.Array, u: Inputs) -> tuple[Carry, Info]:
        """Go to the next step and take in its measurement."""
        carry, y, u = _apart((carry, y, u))
        t = carry.step + 1
        driven = self.driven(u, carry.u, carry.y)
        state, info = self.filter.step(random.step_key(self.key, t), self.prepared(driven), carry.state, y, driven, t)
        return _apart(self._handed_on(carry, state, info, y, u, t))

    def _handed_on(self, carry: Carry, state: Any, info: Info, y: jax.Array, u: Inputs, t: jax.Array) -> tuple[Carry, Info]:
        suspicion, rings = alarm.advanced(carry.suspicion, info.surprise, info.freedom)
        evidence = carry.evidence.add(info.log_evidence)
        return Carry(state.gathered(self.circular), evidence, suspicion, y, u, t), replace(info, alarm=rings)


def _apart(tree: Any) -> Any:
    """Keep the compiler from fusing across a border between steps, so that a step computes the same bits wherever it stands."""
    return jax.lax.optimization_barrier(tree)


def checked_data(model: Any, ys: Any, inputs: Inputs) -> tuple[Any, Inputs]:
    """Return measurements, in the model's type, and inputs as arrays, or refuse what does not fit; see `run`."""
    if not isinstance(model, (StateSpaceModel, MixedLinearModel, JumpMarkovModel)):
        as_state_space("run", model)
    dtype = model.dtype
    ys = checks.as_numbers("ys", ys, "real numbers, shape (t, y)")
    if checks.is_concrete(ys):
        refuse_infinite("ys", ys, dtype)
    ys = np.asarray(ys, dtype) if isinstance(ys, np.ndarray) else jnp.asarray(ys, dtype)
    if ys.ndim != 2 or ys.shape[0] == 0:
        hint = "Write ys[:, None] for one measured component." if ys.ndim == 1 else ""
        checks.refuse("ys", "shape (t, y) with at least one step", f"shape {ys.shape}", hint)
    inputs = checked_inputs(inputs, ys.shape[0], "ys")
    unable = [part.sensor for part in modes_of(model) if isinstance(part, StateSpaceModel) and not part.sensor.marginalizes]
    if unable and checks.is_concrete(ys):
        missing = np.isnan(np.asarray(ys))
        some = missing.any(axis=1) & ~missing.all(axis=1)
        if some.any():
            checks.refuse("ys", f"rows without NaN, or all NaN ({type(unable[0]).__name__} cannot leave out single components)",
                          f"row {int(np.argmax(some))} partly NaN", "Use a Gaussian sensor or noise with independent components.")
    return ys, inputs


def refuse_infinite(argument: str, ys: Any, dtype: Any) -> None:
    """Refuse measurements that are infinite, or too large for the type they are computed with."""
    wrong = checks.unknown(ys, dtype, nan=False)
    if wrong is not None:
        given = f"{np.asarray(ys)[tuple(wrong)]} at index {wrong.tolist()}"
        checks.refuse(argument, "finite numbers, or NaN for what was not measured", given)
