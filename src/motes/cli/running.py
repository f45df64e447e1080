"""Run filters with a progress bar and a clock, print what came out, and write it to a folder."""

import dataclasses
import json
import math
import os
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np
from rich.console import Console
from rich.progress import TaskID
from rich.table import Table as Shown

from motes.applications.interface import Job
from motes.cli.long_runs import long_run, whole_run
from motes.core.checks import FileError, need, refuse
from motes.core.progress import bars
from motes.core.record import replace
from motes.core.watchdog import watched
from motes.filters import keep
from motes.filters.data import checked_data, steps_of
from motes.filters.frames import deviations
from motes.filters.history import History, joined
from motes.filters.interface import Filter
from motes.filters.keep import Keep
from motes.filters.run import run
from motes.io import archive
from motes.io.archive import provenance, whole_file
from motes.io.clocks import Clock
from motes.io.files import label
from motes.io.result_table import Table
from motes.models.state_space import at_step
from motes.smoothers.interface import Smoother
from motes.smoothers.smooth import smooth

DOTS = {".gif": 80}
"""Dots of an inch of what is no PNG."""


class Outcome(NamedTuple):
    """One filter's run.

    Attributes:
        filter: the filter.
        history: what it found.
        seconds_per_step: median time of a step, compilation left out; None for runs too short to tell.
    """

    filter: Filter
    history: History
    seconds_per_step: float | None


def race(seed: int, filters: Mapping[str, Filter], job: Job, keep: Keep, folder: str) -> dict[str, Outcome]:
    """Run each filter over the same measurements, with a progress bar where the error stream is a terminal.

    Args:
        seed: of all filters.
        filters: by name.
        job: model, measurements and inputs.
        keep: what to keep of each step.
        folder: where runs that take longer are kept while they last.

    Raises:
        MotesError: a filter does not fit the model, or its weights collapsed.
    """
    model, long = job.model, callable(job.ys)
    ys, inputs = (job.ys, None) if long else checked_data(model, job.ys, job.inputs)
    worn = {name: job.worn(one) for name, one in filters.items()}
    for one in worn.values():
        one.prepare(model, at_step(inputs, 0))

    def standing() -> str:
        return ", ".join(f"{task.completed:.0f}{f' of {task.total:.0f}' if task.total else ''} steps of {task.description}"
                         for task in progress.tasks)  # fmt: skip

    outcomes = {}
    with bars("steps") as progress, watched("motes", standing) as further:
        # all at once, so that the time that is left is that of all
        tasks = {name: progress.add_task(name, total=job.length() if long else steps_of(ys), start=False) for name in worn}
        for name, one in worn.items():
            task = tasks[name]
            progress.start_task(task)

            def advance(steps: int, task: TaskID = task) -> None:
                progress.advance(task, steps)
                further()

            path = Path(folder) / name
            pieces = (long_run(seed, filters[name], job, keep, path) if long else
                      whole_run(seed, one, job, ys, inputs, keep, path))
            # what is told as it comes is told once: of the filter that the pictures show
            history, seconds = _timed(pieces, advance, job.news() if name == next(iter(worn)) else lambda piece: ())
            history = history if job.times is None else replace(history, times=job.start + np.asarray(job.times, np.float64))
            outcomes[name] = Outcome(filters[name], history, seconds)
    return outcomes


def _timed(
    run: Iterator[History], advance: Callable[[int], None], news: Callable[[History], Sequence[str]]
) -> tuple[History, float | None]:
    """Put the pieces of a run together; the median time of a step beside it."""
    pieces, times, seen = [], [], set()
    began = time.perf_counter()
    for piece in run:
        jax.block_until_ready(piece)
        now = time.perf_counter()
        count, goes_on = steps(piece), int(piece.start) > 0
        # the first chunk, and each new length, are compiled when they are first met
        if (goes_on, count) in seen:
            times.append((now - began) / count)
        seen.add((goes_on, count))
        # where it ended goes with the last one alone: laws and measurements can be large
        pieces[-1:] = [replace(one, last=None) for one in pieces[-1:]] + [piece]
        advance(count)
        for line in news(piece):
            print(line, flush=True)
        began = time.perf_counter()
    return joined(pieces), float(np.median(times)) if times else None


def steps(history: History) -> int:
    """Return the number of steps of a run."""
    return history.info.ess.shape[0]


def size(filter: Filter) -> str:
    """Return the number of particles of a filter as a table shows it; a dash where it has none."""
    return "-" if filter.particle_count is None else str(filter.particle_count)


def check_smoother(seed: int, smoother: Smoother, filters: Mapping[str, Filter], job: Job) -> None:
    """Refuse, before the work and not after it, a smoother that does not fit a filter: both are traced over two steps, nothing is computed.

    Raises:
        MotesError: it does not fit.
    """
    ys, inputs = jax.tree.map(lambda leaf: leaf[:2], checked_data(job.model, job.ys, job.inputs))
    for filter in filters.values():
        def both(key: jax.Array, filter: Filter = filter) -> Any:
            return smooth(key, smoother, job.model, run(key, filter, job.model, ys, inputs, keep=keep.laws), ys, inputs)

        jax.eval_shape(both, jax.random.key(seed))


