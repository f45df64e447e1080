"""The record of a run."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic

import jax
import jax.numpy as jnp
import numpy as np

from motes.core import checks, markdown
from motes.core.logspace import RunningSum
from motes.core.record import described, record, replace, static
from motes.filters import frames
from motes.filters.history_files import TRAITS, read, stored_labels
from motes.filters.info import Info
from motes.filters.keep import after_lag
from motes.io import archive
from motes.io.labels import Labels, in_words, labels_joined
from motes.laws.law import LawT
from motes.laws.spelled import UnspelledError, spelled

if TYPE_CHECKING:
    from pandas import DataFrame
    from xarray import Dataset

_KEPT_BY = {"law": "laws", "mode_probabilities": "modes", "delayed_mode_probabilities": "modes(lag=...)"}


@record
class Carry(Generic[LawT]):
    """What a run hands from one step to the next.

    Attributes:
        state: the law.
        evidence: sum of the log evidence so far.
        suspicion: cumulative sum of the alarm (`filters/alarm.py`).
        y: measurement of the last step, `(y,)` or `Observed`.
        u: inputs of the last step.
        step: index of the last step.
    """

    state: LawT
    evidence: RunningSum
    suspicion: jax.Array
    y: Any
    u: Any
    step: jax.Array


class MadeBy:
    """Filter and model of a run, which a history remembers so that it can be forecast; no part of what is compiled for a history.

    Two are equal where filter and model are. The hash is cheap, as models can hold maps.
    """

    __slots__ = ("filter", "model")

    def __init__(self, filter: Any, model: Any):
        """Take both."""
        self.filter, self.model = filter, model

    def __eq__(self, other: object) -> bool:
        """Compare by value, unless they are the very same."""
        if not isinstance(other, MadeBy):
            return NotImplemented
        same = self.filter is other.filter and self.model is other.model
        return same or (self.filter == other.filter and self.model == other.model)

    def __hash__(self) -> int:
        """Hash by their kinds."""
        return hash((type(self.filter), type(self.model)))


@record
class History(Generic[LawT]):
    """What a run gives: of a filter of a kind of law.

    Attributes:
        kept: what the keep function returned, each with the time axis first.
        info: record of each step, each field `(t,)`.
        last: what is needed to continue.
        start: index of the first step.
        names: names of the states.
        label: the filter, as it prints.
        has_evidence: whether the filter knows its likelihood.
        weighs: whether the filter weighs hypotheses; the others go by the innovation alone.
        subtracts: whether it corrects covariances by differences, which wide priors rob of digits.
        particles: how many draws the effective sample size counts; 0 where it counts something else.
        engine: what did the work: "jax", "native", or "native in part" (see `engine` and `explain`).
        circular: indices of the states that are angles in radians.
        descends: whether each particle of a cloud came from the one that it names as its ancestor.
        rounding: how coarse numbers are beside the noise (`filters/precision.py`), `(2, y)`; of joined pieces the largest; None in
            files of version 0.1.
        times: of the steps, seconds, float64 `(t,)` (of dates Unix seconds), where measurements came with them; otherwise None.
        labels: times of the steps as they were given, names of the measured columns; None where measurements had neither.
        made_by: filter and model; None of a file, and where they were not known when the run was compiled.
    """

    kept: dict[str, Any]
    info: Info
    last: Carry[LawT]
    start: jax.Array
    names: tuple[str, ...] = static()
    label: str = static()
    has_evidence: bool = static(default=True)
    weighs: bool = static(default=True)
    subtracts: bool = static(default=False)
    particles: int = static(default=0)
    engine: str = static(default="jax")
    circular: tuple[int, ...] = static(default=())
    descends: bool = static(default=True)
    rounding: jax.Array | None = None
    times: Any = None
    labels: Labels | None = static(default=None)
    made_by: MadeBy | None = static(default=None)

    def __repr__(self) -> str:
        """Return what was run and kept, in one line: arrays by type and shape."""
        size = np.shape(self.info.ess)
        runs = f"runs={list(size[:-1])}, " if len(size) > 1 else ""
        return f"History({self.label}, {runs}steps={size[-1] if size else 0}, kept={described(self.kept)})"

    def __str__(self) -> str:
        """Print what was run and how it went, one line each."""
        lines = [f"{what:<16}{text}" for what, text in self._facts()]
        return "\n".join(lines) or repr(self)

    def _repr_markdown_(self) -> str:
        return markdown.table(("", "run"), self._facts()) if self._facts() else repr(self)

    def _facts(self) -> list[tuple[str, str]]:
        """Return what was run and how it went, each with its name; nothing of many runs at once, or inside of compiled code."""
        if np.ndim(self.info.ess) != 1 or not checks.is_concrete(self.info.ess):
            return []
        ess, first = np.asarray(self.info.ess), int(self.start)
        facts = [("filter", self.label), ("steps", f"{first} to {first + ess.size - 1}")]
        if self.labels is not None and self.labels.index is not None:
            facts.append(("times", " to ".join(in_words(self.labels.index[row]) for row in (0, -1))))
        if "mean" in self.kept and "cov" in self.kept:
            facts.append(("at the end", frames.in_short(self.names, self.mean[-1], self.cov[-1])))
        if self.has_evidence:
            facts.append(("log likelihood", f"{float(self.log_likelihood):.6g}"))
        if self.particles:
            facts.append(("effective size", f"{np.median(ess):.4g} of {self.particles} (median), {ess.min():.3g} at the least"))
        return [*facts, ("kept", f"{', '.join(self.kept) or 'nothing'}; engine {self.engine}")]

    def _kept(self, name: str) -> Any:
        if name not in self.kept:
            checks.refuse(f"history.{name}", "a run that kept it", f"one that kept {' and '.join(self.kept) or 'nothing'}",
                          f"Run with keep=mo.keep.{_KEPT_BY.get(name, 'moments or mo.keep.laws')}.")
        return self.kept[name]

    @property
    def mean(self) -> jax.Array:
        """Filtered means, `(t, x)`; of an angle the circular mean, on the branch on which the dynamics leave it."""
        return self._kept("mean")

    @property
    def cov(self) -> jax.Array:
        """Filtered covariances, `(t, x, x)`."""
        return self._kept("cov")

    @property
    def mode_probabilities(self) -> jax.Array:
        """Filtered probabilities of the modes, `(t, m)` (with `keep.modes`)."""
        return self._kept("mode_probabilities")

    @property
    def delayed_mode_probabilities(self) -> jax.Array:
        """Probabilities of the last modes, the newest first, `(t, lag + 1, m)`; NaN before the first (with `keep.modes(lag=...)`)."""
        return self._kept("delayed_mode_probabilities")

    def mode_probabilities_after(self, lag: int) -> jax.Array:
        """Probabilities `(t, m)` of the mode of each step given the measurements of `lag` more steps (with `keep.modes(lag=...)`).

        The last steps have fewer after them.

        Raises:
            MotesError: fewer were kept.
        """
        kept = self.delayed_mode_probabilities
        checks.natural("mode_probabilities_after lag", lag)
        if lag >= kept.shape[1]:
            checks.refuse("mode_probabilities_after lag", f"at most {kept.shape[1] - 1}, as was kept", lag)
        return after_lag(kept, lag)

    @property
    def law(self) -> LawT:
        """Filtered laws with the time axis first (with `keep.laws`)."""
        return self._kept("law")

    @property
    def state(self) -> LawT:
        """The last law."""
        return self.last.state

    @property
    def ess(self) -> jax.Array:
        """Effective sample sizes, `(t,)`."""
        return self.info.ess

    @property
    def log_evidence(self) -> jax.Array:
        """Log density of each measurement given those before, `(t,)`."""
        self._ask_evidence()
        return self.info.log_evidence

    @property
    def log_likelihood(self) -> jax.Array:
        """Log density of all measurements since step 0, `()`."""
        self._ask_evidence()
        return self.last.evidence.value()

    def _ask_evidence(self) -> None:
        ask_evidence("history.log_likelihood", self.has_evidence, self.label)

    def raise_on_collapse(self) -> None:
        """Raise where all weights vanished.

        Raises:
            CollapseError: naming the first such step and the range of the log likelihoods there.
        """
        collapsed = np.asarray(self.info.collapsed)
        if not collapsed.any():
            return
        where = int(np.argmax(collapsed))
        if not self.weighs:
            raise checks.CollapseError(self._far_innovation(where))
        lowest, highest = float(self.info.lowest[where]), float(self.info.highest[where])
        # a density of zero everywhere is no matter of how many particles there are
        cure = ("If the sensor has no noise in some component: give it a little, or use OptimalProposal or a Kalman filter"
                if highest == -np.inf else "Check the measurement and the noises, use more particles")  # fmt: skip
        if self.info.invalid[where]:
            cure = f"{int(self.info.invalid[where])} of them are not numbers: look for roots and logarithms of negative numbers"
        raise checks.CollapseError(
            f"step {int(self.start) + where}: all weights vanished: log likelihoods between {lowest:.4g} and {highest:.4g}; "
            f"no particle explains the measurement ({self.label.split('(')[0]}). {cure}, or set on_collapse='predict' or 'inflate'."
        )

    def _far_innovation(self, where: int) -> str:
        square, freedom = float(self.info.nis[where]), int(self.info.freedom[where])
        far = f"lies {square**0.5:.4g} standard deviations from the prediction" if square < np.inf else "or its prediction is not a number"
        return (
            f"step {int(self.start) + where}: the innovation {far} ({freedom} measured component{'s'[: freedom != 1]}; "
            f"{self.label.split('(')[0]}). Check the measurement and the noises, leave such measurements out with gate=0.9999, "
            "or set on_collapse='predict' or 'inflate'."
        )

    def labelled(self, labels: Labels | None) -> "History[LawT]":
        """Return the history with times of its steps and names of the measured columns, where there are any."""
        # inside of compiled code Unix seconds would be rounded to 32 bits
        seconds = labels.seconds() if labels is not None and checks.is_concrete(self.info) else self.times
        return replace(self, labels=labels, times=seconds)

    def to_xarray(self) -> "Dataset":
        """Return an `xarray.Dataset` with dimensions time, state and state2, and run where it is of many runs (extra `results`).

        Dates are dates, in UTC where they had a time zone (`attrs["zone"]`); other times are seconds; steps where there are no times.

        Raises:
            MissingExtraError: xarray is not installed.
        """
        return frames.dataset(self)

    def to_pandas(self) -> "DataFrame":
        """Return a `pandas.DataFrame` with a row for each step, indexed as the measurements were (extra `results`).

        Columns: mean and standard deviation of each state (`px`, `px_sd`), probabilities of modes where they were kept, effective sample
        size, log evidence, squared innovation, whether the alarm rang and whether all weights vanished. Of many runs (by `jax.vmap`) the
        first levels of the index are their numbers.

        Raises:
            MissingExtraError: pandas is not installed.
        """
        return frames.frame(self)

    def save(self, path: str | Path) -> Path:
        """Write to a NetCDF (`.nc`, extra `results`) or NumPy (`.npz`) file, whole or not at all; no pickle.

        A NetCDF file holds what `to_xarray` gives; a NumPy file also holds kept laws and what is needed to continue.

        Raises:
            FileError: the ending is another, or the file cannot be written.
        """
        path = Path(path)
        if path.suffix == ".nc":
            return archive.write_dataset(path, self.to_xarray())
        if path.suffix == ".npz":
            texts = {"names": list(self.names), "filter": self.label, "circular": list(self.circular)}
            texts |= {name: getattr(self, name) for name in TRAITS} | {"forms": self._forms()}
            index, words = stored_labels(self.labels)
            return archive.write_tree(path, self._data() | {"index": index}, texts | words, kind="history")
        checks.refuse(str(path), "a name that ends in .nc or .npz", path.suffix or "no ending", error=checks.FileError)

    def _data(self) -> dict[str, Any]:
        return {name: getattr(self, name) for name in ("kept", "info", "last", "start", "rounding", "times")}

    def _forms(self) -> dict[str, Any]:
        """Return the forms of what can be anything; a law of the user's has none."""
        found: dict[str, Any] = {}
        for name, value in (("kept", self.kept), ("state", self.last.state)):
            try:
                found[name] = spelled(value)
            except UnspelledError:
                continue
        return found

    @classmethod
    def load(cls, path: str | Path) -> "History":
        """Read back a `.npz` file: it can be continued, smoothed and diagnosed as the history that was saved.

        Laws of a kind of the user's own, and those in files of version 0.1, come back as dictionaries of arrays, with a warning: such a
        history can be continued, but not smoothed.

        Raises:
            FileError: the file is no history, or is damaged.
        """
        fields, last = read(Path(path))
        return cls(last=Carry(**last), **fields)


