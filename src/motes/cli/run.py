"""`motes run APPLICATION`: run filters on an application or a model of the user's own, its measurements made up or from files.

Writes to the folder `--out`: for each filter its history as NetCDF and as NPZ, and, where a smoother is named, a table of what that found;
`track.csv`, the way that the first filter found, step by step (`NAME_track.csv` of the others); `summary.json`; the tables and pictures of
the application. The last lines say whether the runs can be trusted. With `--live` measurements are taken as they come: see `live.py`.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from motes.cli import processes
from motes.cli.asked import Asked, Run, asked
from motes.cli.options import check_seed, refuse
from motes.cli.records import build
from motes.io.dialect import PLAIN, Dialect

if TYPE_CHECKING:
    from motes.applications.interface import Job
    from motes.cli.running import Outcome

USAGE = "motes run APPLICATION"
MOST_SCORES = 6
"""Columns of scores that a table has room for."""


def main(words: Sequence[str]) -> None:
    """Run what is asked for.

    Raises:
        MotesError: an option, a file or the user's function cannot be used.
    """
    wish = asked(Run, words, USAGE)
    if wish.settings.live.is_asked_for:
        from motes.cli import live

        live.run_live(wish)
        return
    if processes.started("run", words, wish.settings):
        return
    with processes.at_work(wish.settings):
        done = carried_out(wish)
        print(f"Results are in {done.folder}.")
        trusted(done)


class Done(NamedTuple):
    """What was run.

    Attributes:
        folder: with the results.
        job: that was run.
        outcomes: of each filter.
    """

    folder: Path
    job: "Job"
    outcomes: "dict[str, Outcome]"


def trusted(done: Done) -> None:
    """Say in words whether each run can be trusted: the last line of the command."""
    from motes.core.hosts import is_first

    if not is_first():
        return
    for name, outcome in done.outcomes.items():
        found = done.job.diagnosed(outcome.history)
        serious = [finding for finding in found.findings if finding.serious]
        if serious:
            first, more = serious[0], [finding.name for finding in found.findings if finding is not serious[0]]
            also = f" Also: {', '.join(more)}." if more else ""
            print(f"{name}: not to be trusted as it is ({first.name}): {first.text} {first.advice}{also}")
        elif found.findings:
            print(f"{name}: can be trusted, with a note: {' '.join(finding.text for finding in found.findings)}")
        else:
            print(f"{name}: can be trusted: nothing wrong was found.")


def carried_out(wish: Asked) -> Done:
    """Run filters, print a table, and write histories, a summary and pictures.

    Args:
        wish: what is asked for.

    Returns:
        What was run.

    Raises:
        MotesError: the application refuses, a filter does not fit or collapsed, or a file cannot be written.
    """
    settings = wish.settings
    check_seed(settings.seed)
    from motes.cli import long_runs, running
    from motes.core.hosts import is_first
    from motes.filters import keep
    from motes.smoothers.interface import Smoother

    running.check_written()
    wish.chosen("filter", "filters")  # names that nobody knows are told before a world is made up
    smoother = build(Smoother, wish.choices["smoother"], "smoother") if "smoother" in wish.choices else None
    running.check_folder(settings.out)
    job = wish.job()
    if job.ys is None:
        refuse("data", "a file of measurements", "none", "Give --data FILE, or return 'ys' from the function.")
    filters = processes.distributed(wish.filters(job, "filter", "filters"), settings)
    if job.about():
        print(job.about())
    if smoother is not None:
        running.check_smoother(settings.seed, smoother, filters, job)
    outcomes = running.race(settings.seed, filters, job, keep.laws if smoother else job.keep, settings.out)
    histories = {name: outcome.history for name, outcome in outcomes.items()}
    folder = running.made_folder(settings.out)
    if not is_first():
        return Done(folder, job, outcomes)
    scores = {name: job.scores(history) for name, history in histories.items()}
    found = {name: running.results(outcome) | {_key(one): one.value for one in scores[name]} for name, outcome in outcomes.items()}
    _show(job, outcomes, scores, found)
    written = getattr(settings, "data", None)
    decimal = written.decimal if isinstance(written, Dialect) else PLAIN.decimal
    for name, history in histories.items():
        running.write_dataset(folder / f"{name}.nc", history, job.clock)
        history.save(folder / f"{name}.npz")
        if smoother is not None:
            running.write_smoothed(folder / f"{name}_smoothed.csv", settings.seed, smoother, job, history, decimal)
        track = job.track(history)
        if track is not None:
            track.save(folder / ("track.csv" if name == next(iter(histories)) else f"{name}_track.csv"), decimal)
        for what, table in job.tables(history).items():
            table.save(folder / f"{name}_{what}.csv", decimal)
    for name, figure in job.pictures(histories).items():
        running.write_figure(folder / name, figure)
    running.write_summary(folder / "summary.json", {"application": wish.application.name}, settings, found)
    long_runs.forget()
    for history in histories.values():
        said = job.verdict(history)
        if said:
            print(said)
    return Done(folder, job, outcomes)


def _show(job: "Job", outcomes: "dict[str, Outcome]", scores: dict[str, Any], found: dict[str, dict[str, Any]]) -> None:
    """Print what came out as a table, a row for each filter."""
    from motes.cli import running

    shown = next(iter(scores.values()))[:MOST_SCORES]
    head = ("filter", "n", *(f"{one.name}, {one.unit}" if one.unit else one.name for one in shown), "ESS", "ms/step")
    rows = [(name, running.size(outcome.filter),
             *(running.number(one.value, one.digits) for one in scores[name][:MOST_SCORES]),
             running.number(found[name]["median_ess"], 0), running.number(found[name]["milliseconds_per_step"], 2))
            for name, outcome in outcomes.items()]  # fmt: skip
    running.show(job.title(running.steps(next(iter(outcomes.values())).history)), head, rows)


def _key(score: Any) -> str:
    """Return the key of a score in the summary, such as final_error_m."""
    unit = f"_{score.unit.replace('/', '_per_')}" if score.unit else ""
    return score.name.replace(" ", "_") + unit
