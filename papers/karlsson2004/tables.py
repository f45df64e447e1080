"""Tables II and III, and how the gain depends on the track."""

from pathlib import Path

import numpy as np
from clock import Matched, in_turns
from printed import FULL, PLAIN, TABLE_II, TABLE_III
from scenario import BLOCKS, experiment, nearest, track

import motes as mo
from motes.plotting.figures import COLORS, new_figure, tidy
from motes.studies.tables import accuracy, difference

FEWEST = 30
"""Particles at which the search of table III begins."""


def table_2(scenario: str, match: Matched, runs: int) -> mo.Table:
    """Return accuracy at equal times: one row for each partition and block."""
    plan = experiment(scenario, match.sizes, runs)
    result = mo.study(plan, progress=False)
    errors = result.table(mo.kalman_at_truth(plan.model, plan.track))
    rows = []
    for row in errors.rows:
        cells = dict(zip(errors.columns, row, strict=True))
        name, block = cells["filter"], cells["block"]
        paper = TABLE_II[name][1 + list(BLOCKS).index(block)]
        plain = cells["RMSE"] - cells["difference"] if name != PLAIN else cells["RMSE"]
        share, error = (100 * (cells[which] / plain) for which in ("difference", "s.e. of it"))
        times = 1e6 * match.seconds[name], match.seconds[name] / match.seconds[PLAIN]
        kept = (cells[which] for which in ("RMSE", "s.e.", "median"))
        rows.append((name, match.sizes[name], *times, block, *kept, share, error, cells["of bound"], cells["lost"], paper))
    columns = ("partition", "N", "us/step", "of plain", "block", "RMSE", "s.e.", "median run", "to plain, percent", "s.e. of it",
               "of Kalman at truth", "lost", "paper")
    return mo.Table(columns, tuple(rows))


def table_3(scenario: str, partitions: tuple[str, ...], runs: int, turns: int, precision: float) -> mo.Table:
    """Return how many particles each partition needs for the velocity RMSE of the plain filter with the paper's number."""
    n = TABLE_III[PLAIN][0]
    plan = experiment(scenario, dict.fromkeys(partitions, n), runs)
    others = [name for name in partitions if name != PLAIN]
    found = {name: mo.particles_for_rmse(plan, name, "velocity", PLAIN, (FEWEST, n), precision) for name in others}
    sizes = {PLAIN: n} | {name: needed.n for name, needed in found.items()}
    result = mo.study(experiment(scenario, sizes, runs), progress=False)
    times = in_turns(sizes.items(), turns)
    rows = []
    for place, (name, size) in enumerate(sizes.items()):
        low, high = (found[name].at_least, found[name].at_most) if name in found else (n, n)
        rmses = (accuracy(result.squared_errors(block)[place]).rmse for block in BLOCKS)
        share = 100 * times[name, size] / times[PLAIN, n]
        rows.append((name, size, low, high, 100 * size / n, *rmses, 1e6 * times[name, size], share, TABLE_III[name][0]))
    columns = ("partition", "N", "above", "below", "of plain, percent", *BLOCKS, "us/step", "time of plain, percent", "paper's N")
    return mo.Table(columns, tuple(rows))


def tracks(match: Matched, runs: int, count: int, out: Path) -> str:
    """Compare full marginalization with the plain filter on many tracks, and return the summary to print."""
    sizes = {name: match.sizes[name] for name in (PLAIN, FULL)}
    rows = []
    for seed in range(count):
        xs = track(seed)
        squared = mo.study(experiment("short", sizes, runs, xs), progress=False).squared_errors("position")
        plain, full = (accuracy(own).rmse for own in squared)
        change = difference(squared[1], squared[0])
        rows.append((seed, nearest(xs), plain, full, -100 * change.rmse / plain, 100 * change.error / plain))
    table = mo.Table(("track", "nearest, m", "plain", "marginalized", "gain, percent", "s.e."), tuple(rows))
    table.save(out / "tracks.csv")
    figure = new_figure(5.5, 3.6)
    axes = figure.add_subplot()
    tidy(axes)
    columns = table.column("nearest, m"), table.column("gain, percent"), table.column("s.e.")
    axes.errorbar(*columns[:2], yerr=columns[2], fmt="o", markersize=4, color=COLORS[0])
    axes.set(xlabel="smallest range of the track, m", ylabel="gain in position RMSE, percent")
    figure.savefig(out / "tracks.png", dpi=150)
    gains = np.array(columns[1])
    spread = f"median {np.median(gains):.1f} percent, {gains.min():.1f} to {gains.max():.1f}"
    return f"gain of full marginalization: {spread}; 15 or more on {np.sum(gains >= 15)} of {gains.size} tracks\n{table}"
