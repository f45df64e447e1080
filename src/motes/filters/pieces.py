"""Measurements that come one after the other, from a file longer than memory or a device: gathered into pieces of a few megabytes."""

from collections.abc import Iterator
from itertools import chain, islice
from typing import Any

import jax
import numpy as np

from motes.core import checks
from motes.core.progress import bars
from motes.core.types import Inputs
from motes.models.interface import Model

BYTES, STEPS = 16_000_000, 1_000
"""Most that a piece holds."""


def pieces(model: Model, measurements: Iterator[Any], inputs: Inputs) -> Iterator[tuple[Any, Inputs]]:
    """Give pieces as `gathered` does, and show how many steps went by."""
    with bars("steps", passing=True) as progress:
        task = progress.add_task("run", total=None)
        for piece, rows in gathered(model, measurements, inputs):
            yield piece, rows
            progress.advance(task, len(piece))


def gathered(model: Model, measurements: Iterator[Any], inputs: Inputs) -> Iterator[tuple[Any, Inputs]]:
    """Give pieces of measurements, as `run` takes them whole, with their inputs.

    Args:
        model: that they are of.
        measurements: one for each step, or several in a list; of a sensor of vectors rows `(t, y)`, too.
        inputs: of all steps, time axis first; or an iterator of those of each step; or None.

    Raises:
        MotesError: there are no measurements, or there are fewer or more inputs.
    """
    vectors = not all(part.sensor.measures_anything for part in model.each_mode())
    steps = _one_by_one(measurements, vectors)
    first = next(steps, None)
    if first is None:
        checks.refuse("ys", "at least one measurement", "an iterator without any")
    rows = inputs if isinstance(inputs, Iterator) else None
    done, length, begun = 0, 0, []
    for (one,) in chain([first], steps):
        begun.append(one)
        if not length and one is not None:
            size = sum(np.asarray(leaf).nbytes for leaf in jax.tree.leaves(one))
            length = int(np.clip(BYTES // max(1, size), 1, STEPS))
        # what was not measured does not show its form, and takes no memory
        if length and len(begun) >= length and any(one is not None for one in begun):
            yield begun, _inputs_of(inputs, rows, done, len(begun))
            done, begun = done + len(begun), []
    if begun:
        yield begun, _inputs_of(inputs, rows, done, len(begun))
        done += len(begun)
    if rows is None and inputs is not None and {np.shape(leaf)[0] for leaf in jax.tree.leaves(inputs)} != {done}:
        checks.refuse("inputs", f"arrays with the time axis first, {done} steps as there were measurements",
                      f"first axes {sorted({np.shape(leaf)[0] for leaf in jax.tree.leaves(inputs)})}")


def _one_by_one(measurements: Iterator[Any], vectors: bool) -> Iterator[tuple[Any]]:
    """Give each measurement in a tuple of its own: None is one, too."""
    for item in measurements:
        if isinstance(item, list) and not (vectors and all(np.ndim(one) == 0 for one in item if one is not None)):
            yield from ((one,) for one in item)
        elif vectors and np.ndim(item) == 2:
            yield from ((row,) for row in np.asarray(item))
        else:
            yield (item,)


def _inputs_of(inputs: Inputs, rows: Iterator[Any] | None, begin: int, count: int) -> Inputs:
    if rows is None:
        return jax.tree.map(lambda leaf: leaf[begin : begin + count], inputs)
    found = list(islice(rows, count))
    if len(found) < count:
        checks.refuse("inputs", f"inputs of step {begin + len(found)}, which has a measurement", "no more")
    return jax.tree.map(lambda *leaves: np.stack(leaves), *found)
