"""Results as tables with names and times: of pandas, one row for each step, and of xarray, with named dimensions."""

from collections.abc import Sequence
from itertools import count
from typing import Any

import numpy as np

from motes.core import checks
from motes.io import archive
from motes.io.labels import Labels

_OF_STEPS = ("log_evidence", "ess", "collapsed", "invalid", "nis", "freedom", "alarm", "gated", "lost", "recovered")
_SHAPES = {"mean": ("state",), "cov": ("state", "state2"), "mode_probabilities": ("mode",), "delayed_mode_probabilities": ("delay", "mode")}
"""Further dimensions of what is kept."""
SHOWN = 12
"""So many states are told of in a line."""


def dataset(history: Any) -> Any:
    """Return what `History.to_xarray` gives."""
    xarray = checks.need("xarray", "results")
    batch = np.ndim(history.info.ess) - 1
    runs = ("run",) if batch == 1 else tuple(f"run{place}" for place in range(batch))
    data: dict[str, Any] = {}
    for name, values in history.kept.items():
        if name in _SHAPES:
            data[name] = ((*runs, "time", *_SHAPES[name]), np.asarray(values))
        elif getattr(values, "dtype", np.dtype(object)).kind in "biuf":  # what a keep function of the user's own gave
            further = tuple(f"{name}_{axis}" for axis in range(np.ndim(values) - batch - 1))
            data[name] = ((*runs, "time", *further), np.asarray(values))
    for name in _OF_STEPS:
        data[name] = ((*runs, "time"), np.asarray(getattr(history.info, name)))
    if history.has_evidence:
        data["log_likelihood"] = (runs, np.asarray(history.log_likelihood))
    names, labels = list(history.names), history.labels
    attributes = archive.provenance() | {"filter": history.label, "engine": history.engine}
    attributes |= {} if labels is None or not labels.zone else {"zone": labels.zone}
    steps = data["ess"][1].shape[-1]
    coordinates = {"time": ("time", *_time(history, steps)), "state": names, "state2": names}
    return xarray.Dataset(data, coords=coordinates, attrs=attributes)


def _time(history: Any, steps: int) -> tuple[np.ndarray, dict[str, str]]:
    """Return the coordinate of time, and what it is: dates, durations or numbers as they were given, seconds, or steps."""
    labels = history.labels
    if labels is not None and labels.index is not None:
        index = labels.index.astype("datetime64[s]") if labels.index.dtype == "datetime64[D]" else labels.index
        return index, {"long_name": labels.name} if labels.name else {}
    if history.times is not None:
        return seconds_of(history), {"units": "s"}
    return first_step(history) + np.arange(steps), {"long_name": "step"}


def first_step(history: Any) -> int:
    """Return the index of the first step, which many runs at once share."""
    return int(np.ravel(history.start)[0])


def seconds_of(history: Any) -> Any:
    """Return the times of steps in seconds, `(t,)`, which many runs at once share; None where they have none."""
    return None if history.times is None else np.reshape(history.times, (-1, np.shape(history.times)[-1]))[0]


def ask_one_run(asked: str, history: Any, each: str) -> None:
    """Refuse a history of many runs, as `jax.vmap` gives them; `each` says how to ask of each run."""
    runs = np.shape(history.info.ess)[:-1]
    if runs:
        checks.refuse(f"{asked} history", "one run", f"{' x '.join(map(str, runs))} runs", each)


def frame(history: Any) -> Any:
    """Return what `History.to_pandas` gives."""
    info, columns = history.info, {}
    if "mean" in history.kept:
        columns |= mean_and_sd(history.names, history.mean, history.kept.get("cov"))
    columns |= of_modes(history.kept.get("mode_probabilities"))
    told = {"ess": bool(np.isfinite(np.asarray(info.ess)).any()), "log_evidence": history.has_evidence}
    for name in ("ess", "log_evidence", "nis", "alarm", "collapsed"):
        if told.get(name, True):
            columns[unused(name, columns)] = getattr(info, name)
    return as_frame(columns, history.labels, first_step(history), seconds_of(history))


def mean_and_sd(names: Sequence[str], mean: Any, cov: Any) -> dict[str, np.ndarray]:
    """Return columns of means `(..., t, x)` and, where there are covariances, of standard deviations."""
    columns: dict[str, np.ndarray] = {}
    for place, name in enumerate(names):
        columns[unused(name, columns)] = np.asarray(mean)[..., place]
        if cov is not None:
            columns[unused(f"{name}_sd", columns)] = deviations(cov)[..., place]
    return columns


def of_modes(probabilities: Any) -> dict[str, Any]:
    """Return a column for each mode, of probabilities `(..., t, m)`; none where these are None."""
    return {} if probabilities is None else {f"mode_{mode}": probabilities[..., mode] for mode in range(probabilities.shape[-1])}


def deviations(cov: Any) -> np.ndarray:
    """Return the standard deviations `(..., x)` of covariances `(..., x, x)`; rounding may leave a variance a little below zero."""
    return np.sqrt(np.maximum(np.diagonal(np.asarray(cov), axis1=-2, axis2=-1), 0))


def in_short(names: Sequence[str], mean: Any, cov: Any) -> str:
    """Return mean and standard deviation of the states, as people write them, of at most a dozen states.

    Args:
        names: of the states.
        mean: `(x,)`.
        cov: `(x, x)`.
    """
    each = list(zip(names, np.asarray(mean), deviations(cov), strict=True))
    more = f" and {len(each) - SHOWN} more" if len(each) > SHOWN else ""
    return ", ".join(f"{name} {value:.4g} +- {deviation:.2g}" for name, value, deviation in each[:SHOWN]) + more


def stream_facts(stream: Any) -> list[tuple[str, str]]:
    """Return filter and step of a stream, the law as it is and the log likelihood, each with its name."""
    if not stream.has_begun:
        return [("filter", repr(stream.filter)), ("step", "0, before its measurement")]
    facts = [("filter", repr(stream.filter)), ("step", str(stream.t)), ("now", in_short(stream.model.names, stream.mean, stream.cov))]
    return [*facts, ("log likelihood", f"{float(stream.log_likelihood):.6g}")] if stream.filter.has_evidence else facts


def unused(name: str, columns: dict[str, Any]) -> str:
    """Return a name of a column that is not there yet."""
    return name if name not in columns else next(f"{name}_{again}" for again in count(2) if f"{name}_{again}" not in columns)


def as_frame(columns: dict[str, Any], labels: Labels | None, start: int = 0, seconds: Any = None) -> Any:
    """Return a `pandas.DataFrame` of columns `(..., t)`; those of many runs have their numbers in the first levels of the index.

    Args:
        columns: by name.
        labels: of the rows, or None.
        start: number of the first step, where rows have no times.
        seconds: times of rows `(t,)` where there are no labels, or None.
    """
    pandas: Any = checks.need("pandas", "results")
    found = {name: np.asarray(values) for name, values in columns.items()}
    shape = next(iter(found.values())).shape
    if labels is not None and labels.index is not None:
        index = labels.pandas_index()
    elif seconds is not None:
        index = pandas.Index(seconds, name="time")
    else:
        index = pandas.RangeIndex(start, start + shape[-1], name="step")
    if len(shape) > 1:
        runs = ["run"] if len(shape) == 2 else [f"run{place}" for place in range(len(shape) - 1)]
        index = pandas.MultiIndex.from_product([*map(range, shape[:-1]), index], names=[*runs, index.name])
    return pandas.DataFrame({name: values.reshape(-1) for name, values in found.items()}, index=index)
