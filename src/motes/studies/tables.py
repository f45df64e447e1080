"""Tables of a study: how accurate, how sure of it, how consistent, how many lost."""

import csv
import io
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from motes.core import checks
from motes.core.record import record, static
from motes.io.archive import whole_file

Cell = str | int | float | None


@record
class Table:
    """A table of texts and numbers; None is what cannot be had, and shows as a dash.

    Attributes:
        columns: names.
        rows: cells.
    """

    columns: tuple[str, ...] = static()
    rows: tuple[tuple[Cell, ...], ...] = static()

    def column(self, name: str) -> list[Cell]:
        """Return the cells of a column.

        Raises:
            MotesError: there is no such column.
        """
        checks.option("table column", name, self.columns)
        return [row[self.columns.index(name)] for row in self.rows]

    def __str__(self) -> str:
        """Draw the table with characters."""
        from rich.console import Console

        console = Console(file=io.StringIO(), width=200)
        console.print(self)
        return console.file.getvalue().rstrip()  # type: ignore[attr-defined]

    def __rich__(self) -> Any:
        """Give rich's table."""
        from rich import box
        from rich.table import Table as Drawn
        from rich.text import Text

        drawn = Drawn(box=box.SIMPLE_HEAD)
        for place, name in enumerate(self.columns):
            drawn.add_column(Text(name), justify="right" if _is_number(self.rows, place) else "left", no_wrap=True)
        for row in self.rows:
            drawn.add_row(*(Text(shown(cell)) for cell in row))
        return drawn

    def _repr_markdown_(self) -> str:
        return self.to_markdown()

    def to_markdown(self) -> str:
        """Return the table in Markdown."""
        rule = ["---:" if _is_number(self.rows, place) else "---" for place in range(len(self.columns))]
        lines = [map(_markdown, self.columns), rule, *(map(_markdown, map(shown, row)) for row in self.rows)]
        return "".join(f"| {' | '.join(line)} |\n" for line in lines)

    def to_latex(self) -> str:
        """Return a LaTeX tabular environment (with the rules of the package booktabs)."""
        sides = "".join("r" if _is_number(self.rows, place) else "l" for place in range(len(self.columns)))
        lines = [" & ".join(map(_latex, map(shown, row))) + r" \\" for row in self.rows]
        head = " & ".join(map(_latex, self.columns)) + r" \\"
        return "\n".join([rf"\begin{{tabular}}{{{sides}}}", r"\toprule", head, r"\midrule", *lines, r"\bottomrule", r"\end{tabular}", ""])

    def to_csv(self) -> str:
        """Return the table as CSV with all digits; what cannot be had is an empty cell."""
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow(map(_csv, self.columns))
        writer.writerows([_csv(cell) for cell in row] for row in self.rows)
        return text.getvalue()

    def save(self, path: str | Path) -> Path:
        """Write the table as its name ends: .csv, .md or .tex, whole or not at all.

        Raises:
            FileError: the ending is another, or the file cannot be written.
        """
        path = Path(path)
        forms: dict[str, Callable[[], str]] = {".csv": self.to_csv, ".md": self.to_markdown, ".tex": self.to_latex}
        if path.suffix not in forms:
            checks.refuse(str(path), "a name that ends in .csv, .md or .tex", path.suffix or "no ending", error=checks.FileError)
        with whole_file(path) as file:
            file.write(forms[path.suffix]().encode())
        return path


def shown(cell: Cell) -> str:
    """Return a cell as people read it: numbers with four digits, a dash for what cannot be had."""
    if isinstance(cell, str):
        return cell
    if cell is None or math.isnan(cell):
        return "-"
    return str(cell) if isinstance(cell, int) or math.isinf(cell) else f"{cell:#.4g}".rstrip(".")


def _is_number(rows: tuple[tuple[Cell, ...], ...], place: int) -> bool:
    return not any(isinstance(row[place], str) for row in rows)


def _markdown(text: str) -> str:
    return "".join("&lt;" if c == "<" else "&amp;" if c == "&" else f"\\{c}" if c in r"\`*_{}[]|~" else c for c in text)


_LATEX = {c: f"\\{c}" for c in "&%$#_{}"} | {"\\": r"\textbackslash{}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}",
                                            "<": r"\textless{}", ">": r"\textgreater{}"}


def _latex(text: str) -> str:
    return "".join(_LATEX.get(c, c) for c in text)


def _csv(cell: Cell) -> Cell:
    if isinstance(cell, str):
        # spreadsheets run what begins so
        return f"'{cell}" if cell[:1] in ("=", "+", "-", "@") else cell
    return None if cell is None or math.isnan(cell) else cell


