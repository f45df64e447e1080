"""One filter at work on one model. Compiling is what takes time: the rules share the programs, and what these computed, of one session."""

import warnings
from collections.abc import Sequence
from functools import cached_property
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from motes.core.checks import MotesWarning
from motes.core.record import replace
from motes.filters import keep as keeping
from motes.filters.history import History
from motes.filters.interface import Filter
from motes.filters.run import run
from motes.filters.stream import Stream
from motes.models.simulate import simulate
from motes.testing.models import linear

STEPS = 12
"""Of every run, so that one program serves many."""
GAP, PARTLY = 4, 6
"""Steps at which nothing, and not the first component, is measured."""
LANES, OTHERS = 100, 4
"""Runs at a time: with keys of their own on the same model and data, two where keys change nothing, and on others."""

_traced = [0]


class DoesNotApply(Exception):
    """A rule says nothing of this filter or model; the message is the reason."""


def counted(law: Any) -> dict[str, jax.Array]:
    """Keep mean and covariance, and count how often that is traced."""
    _traced[0] += 1
    return keeping.moments(law)


def times_traced() -> int:
    """How often a run was traced so far, in any session."""
    return _traced[0]


class Lanes(NamedTuple):
    """Many runs at a time, all under one `vmap`.

    Attributes:
        keys: of the runs, `(lanes,)`.
        alike: how many of them, the first ones, differ in their keys alone.
        mean: their filtered means, `(lanes, t, x)`.
        log_evidence: log density of their measurements, `(lanes, t)`.
    """

    keys: jax.Array
    alike: int
    mean: np.ndarray
    log_evidence: np.ndarray


class Session:
    """One filter at work on one model.

    Attributes:
        filter: the filter; measurements at which it collapses are left out, and say so.
        model: the model.
        own: whether the model is that of the contract, of which more is known than of any other.
        truth: states `(2 t, x)`.
        ys: measurements of the first half of them `(t, y)`.
        gappy: of all of them, with gaps, `(2 t, y)`.
    """

    def __init__(self, filter: Filter, model: Any = None):
        """Draw data from a model; from one of two states, of which three linear functions are measured, where none is given."""
        self.filter, self.own = replace(filter, on_collapse="predict"), model is None
        self.model = linear(range(3)) if model is None else model
        self.truth, self.gappy = (np.array(drawn) for drawn in simulate(5, self.model, 2 * STEPS))
        self.ys = self.gappy[:STEPS].copy()
        self.gappy[GAP] = np.nan
        if self.own:  # not every sensor can leave out single components
            self.gappy[PARTLY, 0] = np.nan

    def ask_own_model(self) -> None:
        """Leave a rule out that looks at what is known of the contract's own model alone."""
        if not self.own:
            raise DoesNotApply("it is asked on a linear-Gaussian model, and another was given.")

    def ask_likelihood(self) -> None:
        """Leave a rule out that looks at the likelihood, where the filter has none."""
        if not self.filter.has_evidence:
            raise DoesNotApply("the filter has no likelihood.")

    def run(self, ys: Any, key: Any = 3, **others: Any) -> History:
        """Run over measurements; `others` are arguments of `run`, and may name another filter or model."""
        filter, model = others.pop("filter", self.filter), others.pop("model", self.model)
        with quietly():
            return run(key, filter, model, ys, **{"keep": counted, **others})

    @cached_property
    def whole(self) -> History:
        """The run over the first half of the measurements with gaps."""
        return self.run(self.gappy[:STEPS])

    @cached_property
    def clean(self) -> History:
        """The run over measurements without gaps."""
        return self.run(self.ys)

    def fed(self, stream: Stream, rows: Sequence[int], unmeasured: Sequence[int] = (), looked_at: Sequence[int] = ()) -> list[np.ndarray]:
        """Lead a stream through rows of the measurements with gaps, in order, from where it stands; gives the mean after each.

        Rows in `unmeasured` are predicted and not updated, unlike rows of NaN, which are both. At those in `looked_at` the law is asked
        for in between.
        """
        means = []
        with quietly():
            for row in rows:
                if row:  # row 0 is of the initial state, before any dynamics
                    stream.predict()
                    _ = stream.state if row in looked_at else None
                if row not in unmeasured:
                    stream.update(self.gappy[row])
                means.append(np.asarray(stream.mean))
        return means

    def stream(self) -> Stream:
        """Begin a stream that draws the numbers of `whole`."""
        return Stream(3, self.filter, self.model)

    @cached_property
    def other(self) -> tuple[Any, np.ndarray]:
        """Another model with the same structure, and other measurements."""
        model = linear(range(3), scale=2.0) if self.own else self.model
        return model, np.array(simulate(6, model, STEPS)[1])

    @cached_property
    def lanes(self) -> Lanes:
        """Many runs at a time, the last few of them on another model and other measurements."""
        model, ys = self.other
        count = LANES if differing(self.clean.mean, self.run(self.ys, key=4).mean) else 2
        keys = jax.random.split(jax.random.key(11), count + OTHERS)
        which = (np.arange(count + OTHERS) >= count).astype(int)
        models, data = jax.tree.map(lambda *leaves: jnp.stack([jnp.asarray(leaf) for leaf in leaves])[which],
                                    (self.model, self.ys), (model, ys))  # fmt: skip

        def one(key: jax.Array, model: Any, ys: jax.Array) -> tuple[jax.Array, jax.Array]:
            history = self.run(ys, key, model=model)
            return history.mean, history.info.log_evidence

        return Lanes(keys, count, *map(np.asarray, jax.vmap(one)(keys, models, data)))

    @property
    def has_size(self) -> bool:
        """Whether the filter has a number of particles among its parameters."""
        return self.filter.particle_count is not None


def quietly() -> warnings.catch_warnings:
    """Keep what runs are warned of to themselves: rules provoke it."""
    return warnings.catch_warnings(action="ignore", category=MotesWarning)


def differing(a: Any, b: Any) -> int | None:
    """Count the numbers of two trees that are not the same to the bit; None where the trees have other forms."""
    left, right = jax.tree.leaves(a), jax.tree.leaves(b)
    if [np.shape(leaf) for leaf in left] != [np.shape(leaf) for leaf in right]:
        return None
    unlike = [~((one == other) | (one != one) & (other != other))
              for one, other in ((np.asarray(x), np.asarray(y)) for x, y in zip(left, right, strict=True))]  # fmt: skip
    return sum(int(np.sum(each)) for each in unlike)