def ask_evidence(asked: str, has_evidence: bool, label: str) -> None:
    """Refuse to tell the likelihood of a filter that has none."""
    if not has_evidence:
        checks.refuse(asked, "a filter with a likelihood", label, "Its costs are no probabilities.")


def joined(pieces: Sequence[History]) -> History:
    """Put the histories of consecutive parts of one run together."""
    if not pieces:
        checks.refuse("pieces", "at least one history", "none")
    kept, info = jax.tree.map(_end_to_end, *[(piece.kept, piece.info) for piece in pieces])
    rounding = jax.tree.map(_largest, *[piece.rounding for piece in pieces])
    times = None if any(piece.times is None for piece in pieces) else np.concatenate([piece.times for piece in pieces])
    labels = labels_joined([piece.labels for piece in pieces])
    return replace(pieces[-1], kept=kept, info=info, start=pieces[0].start, rounding=rounding, times=times, labels=labels)


def _end_to_end(*parts: Any) -> jax.Array:
    return jnp.asarray(np.concatenate([np.asarray(part) for part in parts])) if _are_known(parts) else jnp.concatenate(parts)


def _largest(*parts: Any) -> jax.Array:
    return jnp.asarray(np.max([np.asarray(part) for part in parts], axis=0)) if _are_known(parts) else jnp.max(jnp.stack(parts), axis=0)


def _are_known(parts: tuple[Any, ...]) -> bool:
    """Whether NumPy can put arrays together: XLA would compile a program for each number of them."""
    return checks.is_concrete(parts) and not any(jnp.issubdtype(jnp.result_type(part), jax.dtypes.extended) for part in parts)
