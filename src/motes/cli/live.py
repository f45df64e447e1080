"""`motes run X --live`: a filter on measurements as they come, until their source ends or the command is asked to.

Results go to the sinks, what happens to the log on the error stream; the run is kept in the folder `--out` and goes on from there.
"""

import logging
import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from motes.cli import interruption, processes
from motes.cli.asked import Asked
from motes.cli.options import check_seed, refuse, seconds, shown

if TYPE_CHECKING:
    from motes.applications.interface import Job
    from motes.filters.interface import Filter
    from motes.live.loop import Run
    from motes.live.message import Form

ENDING = ".live.npz"
"""Of the file that keeps a run."""
MOST_LAG = 100_000
"""Steps that may be gone back to; the laws of all of them are in memory."""


def run_live(wish: Asked) -> None:
    """Run a filter on what comes.

    Raises:
        MotesError: the application cannot be run so, a filter does not fit, or a source or a sink cannot be opened.
    """
    check_seed(wish.settings.seed)
    with logged():
        if wish.settings.hosts or wish.settings.processes != 1:
            refuse("live", "one process", "several")
        job = wish.job()
        name, filter = next(iter(processes.distributed(dict([one_filter(wish, job)]), wish.settings).items()))
        carried_on(*prepared(wish, job, name, filter, wish.settings.live.sinks))


def carried_on(run: "Run", path: Path, done: Callable[[], object] = lambda: None) -> None:
    """Go on with a run from its checkpoint, until its source ends or it is asked to end.

    Args:
        run: see `prepared`.
        path: the file that keeps it.
        done: called once nothing is taken any more, before the process ends where that was asked for.

    Raises:
        MotesError: see `Run.restore` and `Run.go`.
    """
    from motes.live.counts import LOG

    assert run.checkpoint is not None
    with run.checkpoint.locked():
        try:
            run.restore()
        except Exception:
            run.close()
            raise
        with interruption.saving(interrupts=True):
            try:
                run.go(interruption.is_asked)
            finally:
                LOG.info("%s", run.counts.told())
            done()
            step = run.kept_at
            if interruption.is_asked():
                if step is not None:
                    interruption.keeps(f"{path} (step {step})")
                interruption.end()
        if run.source.is_over:
            with suppress(OSError):
                path.unlink(missing_ok=True)
        elif step is not None:
            LOG.info("kept in %s (step %d): the same command goes on from there.", path, step)


@contextmanager
def logged() -> Iterator[None]:
    """Have what happens in a `with` block written on the error stream, a line each."""
    from motes.live.counts import LOG

    handler = logging.StreamHandler()
    handler.setFormatter(logging.Formatter("%(asctime)s %(levelname)s %(message)s"))
    level, LOG.propagate = LOG.level, False
    LOG.addHandler(handler)
    LOG.setLevel(logging.INFO)
    try:
        yield
    finally:
        LOG.removeHandler(handler)
        LOG.setLevel(level)
        LOG.propagate = True


def prepared(wish: Asked, job: "Job", name: str, filter: "Filter", sinks: Sequence[str]) -> "tuple[Run, Path]":
    """Return a run that is ready to go, and the file that keeps it.

    Args:
        wish: what is asked for.
        job: that it asks for.
        name: of the filter; see `one_filter`.
        filter: as it was named.
        sinks: addresses where results go.

    Raises:
        MotesError: see `run_live`.
    """
    from motes.live.checkpoint import Checkpoint
    from motes.live.counts import LOG
    from motes.live.loop import Run, Work
    from motes.live.places import sinks_at, source_at
    from motes.live.replay import Replay
    from motes.models.state_space import at_step

    asked = wish.settings.live
    _refuse_numbers(asked)
    budget = seconds(asked.budget) if asked.budget else None
    if "smoother" in wish.choices:
        LOG.warning("smoother: left out; a live run tells of each step as it comes, motes run without --live smooths.")
    filter = job.worn(filter)
    form = form_of(job, getattr(wish.settings, "data", None), asked)
    u = at_step(job.inputs, 0)
    if job.inputs is not None or not (form.inputs or form.timed):
        filter.prepare(job.model, u)
    path = Path(wish.settings.out) / f"{name}{ENDING}"
    if asked.source:
        source: Any = source_at(asked.source, form)
        LOG.info("waits for messages from %s, such as %s", source.name, form.example())
    elif job.ys is None:
        refuse("live source", "where measurements come from", "none", "Give --source udp://127.0.0.1:5005, --source - or a file.")
    else:
        source = Replay(wish.application.name, job.ys, job.inputs, job.times, asked.speed)
    try:
        recorded = getattr(wish.settings, "data", "")
        opened = sinks_at(sinks, asked.source, recorded if isinstance(recorded, str) else getattr(recorded, "file", ""))
    except Exception:
        source.close()
        raise
    checkpoint = Checkpoint(path, _told_apart(wish, job, name, filter.fixed_count, form), u)
    return Run(Work(wish.settings.seed, filter, job.model, form), source, asked, sinks=opened, checkpoint=checkpoint, budget=budget), path


