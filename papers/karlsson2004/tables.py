"""Tables II and III, and how the gain depends on the track."""

from pathlib import Path

import numpy as np
from clock import Matched, in_turns
from printed import FULL, PLAIN, TABLE_II, TABLE_III
from scenario import BLOCKS, experiment, make_filter, nearest, track

import motes as mo
from motes.core.record import replace
from motes.plotting.figures import COLORS, new_figure, tidy
from motes.studies.tables import accuracy, difference

FEWEST = 10
"""Particles at which the search of table III begins."""


def table_2(scenario: str, match: Matched, runs: int) -> mo.io.Table:
    """Return accuracy at equal times: one row for each partition and block.

    Where runs are lost, "kept" is the RMSE of the others, and partitions are compared over the runs that both of them kept.
    """
    plan = experiment(scenario, match.sizes, runs)
    result = mo.study(plan, progress=False)
    errors = result.table(mo.bounds.kalman_at_truth(plan.model, plan.track))
    rows = []
    for row in errors.rows:
        cells = dict(zip(errors.columns, row, strict=True))
        name, block = cells["filter"], cells["block"]
        times = 1e6 * match.seconds[name], match.seconds[name] / match.seconds[PLAIN]
        found = (cells["RMSE"], cells["s.e."], cells.get("kept", cells["RMSE"]), cells["median"])
        compared = (None, None) if name == PLAIN else change(result, block, result.filters.index(name))
        paper = TABLE_II[name][1 + list(BLOCKS).index(block)]
        rows.append((name, match.sizes[name], *times, block, *found, *compared, cells["of bound"], cells["lost"], paper))
    columns = ("partition", "N", "us/step", "of plain", "block", "RMSE", "s.e.", "kept", "median run", "to plain, percent", "s.e. of it",
               "of Kalman at truth", "lost", "paper")
    return mo.io.Table(columns, tuple(rows))


def change(result: mo.studies.StudyResult, block: str, place: int) -> tuple[float, float]:
    """Return by how many percent the RMSE of a filter is above that of the first one, and the standard error of that."""
    both = ~(result.lost[0] | result.lost[place])
    squared = result.squared_errors(block)[:, both]
    first, beyond = accuracy(squared[0]), difference(squared[place], squared[0])
    return 100 * beyond.rmse / first.rmse, 100 * beyond.error / first.rmse


def table_3(plan: mo.Experiment, turns: int, precision: float) -> mo.io.Table:
    """Return how many particles each partition of an experiment needs for the velocity RMSE of the first one, the plain filter.

    The search ends where the runs cannot tell any more; so there is a comparison at the paper's numbers too.
    """
    n = plan.filters[PLAIN].n
    others = [name for name in plan.filters if name != PLAIN]
    found = {name: mo.studies.particles_for_rmse(plan, name, "velocity", PLAIN, (FEWEST, n), precision) for name in others}
    sizes = {PLAIN: n} | {name: needed.n for name, needed in found.items()}
    result = mo.study(_resized(plan, sizes), progress=False)
    printed = mo.study(_resized(plan, {PLAIN: n} | {name: TABLE_III[name][0] for name in others}), progress=False)
    times = in_turns(sizes.items(), turns)
    rows = []
    for place, (name, size) in enumerate(sizes.items()):
        low, high = (found[name].at_least, found[name].at_most) if name in found else (n, n)
        rmses = (accuracy(result.squared_errors(block)[place]).rmse for block in BLOCKS)
        taken = 1e6 * times[name, size], 100 * times[name, size] / times[PLAIN, n]
        compared = change(printed, "velocity", place) if place else (None, None)
        rows.append((name, size, low, high, 100 * size / n, *rmses, *taken, TABLE_III[name][0], *compared))
    columns = ("partition", "N", "above", "below", "of plain, percent", *BLOCKS, "us/step", "time of plain, percent", "paper's N",
               "there velocity to plain, percent", "s.e.")
    return mo.io.Table(columns, tuple(rows))


def _resized(plan: mo.Experiment, sizes: dict[str, int]) -> mo.Experiment:
    return replace(plan, filters={name: make_filter(name, n) for name, n in sizes.items()})


def tracks(match: Matched, runs: int, count: int, out: Path) -> str:
    """Compare full marginalization with the plain filter on many tracks, and return the summary to print."""
    sizes = {name: match.sizes[name] for name in (PLAIN, FULL)}
    rows = []
    for seed in range(count):
        xs = track(seed)
        result = mo.study(experiment("short", sizes, runs, xs), progress=False)
        medians = np.median(np.sqrt(result.squared_errors("position").mean(axis=2)), axis=1)
        kept = (accuracy(result.squared_errors("position")[place, ~result.lost[place]]).rmse for place in (0, 1))
        more, error = change(result, "position", 1)
        rows.append((seed, nearest(xs), *kept, -more, error, 100 * float(1 - medians[1] / medians[0]), *map(int, result.lost.sum(axis=1))))
    columns = ("track", "nearest, m", "plain", "marginalized", "gain, percent", "s.e.", "of median run", "lost, plain", "lost")
    table = mo.io.Table(columns, tuple(rows))
    table.save(out / "tracks.csv")
    figure = new_figure(5.5, 3.6)
    axes = figure.add_subplot()
    tidy(axes)
    near, gains, errors = (table.column(name) for name in ("nearest, m", "gain, percent", "s.e."))
    axes.errorbar(near, gains, yerr=errors, fmt="o", markersize=4, color=COLORS[0])
    axes.set(xlabel="smallest range of the track, m", ylabel="gain in position RMSE, percent")
    figure.savefig(out / "tracks.png", dpi=150)
    spread = f"median {np.median(gains):.1f} percent, {min(gains):.1f} to {max(gains):.1f}"
    return f"gain of full marginalization: {spread}; 15 or more on {sum(gain >= 15 for gain in gains)} of {count} tracks\n{table}"
