"""Measurements with time stamps: brought to one line of steps, with the time between them as an input of the model."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from motes.core import checks
from motes.core.record import record, replace, static
from motes.core.types import Inputs
from motes.io import instants, tabular
from motes.io.labels import Labels, labels_of
from motes.laws.observed import Observed


@record
class Timeline:
    """Measurements of a run with their times; `run` takes one for its measurements.

    Attributes:
        ys: measurements, time axis first; of several sensors by name.
        inputs: dictionary of the inputs, with `dt`, the seconds since the step before, `(t,)`; 0 at the first.
        seconds: since the first step, float64 `(t,)`.
        start: the first time: of dates in Unix seconds.
        labels: the times as they were given, and names of columns; None where several sensors were brought together.
    """

    ys: Any
    inputs: Any
    seconds: np.ndarray
    start: float = static()
    labels: Labels | None = static(default=None)


def parted(argument: str, ys: Any, inputs: Inputs) -> tuple[Any, Inputs]:
    """Return measurements and inputs; of a timeline its own.

    Raises:
        MotesError: there are inputs beside a timeline.
    """
    if not isinstance(ys, Timeline):
        return ys, inputs
    if inputs is not None:
        checks.refuse(f"{argument} inputs", "none beside a timeline, which has them", "some", "Give them to mo.times(..., inputs=...).")
    return ys.ys, ys.inputs


def times(stamps: Any = None, ys: Any = None, *, inputs: Inputs = None, **sensors: Any) -> Timeline:
    """Bring measurements with time stamps to one line of steps, however uneven.

    A model that asks for the time between steps finds it among its inputs: `u["dt"]`, in seconds.

    Args:
        stamps: time of each measurement `(t,)`: seconds, datetime64, what pandas makes of them; they never decrease, and may be equal. Left
            out where measurements are a table or series with times of its own: `mo.times(ys=series)`.
        ys: measurements, time axis first.
        inputs: dictionary of further inputs of each step, time axis first; of one sensor only.
        sensors: in place of both, for each sensor of an `Independent` by name its stamps and its measurements, or a table or series with
            times; what has the same time is one step, in which the others measured nothing.

    Raises:
        MotesError: stamps are missing, decrease, or are not as many as measurements; the message names the row.
    """
    if not sensors and stamps is None and ys is not None:
        stamps, ys = _own_times("times ys", ys)
    if bool(sensors) == (stamps is not None):
        checks.refuse("times", "stamps and measurements, or both for each sensor by name", "both" if sensors else "none")
    if not sensors:
        # numbers among stamps are seconds
        stamped = stamps if isinstance(stamps, Labels) else labels_of("times stamps", stamps)
        stamped = None if stamped is None or not stamped.are_times else stamped
        start, seconds = instants.times(stamps.index if isinstance(stamps, Labels) else stamps, name="times stamps")
        ys, own = tabular.unlabelled("times ys", _listed("times ys", ys))
        if own is not None and own.columns and stamped is not None:
            stamped = replace(stamped, columns=own.columns)
        return Timeline(ys, _with_steps(inputs, _counted("times ys", ys, seconds)), seconds, start, stamped)
    if inputs is not None:
        checks.refuse("times inputs", "none beside several sensors", "some", "Add them to `timeline.inputs`, by `timeline.seconds`.")
    found = {}
    pairs = {name: _pair(f"times {name}", given) for name, given in sensors.items()}
    for name, (own, measured) in pairs.items():
        begun, since = instants.times(own, name=f"times {name}")
        found[name] = (begun, _counted(f"times {name}", measured, since))
    start = min(begun for begun, _ in found.values())
    keys = {name: _numbered(begun - start + since) for name, (begun, since) in found.items()}
    line = sorted({key for each in keys.values() for key in each})
    place = {key: row for row, key in enumerate(line)}
    merged = {name: _spread(measured, [place[key] for key in keys[name]], len(line)) for name, (_, measured) in pairs.items()}
    seconds = np.array([second for second, _ in line])
    return Timeline(merged, _with_steps(None, seconds), seconds, start)


def _own_times(name: str, ys: Any) -> tuple[Labels, Any]:
    """Return the labels of a table or series that has times, and its numbers."""
    found, own = tabular.unlabelled(name, ys)
    if own is None or own.index is None:
        checks.refuse(name, "a table or series with an index of times, or stamps beside it", type(ys).__name__)
    return own, found


def _pair(name: str, given: Any) -> tuple[Any, Any]:
    """Return stamps and measurements of one of several sensors."""
    if tabular.is_labelled(given):
        own, ys = _own_times(name, given)
        return own.index, ys
    if not isinstance(given, tuple) or len(given) != 2:
        checks.refuse(name, "a pair of stamps and measurements", type(given).__name__)
    return given[0], tabular.unlabelled(name, _listed(name, given[1]))[0]


def _listed(name: str, ys: Any) -> Any:
    """Return lists of numbers as an array; anything else as it is."""
    return checks.as_numbers(name, ys) if checks.are_numbers(ys) else ys


def _counted(name: str, ys: Any, seconds: np.ndarray) -> np.ndarray:
    lengths = {np.shape(leaf)[0] if np.ndim(leaf) else 0 for leaf in jax.tree.leaves(ys)}
    if lengths != {seconds.size}:
        checks.refuse(name, f"a row for each of {seconds.size} stamps", f"{', '.join(map(str, sorted(lengths))) or 'none'}")
    return seconds


def _numbered(seconds: np.ndarray) -> list[tuple[float, int]]:
    """Return each time, rounded, with how often it has come before: one sensor twice at a time makes two steps."""
    found: list[tuple[float, int]] = []
    for second in np.round(seconds / instants.SAME) * instants.SAME:
        found.append((float(second), found[-1][1] + 1 if found and found[-1][0] == second else 0))
    return found


def _with_steps(inputs: Inputs, seconds: np.ndarray) -> dict[str, Any]:
    if inputs is not None and not isinstance(inputs, dict):
        checks.refuse("times inputs", "a dictionary of inputs by name", type(inputs).__name__)
    if inputs is not None and "dt" in inputs:
        checks.refuse("times inputs", "other names than 'dt', which is the time between steps", "'dt'")
    given = {name: np.asarray(value) if isinstance(value, (list, tuple)) else value for name, value in (inputs or {}).items()}
    for name, value in given.items():
        _counted(f"times inputs {name!r}", value, seconds)
    return {**given, "dt": np.diff(seconds, prepend=seconds[:1]).astype(jnp.result_type(float))}


def _spread(ys: Any, rows: list[int], steps: int) -> Any:
    """Put the measurements of one sensor at its steps of all; numbers are NaN elsewhere, and other arrays say where they are."""
    if isinstance(ys, Observed):
        there = np.zeros(steps, bool)
        there[rows] = ys.there
        return Observed(_spread(ys.value, rows, steps), there)
    leaves = [np.asarray(leaf) for leaf in jax.tree.leaves(ys)]
    real = all(np.issubdtype(leaf.dtype, np.floating) or leaf.ndim < 3 for leaf in leaves)

    def one(leaf: Any) -> np.ndarray:
        array = np.asarray(leaf)
        array = array.astype(np.float64) if real and not np.issubdtype(array.dtype, np.floating) else array
        whole = np.full((steps, *array.shape[1:]), np.nan if real else 0, array.dtype)
        whole[rows] = array
        return whole

    found = jax.tree.map(one, ys)
    return found if real else Observed(found, np.isin(np.arange(steps), rows))
