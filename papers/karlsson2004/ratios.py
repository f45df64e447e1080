"""Figures 1 and 2: how many more particles the marginalized filter can have at equal cost, by counting."""

from pathlib import Path

from printed import COSTS

import motes as mo
from motes.plotting.figures import COLORS, new_figure, tidy

STATES = range(3, 10)
NONLINEAR = 2

Way = tuple[str, str, str]
"""Title, and how the marginalized and the plain filter are counted."""

FIGURE_1: tuple[Way, ...] = (("equation 11 for both", "nonlinear", "nonlinear"),)
FIGURE_2: tuple[Way, ...] = (
    ("equation 12 for both", "mixed", "mixed"),
    ("equation 12 against equation 11 for the plain filter", "mixed", "nonlinear"),
)


def ratios(ways: tuple[Way, ...]) -> mo.io.Table:
    """Return N(k) / N_PF for all numbers of states m and of marginalized ones k, with the paper's constants.

    With k = 0 both filters are the same one, which cannot be compared with itself where the two are counted differently.
    """
    rows = []
    for m in STATES:
        for k in range(m - NONLINEAR + 1):
            found = (mo.costs.particle_ratio(m - k, k, COSTS, own, plain=plain) if k or own == plain else None for _, own, plain in ways)
            rows.append((m, k, *found))
    return mo.io.Table(("m", "k", *(title for title, *_ in ways)), tuple(rows))


def draw(table: mo.io.Table, path: Path) -> None:
    """Draw a panel for each way of counting, with a curve for each number of states."""
    titles = table.columns[2:]
    figure = new_figure(4.6 * len(titles), 3.6)
    for place, title in enumerate(titles):
        axes = figure.add_subplot(1, len(titles), place + 1)
        tidy(axes)
        axes.axhline(1, color="0.4", linewidth=1)
        for number, m in enumerate(STATES):
            points = [(row[1], row[2 + place]) for row in table.rows if row[0] == m and row[2 + place]]
            line = "-" if number < len(COLORS) else "--"
            axes.plot(*zip(*points, strict=True), line, marker="o", markersize=3, color=COLORS[number % len(COLORS)], label=f"m = {m}")
        axes.set(title=title, xlabel="marginalized states k", ylabel="N(k) / N of the plain filter")
        axes.title.set_fontsize(9)
    axes.legend(frameon=False, fontsize=8)
    figure.savefig(path, dpi=150)


def reproduce(name: str, ways: tuple[Way, ...], out: Path) -> str:
    """Write the numbers and the picture of a figure, and return what to print."""
    table = ratios(ways)
    table.save(out / f"{name}.csv")
    draw(table, out / f"{name}.png")
    told = [row for row in table.rows if row[:2] in ((6, 4), (9, 7))]
    return f"{name}: two of its points\n{mo.io.Table(table.columns, tuple(told))}"