def write_smoothed(path: Path, seed: int, smoother: Smoother, job: Job, history: History, decimal: str) -> None:
    """Smooth what was filtered, and write means and standard deviations as a table, with a mark of decimals."""
    found = smooth(seed + 1, smoother, job.model, history, job.ys, job.inputs)
    spread = deviations(np.asarray(found.cov, np.float64))
    columns = ("step", *found.names, *(f"sd {name}" for name in found.names))
    both = np.concatenate([np.asarray(found.mean), spread], axis=1)
    Table(columns, tuple((step, *map(float, row)) for step, row in enumerate(both))).save(path, decimal)


def write_dataset(path: Path, history: History, clock: Clock) -> None:
    """Write a history as NetCDF, its times as dates where those of the measurements are."""
    data = history.to_xarray()
    if clock.format and history.times is not None:
        micro = np.round(np.asarray(history.times, np.float64) * 1e6).astype(np.int64)
        data = data.assign_coords(time=micro.astype("datetime64[us]").astype("datetime64[ns]"))
    archive.write_dataset(path, data)


def results(outcome: Outcome) -> dict[str, Any]:
    """Return what a table or a summary tells of a run besides its errors."""
    ess = np.asarray(outcome.history.ess)
    milliseconds = None if outcome.seconds_per_step is None else 1e3 * outcome.seconds_per_step
    found = {"filter": repr(outcome.filter), "median_ess": float(np.median(ess)), "milliseconds_per_step": milliseconds}
    found["alarms"] = int(np.sum(np.asarray(outcome.history.info.alarm)))
    if outcome.history.has_evidence:
        found["log_likelihood"] = float(outcome.history.log_likelihood)
    return found


def show(title: str, head: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Print a table; the first column is text, the others are numbers. One too wide for the terminal is turned: a column for each row."""
    console, lines = Console(), [head, *rows]
    if sum(max(map(len, column)) + 3 for column in zip(*lines, strict=True)) + 1 > console.width:
        lines = list(zip(*lines, strict=True))
    table = Shown(title=title, title_justify="left")
    for place, name in enumerate(lines[0]):
        table.add_column(name, justify="left" if place == 0 else "right", overflow="fold")
    for row in lines[1:]:
        table.add_row(*row)
    console.print(table)


def number(value: float | None, digits: int) -> str:
    """Return a number as a table shows it; a dash where there is none."""
    return "-" if value is None or not math.isfinite(value) else f"{value:.{digits}f}"


def check_written() -> None:
    """Refuse, before the work and not after it, where a module is missing that writes results.

    Raises:
        MissingExtraError: one is.
    """
    for module in ("matplotlib.figure", "xarray", "h5netcdf"):
        need(module, "results")


def check_folder(path: str) -> None:
    """Refuse, before anything is computed, a folder for results that could not be written to, and print where it is; makes nothing.

    Raises:
        FileError: it has no name, is no folder, or may not be written to.
    """
    if not path or "\0" in path:
        refuse("out", "a folder for results", "none" if not path else repr(path[:80]), "Write . for the current one.", error=FileError)
    place = Path(path).absolute()
    try:
        existing = next(above for above in (place, *place.parents) if os.path.lexists(above))
        is_folder, blocks = existing.is_dir(), os.statvfs(existing).f_blocks
    except OSError as reason:
        refuse(label(path), "a folder that can be written", reason.strerror or str(reason), error=FileError)
    if not is_folder:
        refuse(label(path), "a folder that can be written", f"{existing.name[:80]}, which is not a folder", error=FileError)
    # some file systems, such as /proc, allow nothing although the permissions would
    if not os.access(existing, os.W_OK | os.X_OK) or blocks == 0:
        refuse(label(path), "a folder that can be written", f"{label(existing)}, which cannot be written to", error=FileError)
    print(f"Results go to {os.path.normpath(place)}.")


def made_folder(path: str) -> Path:
    """Return the folder for results, made where it is missing.

    Raises:
        FileError: it cannot be made.
    """
    place = Path(path)
    try:
        place.mkdir(parents=True, exist_ok=True)
    except OSError as reason:
        refuse(label(path), "a folder that can be written", reason.strerror or str(reason), error=FileError)
    return place


def write_summary(path: Path, source: dict[str, Any], settings: Any, found: dict[str, Any]) -> None:
    """Write a JSON file with where the results come from, all settings, and the results; numbers that are not finite become null."""
    content = {"provenance": provenance(), **source, "settings": dataclasses.asdict(settings), "results": found}
    write_text(path, json.dumps(_finite(content), indent=2, allow_nan=False) + "\n")


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_finite(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def write_text(path: Path, text: str) -> None:
    """Write a text file, whole or not at all."""
    with whole_file(path) as file:
        file.write(text.encode())


def write_figure(path: Path, figure: Any) -> None:
    """Write a figure as PNG, or what moves as GIF or MP4, whole or not at all."""
    with whole_file(path) as file:
        figure.savefig(file, format=path.suffix[1:], dpi=DOTS.get(path.suffix, 130))
