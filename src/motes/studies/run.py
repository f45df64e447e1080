"""Running a study: what is missing is computed by any number of workers, kept as it comes, and put together."""

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from itertools import islice
from pathlib import Path
from queue import SimpleQueue
from typing import Any

from motes.core import checks, engine
from motes.core.progress import bars
from motes.core.settings import for_another_process, in_force
from motes.core.watchdog import watched
from motes.core.workers import Workers
from motes.studies.executors import WINDOW, absences, check_executor, result_of
from motes.studies.experiment import Experiment
from motes.studies.identity import of_filters, of_world
from motes.studies.result import StudyResult, notes_of
from motes.studies.store import Entry, Memory, Store
from motes.studies.work import TRUTH, Block, Work, batch_width, built, remote_block

CHUNK = 8
"""Runs that are computed, and kept, at a time on a CPU."""

Task = tuple[str, int, int]
"""A part (a filter, or the truth), its first run, and one after its last."""


def study(
    experiment: Experiment | str,
    store: str | Path | None = None,
    executor: Any = None,
    chunk: int | None = None,
    progress: bool | None = None,
    repair: bool = False,
) -> StudyResult:
    """Simulate the runs of an experiment and run each of its filters on each of them: a Monte Carlo study.

    The numbers are the same, bit for bit, whatever the chunks, workers, order of completion and interruptions, on one kind of processor. A
    store lets a study that was stopped or killed go on where it was, and take further runs or filters without touching those it has.

    Args:
        experiment: what to run; or, for an executor of other processes, the name "module:function" of a function that makes it, and after
            a space the words that it is called with, as a shell would take them.
        store: folder to keep the runs in as they come; None keeps them in memory.
        executor: what has `submit(function, *arguments)` and gives futures with `result`, `cancel` and `add_done_callback`, such as a
            `concurrent.futures.ProcessPoolExecutor` that spawns its processes, or a Dask `Client`; None for threads of this process, one
            for each processor.
        chunk: runs to compute and keep at a time; 8 on a CPU and a batch on an accelerator if not given.
        progress: whether to draw a progress bar on the error stream; where that is a terminal, if not given.
        repair: whether to compute runs again whose files in the store are damaged; otherwise these are an error.

    Raises:
        MotesError: parts of the experiment do not fit each other, or an argument cannot be used.
        FileError: the store is of another experiment (the message names what differs), is damaged, is in use, or cannot be written to.
        KeyboardInterrupt: the study was interrupted; the message says how to go on.
    """
    plan = built(experiment) if isinstance(experiment, str) else experiment
    if not isinstance(plan, Experiment):
        checks.refuse("study experiment", "an Experiment, or the name of a function that makes one, 'module:function'", type(plan).__name__)
    if executor is not None:
        check_executor(experiment, executor)
    width = batch_width()  # 1 on a CPU
    chunk = (CHUNK if width == 1 else width) if chunk is None else chunk
    checks.positive_integer("study chunk", chunk)
    plan.check()
    with Memory() if store is None else Store(Path(store)) as kept:
        notes = notes_of(plan, engine.chosen())
        if isinstance(kept, Store):
            kept.bind(of_world(plan), {TRUTH: Entry("", "truth")} | of_filters(plan), notes)
            kept.verify(repair)
        tasks, pending = _missing(plan, kept, chunk), {}
        work = Work(plan, width) if executor is None else None
        try:
            with _watched(plan, tasks, store, executor is None) as seen, _bar(plan, tasks, progress) as drawn:
                with _workers(experiment, work, executor, width) as submit:
                    gone = absences(executor)
                    _work_off(tasks, submit, pending, kept, lambda runs: (seen(runs), drawn(runs), gone()))
        except KeyboardInterrupt:
            with suppress(KeyboardInterrupt):  # a second Ctrl-C ends the saving
                for block in _done(pending, work):
                    kept.put(*block)
            raise KeyboardInterrupt(_how_to_go_on(plan, kept, store, chunk)) from None
        labels = {name: repr(plan.assumed(name)[0]) for name in plan.filters}
        return StudyResult.read(kept, list(plan.filters), plan.runs, notes | {"labels": labels})


