"""A study as one web page: table, errors over time, errors of single runs, and where it all comes from; or a run (`run.py`).

The page opens from disk and asks no network for anything. Whatever a user can name is escaped where it stands, and the page forbids every
script but its own two, which it knows by digest.
"""

import math
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from motes.core import checks
from motes.filters.history import History
from motes.io.archive import whole_file
from motes.report.parts import filled, html_table, origin_table, rounded
from motes.report.run import film_of, run_page
from motes.report.scene import Scene
from motes.studies.result import StudyResult

WIDTH, ROW, LEFT, RIGHT = 900, 34, 150, 20


def report(
    result: StudyResult | History, path: str | Path, bound: Any = None, seconds: dict[str, float] | None = None, title: str = "",
    *, truth: Any = None, scene: Scene | None = None,
) -> Path:  # fmt: skip
    """Write a study, or a run, as one HTML file with interactive charts, and of a run pictures of its law.

    Args:
        result: the study; or the history of a run that kept moments, whose particles are drawn with `keep=mo.keep.laws`.
        path: file to write, ending in .html.
        bound: of a study: a bound on the covariance of errors, with `cov` `(t, x, x)`, or None.
        seconds: of a study: seconds per step by name of the filter, measured elsewhere, or None.
        title: heading of the page; "Study" or "Run" if empty.
        truth: of a run: true states `(t, x)`, or None.
        scene: of a run: where its law is drawn; its first two states if not given.

    Raises:
        MotesError: the result is neither, or what is given beside it does not fit it.
        FileError: the name ends in something else, or the file cannot be written.
    """
    if not isinstance(result, (StudyResult, History)):
        checks.refuse("report result", "a StudyResult or a History", type(result).__name__)
    beside = {"bound": bound, "seconds": seconds} if isinstance(result, History) else {"truth": truth, "scene": scene}
    for name, value in beside.items():
        if value is not None:
            checks.refuse(f"report {name}", f"none beside a {type(result).__name__}", type(value).__name__)
    path = Path(path)
    if path.suffix not in (".html", ".htm"):
        checks.refuse(str(path), "a name that ends in .html", path.suffix or "no ending", error=checks.FileError)
    if isinstance(result, History):
        page = run_page(film_of(result, scene, truth, title or "Run"))
    else:
        page = _page(result, bound, seconds, title or "Study")
    with whole_file(path) as file:
        file.write(page.encode())
    return path


def _page(result: StudyResult, bound: Any, seconds: dict[str, float] | None, title: str) -> str:
    told = result.table(bound, seconds)
    runs, steps = result.truth.shape[:2]
    rule = "" if result.lost_beyond is None else " A run is lost when its final error of {} exceeds {:g}.".format(*result.lost_beyond)
    return filled(
        "study", ("uplot/uPlot.iife.min.js", "charts.js"), ("uplot/uPlot.min.css",), title=title, data=_series(result, bound),
        summary=escape(f"{runs} runs of {steps} steps, the same tracks and measurements for every filter.{rule}"),
        table=html_table(told.columns, told.texts(), 2),
        reading=escape(_READING),
        blocks="\n".join(_block(result, place, name) for place, (name, _) in enumerate(result.blocks)),
        labels=html_table(("name", "filter"), list(zip(result.filters, result.labels, strict=True)), 2),
        provenance=origin_table(dict(result.provenance), seed=str(result.seed)),
    )  # fmt: skip


_READING = """RMSE: root of the mean over time and runs of the squared 2-norm of the error, with its Monte Carlo standard error.
Median: RMSE of the median run. Difference: to the first filter on the same runs. NEES/dim: 1 for a filter whose covariances are right.
Where runs are lost, RMSE and median are over all runs, and everything else is over those that are not lost."""


def _block(result: StudyResult, place: int, name: str) -> str:
    return (f'<section data-block="{place}">\n<h2>{escape(name)}</h2>\n<label><input type="checkbox"> logarithmic</label>\n'
            f'<div class="chart"></div>\n<p class="note">RMSE of single runs; a cross is a lost run. Drag over the chart to look closer, '
            f'double-click to see all; a click on a name hides a line.</p>\n<div class="wide">{_strip(result, name)}</div>\n</section>')


def _strip(result: StudyResult, block: str) -> str:
    """Draw the RMSE of each run, one row per filter, on a logarithmic axis, as SVG."""
    errors = np.sqrt(result.squared_errors(block).mean(axis=2))
    lost = result.lost
    usable = errors[np.isfinite(errors) & (errors > 0)]
    low, high = (math.log10(usable.min()), math.log10(usable.max())) if usable.size else (0.0, 1.0)
    low, high = low - 0.02, max(high, low + 0.1) + 0.02
    ticks = [tick for power in range(math.floor(low), math.ceil(high) + 1) for tick in np.array([1, 2, 3, 5, 7]) * 10.0**power]

    def across(value: float) -> float:
        return LEFT + (math.log10(value) - low) / (high - low) * (WIDTH - LEFT - RIGHT)

    height = ROW * len(result.filters) + 24
    parts = [f'<svg width="{WIDTH}" height="{height}" role="img" aria-label="{escape(f"RMSE of {block} of each run")}">']
    for tick in ticks:
        if low <= math.log10(tick) <= high:
            x = across(tick)
            parts.append(f'<line x1="{x:.1f}" x2="{x:.1f}" y1="0" y2="{height - 20}" stroke="#ddd"/>'
                         f'<text x="{x:.1f}" y="{height - 6}" text-anchor="middle">{tick:g}</text>')
    for place, filter in enumerate(result.filters):
        middle = ROW * (place + 0.5)
        parts.append(f'<text x="0" y="{middle + 4:.0f}">{escape(filter if len(filter) < 22 else filter[:20] + "...")}</text>')
        for run, value in enumerate(errors[place]):
            if math.isfinite(value) and value > 0:
                title = f"<title>run {run}: {value:.4g}</title>"
                parts.append(_mark(across(value), middle + (run % 7 - 3) * 3, bool(lost[place, run]), title))
    return "".join([*parts, "</svg>"])


def _mark(x: float, y: float, lost: bool, title: str) -> str:
    if lost:
        return f'<path d="M-3-3L3 3M-3 3L3-3" transform="translate({x:.1f} {y:.0f})" stroke="#d55e00">{title}</path>'
    return f'<circle cx="{x:.1f}" cy="{y:.0f}" r="2.5" fill="#0072b2" fill-opacity="0.5">{title}</circle>'


def _series(result: StudyResult, bound: Any) -> dict[str, Any]:
    blocks = []
    for name, _ in result.blocks:
        lines = {"name": name, "filters": [[rounded(value, 5) for value in line] for line in result.rmse_over_time(name)]}
        if bound is not None:
            lines["bound"] = [rounded(value, 5) for value in result.bound_over_time(name, bound)]
        blocks.append(lines)
    return {"names": list(result.filters), "steps": list(range(result.truth.shape[1])), "blocks": blocks}
