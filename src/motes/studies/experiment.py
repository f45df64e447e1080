"""What a study is of: a world, filters, and how many runs."""

from collections.abc import Mapping
from typing import Any

import jax
import numpy as np

from motes.core import checks, random
from motes.core.record import record, static
from motes.core.types import Inputs
from motes.filters.interface import Filter
from motes.filters.setup import carry_like
from motes.laws.observed import Observed
from motes.models.canonical import one_of
from motes.models.interface import Model
from motes.models.simulate import measurements, simulate
from motes.models.state_space import checked_inputs
from motes.tracing.compiling import jitted

LONGEST_NAME = 60
KINDS = "a StateSpaceModel, a MixedLinearModel or a JumpMarkovModel"
Blocks = tuple[tuple[str, tuple[str, ...]], ...]


@record
class Experiment:
    """Filters that are tried on the same runs.

    Run i has one track and one set of measurements for all filters, and every filter draws from the same key: common random numbers. All of
    it comes from the seed and i alone, so that further runs or filters change nothing of the others.

    Attributes:
        model: what the world does: a model of any kind; of a jump-Markov model errors are of the states without the mode.
        filters: name to filter, or to a pair of a filter and the model that it assumes instead of the world's, which may have states beside
            those of the world; the first is the one that others are compared with.
        steps: number of time steps t.
        runs: number of runs.
        seed: of all random numbers, 0 to 2^32 - 1.
        inputs: of the models, a tree with the time axis first; None where they take none.
        track: true states `(t, x)` of all runs, so that only measurements are drawn (of a jump-Markov model with the number of the mode as
            one more state); None to draw a track in each run.
        blocks: name and states of each block that errors are told of, such as `{"position": ("px", "py")}`; each state alone if not given;
            kept as pairs of a name and states.
        lost: block and largest final error, 2-norm in the units of the block: runs that end beyond are lost. None: only runs are lost in
            which all weights vanished (with on_collapse="raise") or whose estimates are not finite.
    """

    model: Any
    filters: dict[str, Any]
    steps: int = static()
    runs: int = static()
    seed: int = static(default=0)
    inputs: Inputs = None
    track: Any = None
    blocks: Any = static(default=None)
    lost: tuple[str, float] | None = static(default=None)

    def __post_init__(self) -> None:
        """Check that the parts fit each other, without running anything.

        Raises:
            MotesError: one does not; the message names it.
        """
        model, steps, seed, track = self.model, self.steps, self.seed, self.track
        checks.instance("Experiment model", model, Model, KINDS)
        checks.positive_integer("Experiment steps", steps)
        checks.positive_integer("Experiment runs", self.runs)
        if isinstance(seed, bool) or not isinstance(seed, (int, np.integer)) or not 0 <= seed < 2**32:
            checks.refuse("Experiment seed", "a whole number from 0 to 4294967295", repr(seed))
        inputs = checked_inputs(self.inputs, steps, "", "Experiment inputs", model.input_names)
        if track is not None:
            track = checks.as_float("Experiment track", track).astype(model.dtype)
            checks.shape("Experiment track", track, (steps, model.as_state_space().size), "(steps, states)")
            checks.finite("Experiment track", track)
        chosen = _checked_blocks(model.names, self.blocks)
        rule = _checked_rule(chosen, self.lost)
        given = {"filters": _checked_filters(model, self.filters), "inputs": inputs, "track": track, "blocks": chosen, "lost": rule}
        for name, value in given.items():
            object.__setattr__(self, name, value)

    def assumed(self, name: str) -> tuple[Filter, Any]:
        """Return a filter and the model it assumes."""
        given = self.filters[name]
        return given if isinstance(given, tuple) else (given, self.model)

    @property
    def angles(self) -> tuple[int, ...]:
        """Places of the states that are angles, whose errors are wrapped."""
        return self.model.circular

    def keys(self, run: Any) -> tuple[jax.Array, jax.Array]:
        """Return the keys of a run: `simulate(keys[0], model, steps)` gives its truth, `run(keys[1], ...)` a filter's estimates."""
        return _keys(random.as_key(self.seed), run)

    def drawn(self, run: Any) -> tuple[jax.Array, jax.Array]:
        """Return the true states `(t, x)`, without a mode, and the measurements `(t, y)` of a run."""
        key = self.keys(run)[0]
        if self.track is None:
            xs, ys = simulate(key, self.model, self.steps, self.inputs)
        else:
            xs, ys = self.track, measurements(key, self.model, self.track, self.inputs)
        return xs[:, : self.model.size], ys

    def shapes(self) -> tuple[Inputs, Any]:
        """Return shapes of the inputs and of the measurement of one step.

        Raises:
            MotesError: the parts of the world do not fit each other.
        """
        _, ys = jax.eval_shape(self.drawn, 0)
        y = jax.tree.map(one_of, ys)
        known = isinstance(y, Observed) or (isinstance(y, jax.ShapeDtypeStruct) and len(y.shape) == 1)
        return jax.tree.map(one_of, self.inputs), y if known else Observed(y, jax.ShapeDtypeStruct((), bool))

    def check(self) -> None:
        """Bring each filter and its model together, on shapes alone.

        Raises:
            MotesError: world, filter and model do not fit each other; the message names the filter.
        """
        u, y = self.shapes()
        for name in self.filters:
            filter, model = self.assumed(name)
            try:
                carry_like(filter, model, u, y)
            except checks.MotesError as reason:
                raise checks.MotesError(f"filter {name!r}: {reason}") from None