def _missing(plan: Experiment, kept: Store | Memory, chunk: int) -> list[Task]:
    """Return the blocks of runs that are still to be computed: the first of each part, then the second of each, and so on."""
    tasks = []
    for part in (TRUTH, *plan.filters):
        have = 0
        for start, stop in [*kept.done(part), (plan.runs, plan.runs)]:
            tasks += [(part, first, min(first + chunk, start, plan.runs)) for first in range(have, min(start, plan.runs), chunk)]
            have = max(have, stop)
    return sorted(tasks, key=lambda task: task[1])


@contextmanager
def _workers(source: Any, work: Work | None, executor: Any, width: int) -> Iterator[Callable[..., Any]]:
    """Give what submits a task; leaving by an error ends the threads of this process after the run at hand, or leaves them to it."""
    settings = in_force()
    if work is None:
        yield lambda *task: executor.submit(remote_block, source, for_another_process(settings), width, *task)
        return
    with Workers(processors() if width == 1 else 1) as workers:
        try:
            yield lambda *task: workers.submit(work.block, settings, *task)
        except BaseException:
            work.stopping.set()
            raise


def processors() -> int:
    """Return how many processors this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _work_off(
    tasks: list[Task], submit: Callable[..., Any], pending: dict[Any, Task], kept: Store | Memory, advance: Callable[[int], object]
) -> None:
    finished: SimpleQueue[Any] = SimpleQueue()
    coming = iter(tasks)

    def hand_out(count: int) -> None:
        for task in islice(coming, count):
            future = submit(*task)
            pending[future] = task
            future.add_done_callback(finished.put)

    try:
        hand_out(WINDOW)
        while pending:
            future = finished.get()
            part, start, stop = pending.pop(future)
            hand_out(1)
            kept.put(part, start, stop, result_of(future))
            advance(stop - start if part != TRUTH else 0)
    finally:
        for future in pending:
            future.cancel()


def _done(pending: dict[Any, Task], work: Work | None) -> Iterator[Block]:
    """Give what was done but not kept when the study was interrupted: whole blocks, and the first runs of those at hand."""
    for future, (part, start, stop) in pending.items():
        if future.done() and not future.cancelled() and future.exception() is None:
            yield part, start, stop, future.result()
    if work is not None:
        yield from work.unfinished()


@contextmanager
def _watched(plan: Experiment, tasks: list[Task], store: Any, here: bool) -> Iterator[Callable[[int], None]]:
    """Say where the study stands when it does not get further."""
    total, done = plan.runs * len(plan.filters), [_left(tasks)]
    hint = "" if store is None else "; what is done is kept"

    def advance(runs: int) -> None:
        done[0] -= runs
        moved()

    with watched("study", lambda: f"{total - done[0]} of {total} runs", hint, here) as moved:
        yield advance


@contextmanager
def _bar(plan: Experiment, tasks: list[Task], progress: bool | None) -> Iterator[Callable[[int], None]]:
    """Draw a progress bar over the runs of all filters, with the time that is left."""
    total = plan.runs * len(plan.filters)
    left = _left(tasks)
    with bars("runs", progress) as drawn:
        bar = drawn.add_task("study", total=total, completed=total - left)
        yield lambda runs: drawn.advance(bar, runs)


def _left(tasks: list[Task]) -> int:
    return sum(stop - start for part, start, stop in tasks if part != TRUTH)


def _how_to_go_on(plan: Experiment, kept: Store | Memory, store: Any, chunk: int) -> str:
    total = plan.runs * len(plan.filters)
    left = _left(_missing(plan, kept, chunk))
    if store is None:
        return f"study: interrupted after {total - left} of {total} runs; none is kept. Give a store to be able to go on."
    return f"study: interrupted; {total - left} of {total} runs are in {store}. The same call goes on from there."