COLUMNS = (
    "filter", "block", "RMSE", "s.e.", "median", "kept", "difference", "s.e. of it", "bias", "NEES/dim", "of bound", "lost", "s/step",
)


class Accuracy(NamedTuple):
    """Root mean square error over time and runs, and its Monte Carlo standard error (NaN for fewer than two runs)."""

    rmse: float
    error: float


def accuracy(squared: np.ndarray) -> Accuracy:
    """Return the RMSE as the papers define it: root of the mean over time and runs of the squared 2-norm.

    The standard error is by the delta method over runs, which are independent: that of the mean square, divided by twice the RMSE.

    Args:
        squared: squared errors, `(run, t)`.
    """
    if not squared.shape[0]:
        return Accuracy(math.nan, math.nan)
    return Accuracy(_root(squared), _spread(_influence(squared)))


def difference(squared: np.ndarray, reference: np.ndarray) -> Accuracy:
    """Return by how much one RMSE exceeds another of the same runs, with the standard error of that difference.

    Args:
        squared: squared errors, `(run, t)`.
        reference: those of the filter to compare with, on the same runs.
    """
    if not squared.shape[0]:
        return Accuracy(math.nan, math.nan)
    return Accuracy(_root(squared) - _root(reference), _spread(_influence(squared) - _influence(reference)))


def _root(squared: np.ndarray) -> float:
    return float(np.sqrt(squared.mean()))


def _influence(squared: np.ndarray) -> np.ndarray:
    """Return what each run adds to the RMSE, to first order."""
    rmse = _root(squared)
    return squared.mean(axis=1) / (2 * rmse) if rmse > 0 else np.zeros(squared.shape[0])


def _spread(influence: np.ndarray) -> float:
    return float(influence.std(ddof=1) / np.sqrt(influence.size)) if influence.size > 1 else math.nan


def study_table(result: Any, bound: Any, seconds: dict[str, float] | None) -> Table:
    """Return one row for each filter and block.

    Columns: RMSE (root of the mean over time and runs of the squared 2-norm) with its standard error; RMSE of the median run; difference to
    the first filter on the same runs, with its standard error; bias (2-norm of the error averaged over time and runs); NEES / dim (1 for a
    filter whose covariances are right, infinite where one was certain and wrong); ratio to the bound; lost runs; seconds per step. Where
    runs are lost, "RMSE" and "median" are over all runs, and there is a further column "kept" with the RMSE of those that are not lost;
    difference, bias, NEES and ratio are over runs that are not lost then (by neither of the two, for the difference).

    Args:
        result: the study.
        bound: with `cov` `(t, x, x)`, or None.
        seconds: seconds per step by filter, or None.

    Raises:
        MotesError: the bound has another shape, or a name is unknown.
    """
    for name in seconds or {}:
        checks.option("table seconds", name, result.filters)
    lost = result.lost
    optional = {"kept": lost.any(), "of bound": bound is not None, "s/step": seconds is not None}
    columns = tuple(name for name in COLUMNS if optional.get(name, True))
    rows = []
    for place, filter in enumerate(result.filters):
        for block, _ in result.blocks:
            cells = _cells(result, place, block, lost)
            if bound is not None:
                least = _root(np.square(result.bound_over_time(block, bound)))
                cells["of bound"] = cells["kept"] / least if least > 0 else math.nan
            cells |= {"filter": filter, "block": block, "lost": int(lost[place].sum()), "s/step": (seconds or {}).get(filter)}
            rows.append(tuple(cells[name] for name in columns))
    return Table(columns, tuple(rows))


def _cells(result: Any, place: int, block: str, lost: np.ndarray) -> dict[str, Any]:
    errors, dimension = result.errors(block), len(result.block(block))
    squared = np.square(errors).sum(axis=-1)
    kept, both = ~lost[place], ~(lost[place] | lost[0])
    whole = accuracy(squared[place])
    beyond = difference(squared[place][both], squared[0][both]) if place else Accuracy(math.nan, math.nan)
    names = [name for name, _ in result.blocks]
    nees = result.nees[place, kept, :, names.index(block)].astype(np.float64)
    bias = errors[place][kept].mean(axis=(0, 1)) if kept.any() else np.full(dimension, math.nan)
    return {
        "RMSE": whole.rmse, "s.e.": whole.error, "median": float(np.median(np.sqrt(squared[place].mean(axis=1)))),
        "kept": accuracy(squared[place][kept]).rmse, "difference": beyond.rmse, "s.e. of it": beyond.error,
        "bias": float(np.linalg.norm(bias)), "NEES/dim": float(nees.mean()) / dimension if kept.any() else math.nan,
    }