def _refuse_numbers(asked: Any) -> None:
    """Refuse numbers that cannot be."""
    from motes.core import checks

    checks.natural("live lag", asked.lag)
    if asked.lag > MOST_LAG:
        refuse("live lag", f"at most {MOST_LAG} steps", shown(asked.lag))
    for name in ("jump", "checkpoint"):
        checks.above_zero(f"live {name}", getattr(asked, name))
    for name in ("speed", "wait", "patience"):
        if not 0 <= getattr(asked, name) < float("inf"):
            refuse(f"live {name}", "a number of at least 0", getattr(asked, name))


def one_filter(wish: Asked, job: "Job") -> "tuple[str, Filter]":
    """Return the filter that is to run, by name.

    Raises:
        MotesError: there are several, or the job does not take its measurements one by one.
    """
    from motes.applications.interface import Job

    if callable(job.ys) or not job.goes_on or type(job).pieces is not Job.pieces or type(job).piece is not Job.piece:
        refuse("live", "an application whose measurements are taken one by one", wish.application.name)
    filters = wish.filters(job, "filter", "filters")
    if len(filters) > 1:
        refuse("live filter", "one filter", ", ".join(filters), "Give --filter NAME, or a table [filter].")
    return next(iter(filters.items()))


def form_of(job: "Job", data: Any, asked: Any) -> "Form":
    """Return what messages of a job look like.

    Args:
        job: the job.
        data: settings of the data of a model of the user's own; of an application anything else.
        asked: settings of the live run.
    """
    import numpy as np

    from motes.cli.own import Data
    from motes.live.message import Form, Names
    from motes.models.state_space import at_step

    own = data if isinstance(data, Data) else Data()
    columns, time = asked.columns or own.columns, asked.time or own.time
    sizes = {name: size for mode in job.model.each_mode() for name, size in mode.sensor.sensors}
    y = None if job.ys is None else at_step(job.ys, 0)
    if sizes and (not columns or sizes.keys() >= set(columns)):
        names = columns or tuple(sizes)
        columns, y = names, y if isinstance(y, dict) else {name: np.zeros(sizes[name]) for name in names}
    elif isinstance(y, dict) and columns and set(columns) != set(y):
        refuse("live columns", f"the names {', '.join(y)}", shown(", ".join(columns)))
    for key, several in (("columns", columns if asked.source else ()), ("fields", asked.fields)):
        if len(set(several)) < len(several):
            refuse(f"live {key}", "names that differ", shown(", ".join(several)))
    names = Names(columns, own.inputs, time, asked.number, asked.fields)
    return Form(names, y, None if job.inputs is None else at_step(job.inputs, 0), timed=bool(time))


def _place_of(source: str) -> str:
    """Return the address of a source, of a file its whole path: the command may be given from another folder."""
    return os.path.abspath(source) if os.path.isfile(source) else source


def _told_apart(wish: Asked, job: "Job", name: str, count: int | None, form: "Form") -> dict[str, str]:
    """Return what tells a run from others: what it reads and by which rules, and the model where functions can be compared."""
    import jax

    from motes.cli.long_runs import digest_of
    from motes.live.checkpoint import identity
    from motes.models.canonical import canonical, one_of

    asked = wish.settings.live
    model = digest_of(lambda: canonical(job.model, *jax.tree.map(one_of, (job.inputs, job.ys))))
    names = (form.columns, form.inputs, form.time, form.number, form.fields)
    # what waits is given out again only to a run that waits, too; the other rules may change
    return identity(application=wish.application.name, filter=name, number_of_particles=count, seed=wish.settings.seed,
                    source=_place_of(asked.source), names_in_messages=names, policy_of_late_messages=asked.late == "wait",
                    model=model)  # fmt: skip