@jitted
def _keys(root: jax.Array, run: Any) -> tuple[jax.Array, jax.Array]:
    key = random.step_key(root, run)
    return random.child(key, random.WORLD), random.child(key, random.FILTER)


def _checked_filters(model: Any, filters: Any) -> dict[str, Any]:
    if not isinstance(filters, Mapping) or not filters:
        checks.refuse("Experiment filters", "names and filters, such as {'plain': ParticleFilter(n=1000)}", repr(filters)[:80])
    for name, given in filters.items():
        if not isinstance(name, str) or not name.isprintable() or not 0 < len(name) <= LONGEST_NAME:
            checks.refuse("Experiment filters", f"names of 1 to {LONGEST_NAME} printable characters", repr(name)[:80])
        filter, assumed = given if isinstance(given, tuple) and len(given) == 2 else (given, model)
        if not isinstance(filter, Filter):
            checks.refuse(f"Experiment filters {name!r}", "a filter, or a pair of a filter and a model", type(given).__name__)
        checks.instance(f"Experiment filters {name!r} model", assumed, Model, KINDS)
        if set(model.names) - set(assumed.names):
            checks.refuse(f"Experiment filters {name!r}", f"a model with the states of the world, {', '.join(model.names)}",
                          ", ".join(assumed.names))
    return dict(filters)


def _checked_blocks(names: tuple[str, ...], blocks: Any) -> Blocks:
    if blocks is None:
        return tuple((name, (name,)) for name in names)
    try:
        chosen = tuple((name, (states,) if isinstance(states, str) else tuple(states)) for name, states in dict(blocks).items())
    except (TypeError, ValueError):
        chosen = ()
    if not chosen:
        checks.refuse("Experiment blocks", "names and states, such as {'position': ('px', 'py')}", repr(blocks)[:80])
    for name, states in chosen:
        if not isinstance(name, str) or not name.isprintable() or not 0 < len(name) <= LONGEST_NAME:
            checks.refuse("Experiment blocks", f"names of 1 to {LONGEST_NAME} printable characters", repr(name)[:80])
        if not states or len(set(states)) < len(states) or set(states) - set(names):
            checks.refuse(f"Experiment blocks {name!r}", f"different states out of {', '.join(names)}", list(states))
    return chosen


def _checked_rule(blocks: Blocks, lost: Any) -> tuple[str, float] | None:
    if lost is None:
        return None
    names = [name for name, _ in blocks]
    try:
        block, limit = lost
        good = block in names and 0 < float(limit) < np.inf
    except (TypeError, ValueError):
        good = False
    if not good:
        expected = f"a block ({', '.join(names)}) and a positive limit, such as ({names[0]!r}, 150.0)"
        checks.refuse("Experiment lost", expected, repr(lost)[:80])
    return block, float(limit)


def places(names: tuple[str, ...], states: tuple[str, ...]) -> list[int]:
    """Return where the states of a block stand."""
    return [names.index(state) for state in states]
