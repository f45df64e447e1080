"""What a worker does: some runs of one filter.

A run is computed in the same way wherever and with whatever others it is computed, so that its bits do not depend on chunks, workers or
interruptions. On a CPU each run is a call of its own, and threads work on several runs at once, since JAX leaves the interpreter free
meanwhile. Batches (`vmap`) of 5 or 20 runs, `lax.map` and single calls all took 13 to 18 ms of processor time per run (radar model, 2 000
particles, 100 steps, two cores); single calls keep every core busy, and their bits depend on nothing, while those of a batch change with
its width. On an accelerator runs go in batches of a fixed width; a run keeps its place in its batch, and what is not asked for is thrown
away.
"""

import importlib
import shlex
import threading
from collections.abc import Iterator
from contextlib import nullcontext
from functools import cache, partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from motes.core import checks, linalg
from motes.core.record import replace
from motes.core.settings import Settings, enforced
from motes.diagnostics.consistency import normalized_errors
from motes.filters import notices
from motes.filters.info import Info
from motes.filters.run import run
from motes.laws.circular import wrap
from motes.studies.experiment import Experiment, places
from motes.tracing.compiling import jitted
from motes.tracing.identity import Beside

TRUTH = ""
"""Name of the part of a study that holds the true states; those of the filters are the other parts."""
WIDTH = 64
"""Runs in one batch on an accelerator."""


def batch_width() -> int:
    """Return how many runs go in one batch on this machine: 1 on a CPU."""
    return 1 if jax.default_backend() == "cpu" else WIDTH


Block = tuple[str, int, int, dict[str, np.ndarray]]
"""Part, first run, the one after the last, and arrays, run axis first."""


def _in_one(pieces: list[dict[str, np.ndarray]]) -> dict[str, np.ndarray]:
    return {name: np.concatenate([piece[name] for piece in pieces]) for name in pieces[0]}


class Work:
    """The runs of an experiment, to be computed by any number of threads."""

    def __init__(self, experiment: Experiment, width: int):
        """Take an experiment and the width of a batch."""
        self.experiment, self.width = experiment, width
        self.stopping = threading.Event()
        self._first = {name: threading.Lock() for name in (TRUTH, *experiment.filters)}
        self._compiled: set[str] = set()
        self._at_hand: dict[tuple[str, int], list[dict[str, np.ndarray]]] = {}

    def block(self, settings: Settings, part: str, start: int, stop: int) -> dict[str, np.ndarray]:
        """Compute the runs from start to before stop of one part, run axis first.

        Raises:
            KeyboardInterrupt: the study was stopped meanwhile.
        """
        pieces = self._at_hand[part, start] = []
        with enforced(settings):
            for first in (start, *range(start - start % self.width + self.width, stop, self.width)):
                # while the first run of a part compiles, other threads wait or take another part
                with nullcontext() if part in self._compiled else self._first[part]:
                    pieces.append(self._batch(part, first, stop))
                    self._compiled.add(part)
        del self._at_hand[part, start]
        return _in_one(pieces)

    def unfinished(self) -> Iterator[Block]:
        """Give the first runs of the blocks that were not finished, after an interruption."""
        for (part, start), pieces in list(self._at_hand.items()):
            if pieces:
                arrays = _in_one(list(pieces))
                yield part, start, start + len(next(iter(arrays.values()))), arrays

    def _batch(self, part: str, first: int, stop: int) -> dict[str, np.ndarray]:
        if self.stopping.is_set():
            raise KeyboardInterrupt
        base = first - first % self.width
        if self.width == 1:
            found = jax.tree.map(lambda leaf: leaf[None], one_run(self.experiment, part, first))
        else:
            found = _batched(self.experiment, part, base + jnp.arange(self.width), Beside(self.experiment))
        return {name: np.asarray(value)[first - base : stop - base] for name, value in found.items()}


@partial(jitted, static_argnames=("part",))
def _batched(experiment: Experiment, part: str, numbers: jax.Array, beside: Beside) -> dict[str, jax.Array]:
    return jax.vmap(lambda number: one_run(experiment, part, number))(numbers)


def one_run(experiment: Experiment, part: str, number: Any) -> dict[str, Any]:
    """Compute one run of one part.

    Args:
        experiment: what to run.
        part: name of a filter, or `TRUTH`.
        number: which run.

    Returns:
        For the truth, its states `(t, x)`; for a filter its means `(t, x)`, the normalized squared error of each block `(t, blocks)`, the
        smallest effective sample size, the log likelihood (NaN for filters without), and the first step at which all weights vanished (-1
        for none).
    """
    xs, ys = experiment.drawn(number)
    if part == TRUTH:
        return {"truth": xs}
    filter, model = experiment.assumed(part)
    # a run whose weights vanish must not stop the others: it goes on by prediction, as "raise" does inside of jit
    going_on = replace(filter, on_collapse="predict") if filter.on_collapse == "raise" else filter
    with notices.quiet():
        history = run(experiment.keys(number)[1], going_on, model, ys, experiment.inputs)
    states = experiment.model.names
    mean, cov = history.mean, history.cov
    if model.names != states:
        own = np.array(places(model.names, states))
        mean, cov = mean[:, own], cov[:, own][:, :, own]
    blocks = tuple(tuple(places(states, of)) for _, of in experiment.blocks)
    likelihood = history.log_likelihood if history.has_evidence else jnp.full((), jnp.nan, xs.dtype)
    # not the history itself, which carries the filter: this is compiled once for all of them
    return _errors_of_blocks((mean, cov, history.info), xs, blocks, experiment.angles) | {"log_likelihood": likelihood}


@partial(jitted, static_argnames=("blocks", "angles"))
def _errors_of_blocks(
    found: tuple[jax.Array, jax.Array, Info], xs: jax.Array, blocks: tuple[tuple[int, ...], ...], angles: tuple[int, ...]
) -> dict[str, jax.Array]:
    means, covs, info = found
    errors, covs = wrap((means - xs).T, angles), jnp.moveaxis(covs, 0, -1)
    nees = [normalized_errors(linalg.take(errors, block), linalg.take(linalg.take(covs, block), block, axis=1)) for block in blocks]
    first = jnp.where(jnp.any(info.collapsed), jnp.argmax(info.collapsed), -1).astype(jnp.int32)
    return {"estimates": means, "nees": jnp.stack(nees, axis=1), "ess": jnp.min(info.ess), "collapsed": first}


def built(factory: str) -> Experiment:
    """Return the experiment that a function gives, named "module:function", called with the words after its name.

    Raises:
        MotesError: there is no such function, or it gives something else.
    """
    called, *words = shlex.split(factory) or [""]
    module, _, name = called.partition(":")
    try:
        function = getattr(importlib.import_module(module), name)
    except (ImportError, AttributeError, ValueError) as reason:
        checks.refuse("study experiment", "an experiment, or the name of a function that makes one, such as 'radar:experiment'",
                      repr(factory), f"({reason})")
    experiment = function(*words)
    if not isinstance(experiment, Experiment):
        checks.refuse(f"study experiment {factory!r}", "a function that returns an Experiment", type(experiment).__name__)
    return experiment


@cache
def _work(factory: str, settings: Settings, width: int) -> Work:
    with enforced(settings):
        return Work(built(factory), width)


def remote_block(factory: str, settings: Settings, width: int, part: str, start: int, stop: int) -> dict[str, np.ndarray]:
    """Compute a block of runs in another process, which makes the experiment itself: functions of a model cannot travel."""
    return _work(factory, settings, width).block(settings, part, start, stop)
