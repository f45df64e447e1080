"""Figure 3: how well two models of cost predict the time of a step, over all partitions and numbers of particles.

The first is the paper's: equivalent flops by equation 11, with constants and price of a flop that are measured apart. The second is a line
through three times of each partition. Both are judged at numbers of particles that the lines have not seen.
"""

from pathlib import Path

import numpy as np
from clock import in_turns
from printed import flops, own_errors

import motes as mo
from motes.plotting.figures import COLORS, TRUE, new_figure, tidy

FITTED = (1_000, 4_000, 12_000)
JUDGED = (500, 2_000, 7_000, 20_000)
TRIED = (500, 1_000, 2_000)
"""Of a quick run: the first is judged and the others are fitted."""


def measured(partitions: tuple[str, ...], turns: int, quick: bool) -> mo.io.Table:
    """Return measured and predicted microseconds of a step on the engine in force, and which rows are judged."""
    fitted, judged = (TRIED[1:], TRIED[:1]) if quick else (FITTED, JUDGED)
    calibration = mo.costs.calibrate(refresh=not quick)
    times = in_turns([(name, n) for name in partitions for n in (*fitted, *judged)], turns)
    rows = []
    for name in partitions:
        line = mo.costs.StepTime.fitted(tuple((n, times[name, n]) for n in fitted))
        for n in sorted((*fitted, *judged)):
            seconds = times[name, n], line.seconds(n), flops(name, n, calibration.costs) * calibration.flop.value
            rows.append((name, n, *(1e6 * value for value in seconds), "yes" if n in judged else "no"))
    return mo.io.Table(("partition", "N", "measured", "line", "flops", "judged"), tuple(rows))


def lines(table: mo.io.Table) -> mo.io.Table:
    """Return what the line of each partition says: the part of a step that is there without particles, and the price of a particle."""
    rows = []
    for name in dict.fromkeys(table.column("partition")):
        (n, first), *_, (m, last) = ((row[1], row[3]) for row in table.rows if row[0] == name)
        each = (last - first) / (m - n)
        rows.append((name, first - each * n, 1e3 * each))
    return mo.io.Table(("partition", "fixed, us", "ns/particle"), tuple(rows))


def errors(table: mo.io.Table, model: str) -> list[float]:
    """Return the relative errors of a model of cost at the rows that are judged."""
    columns = (table.column(name) for name in (model, "measured", "judged"))
    return [predicted / seconds - 1 for predicted, seconds, judged in zip(*columns, strict=True) if judged == "yes"]


def draw(table: mo.io.Table, path: Path) -> None:
    """Draw a panel for each partition: measured times, the line, the count of flops."""
    partitions = list(dict.fromkeys(table.column("partition")))
    figure = new_figure(9, 3 * len(partitions) / 2)
    for place, name in enumerate(partitions):
        axes = figure.add_subplot(len(partitions) // 2, 2, place + 1)
        tidy(axes)
        rows = [row for row in table.rows if row[0] == name]
        n = [row[1] for row in rows]
        axes.loglog(n, [row[2] for row in rows], color=TRUE, marker="o", markersize=3, label="measured")
        axes.loglog(n, [row[3] for row in rows], "--", color=COLORS[0], label="line")
        axes.loglog(n, [row[4] for row in rows], ":", color=COLORS[1], label="equivalent flops")
        axes.set(title=name, xlabel="particles", ylabel="microseconds a step")
    axes.legend(frameon=False)
    figure.savefig(path, dpi=150)


def reproduce(engine: str, partitions: tuple[str, ...], turns: int, quick: bool, out: Path) -> str:
    """Write times and picture for an engine, and return the summary to print."""
    table = measured(partitions, turns, quick)
    table.save(out / f"figure3_{engine}.csv")
    draw(table, out / f"figure3_{engine}.png")
    cases = {"line": errors(table, "line"), "equivalent flops": errors(table, "flops"), "the paper's own": own_errors()}
    rows = tuple((name, 100 * float(np.median(np.abs(found))), 100 * max(map(abs, found)), len(found)) for name, found in cases.items())
    summary = mo.io.Table(("prediction", "median error, percent", "worst, percent", "points"), rows)
    summary.save(out / f"figure3_{engine}_errors.md")
    each = lines(table)
    each.save(out / f"figure3_{engine}_lines.md")
    return f"figure 3, engine {engine}\n{summary}\n{each}"
