"""A study as one web page: table, errors over time, errors of single runs, and where it all comes from.

The page opens from disk and asks no network for anything. Whatever a user can name is escaped where it stands, and the page forbids every
script but its own two, which it knows by digest.
"""

import base64
import hashlib
import json
import math
import platform
from html import escape
from importlib.resources import files
from pathlib import Path
from string import Template
from typing import Any

import numpy as np

from motes.core import checks
from motes.io.archive import whole_file
from motes.io.result_table import shown
from motes.studies.result import StudyResult

WIDTH, ROW, LEFT, RIGHT = 900, 34, 150, 20
_UNSAFE = {ord(c): f"\\u{ord(c):04x}" for c in "<>&\u2028\u2029"}


def report(
    result: StudyResult, path: str | Path, bound: Any = None, seconds: dict[str, float] | None = None, title: str = "Study"
) -> Path:
    """Write a study as one HTML file with interactive charts.

    Args:
        result: the study.
        path: file to write, ending in .html.
        bound: a bound on the covariance of errors, with `cov` `(t, x, x)`, or None.
        seconds: seconds per step by name of the filter, measured elsewhere, or None.
        title: heading of the page.

    Raises:
        MotesError: the result is none of a study, or bound or seconds do not fit it.
        FileError: the name ends in something else, or the file cannot be written.
    """
    if not isinstance(result, StudyResult):
        checks.refuse("report result", "a StudyResult", type(result).__name__)
    path = Path(path)
    if path.suffix not in (".html", ".htm"):
        checks.refuse(str(path), "a name that ends in .html", path.suffix or "no ending", error=checks.FileError)
    page = _page(result, bound, seconds, title)
    with whole_file(path) as file:
        file.write(page.encode())
    return path


def _page(result: StudyResult, bound: Any, seconds: dict[str, float] | None, title: str) -> str:
    table = result.table(bound, seconds)
    runs, steps = result.truth.shape[:2]
    rule = "" if result.lost_beyond is None else " A run is lost when its final error of {} exceeds {:g}.".format(*result.lost_beyond)
    folder = files("motes.report")
    uplot, charts = ((folder / name).read_text("utf-8").strip() for name in ("uplot/uPlot.iife.min.js", "charts.js"))
    machine = {"seed": str(result.seed), "system": f"{platform.system()} {platform.machine()}"}
    return Template((folder / "page.html").read_text("utf-8")).substitute(
        title=escape(title),
        summary=escape(f"{runs} runs of {steps} steps, the same tracks and measurements for every filter.{rule}"),
        table=_table(table.columns, [[shown(cell) for cell in row] for row in table.rows], 2),
        reading=escape(_READING),
        blocks="\n".join(_block(result, place, name) for place, (name, _) in enumerate(result.blocks)),
        labels=_table(("name", "filter"), list(zip(result.filters, result.labels, strict=True)), 2),
        provenance=_table(("", ""), [(name.replace("_", " "), value) for name, value in (machine | dict(result.provenance)).items()], 2),
        data=_json(_series(result, bound)),
        uplot=uplot, charts=charts, uplot_style=(folder / "uplot/uPlot.min.css").read_text("utf-8"),
        hashes=" ".join(f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'" for text in (uplot, charts)),
    )


_READING = """RMSE: root of the mean over time and runs of the squared 2-norm of the error, with its Monte Carlo standard error.
Median: RMSE of the median run. Difference: to the first filter on the same runs. NEES/dim: 1 for a filter whose covariances are right.
Where runs are lost, RMSE and median are over all runs, and everything else is over those that are not lost."""


def _table(head: Any, rows: Any, texts: int) -> str:
    """Return an HTML table whose first columns are texts."""
    kinds = ["text"] * texts + [""] * (len(head) - texts)
    top = "".join(f'<th class="{kind}">{escape(name)}</th>' for kind, name in zip(kinds, head, strict=True))
    body = "".join(
        "<tr>" + "".join(f'<td class="{kind}{" long" if len(cell) > 60 else ""}">{escape(cell)}</td>'
                         for kind, cell in zip(kinds, row, strict=True)) + "</tr>\n" for row in rows)
    return f"<table><thead><tr>{top}</tr></thead><tbody>\n{body}</tbody></table>"


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
        lines = {"name": name, "filters": [_for_json(line) for line in result.rmse_over_time(name)]}
        if bound is not None:
            lines["bound"] = _for_json(result.bound_over_time(name, bound))
        blocks.append(lines)
    return {"names": list(result.filters), "steps": list(range(result.truth.shape[1])), "blocks": blocks}


def _for_json(values: np.ndarray) -> list[float | None]:
    return [float(f"{value:.5g}") if math.isfinite(value) else None for value in values]


def _json(value: Any) -> str:
    """Return JSON that may stand inside a script element: nothing in it can end the element or open another."""
    return json.dumps(value, ensure_ascii=False, allow_nan=False).translate(_UNSAFE)
