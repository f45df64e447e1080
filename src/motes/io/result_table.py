"""Tables of results, for people and for files."""

import csv
import io
import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from motes.core import checks, markdown
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

        # in a notebook rich would show the table instead of writing it
        console = Console(file=io.StringIO(), width=200, force_jupyter=False, color_system=None)
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
        for row in self.texts():
            drawn.add_row(*map(Text, row))
        return drawn

    def texts(self) -> list[list[str]]:
        """Return the cells of each row as people see them."""
        return [[shown(cell) for cell in row] for row in self.rows]

    def _repr_markdown_(self) -> str:
        return self.to_markdown()

    def to_markdown(self) -> str:
        """Return the table in Markdown."""
        numbers = [_is_number(self.rows, place) for place in range(len(self.columns))]
        return markdown.table(self.columns, self.texts(), numbers)

    def to_latex(self) -> str:
        """Return a LaTeX tabular environment (with the rules of the package booktabs)."""
        sides = "".join("r" if _is_number(self.rows, place) else "l" for place in range(len(self.columns)))
        lines = [" & ".join(map(_latex, map(shown, row))) + r" \\" for row in self.rows]
        head = " & ".join(map(_latex, self.columns)) + r" \\"
        return "\n".join([rf"\begin{{tabular}}{{{sides}}}", r"\toprule", head, r"\midrule", *lines, r"\bottomrule", r"\end{tabular}", ""])

    def to_csv(self, decimal: str = ".") -> str:
        """Return the table as CSV with all digits; what cannot be had is an empty cell.

        Args:
            decimal: mark of decimals, "." or ","; with the latter columns are parted by semicolons.

        Raises:
            MotesError: the mark is another.
        """
        checks.option("table decimal", decimal, (".", ","))
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n", delimiter=";" if decimal == "," else ",")
        writer.writerow(_csv(name, decimal) for name in self.columns)
        writer.writerows([_csv(cell, decimal) for cell in row] for row in self.rows)
        return text.getvalue()

    def save(self, path: str | Path, decimal: str = ".") -> Path:
        """Write the table as its name ends: .csv, .md or .tex, whole or not at all.

        Args:
            path: of the file.
            decimal: mark of decimals in CSV; see `to_csv`.

        Raises:
            FileError: the ending is another, or the file cannot be written.
        """
        path = Path(path)
        forms: dict[str, Callable[[], str]] = {".csv": lambda: self.to_csv(decimal), ".md": self.to_markdown, ".tex": self.to_latex}
        if path.suffix not in forms:
            checks.refuse(str(path), "a name that ends in .csv, .md or .tex", path.suffix or "no ending", error=checks.FileError)
        with whole_file(path) as file:
            file.write(forms[path.suffix]().encode())
        return path


def track_table(
    times: tuple[str, Sequence[Cell]], places: Mapping[str, Any], spreads: Mapping[str, Any], flags: Sequence[str]
) -> Table:
    """Return the way that a run found: a row for each step with its time, places, their standard deviations and what is to be said of it.

    Args:
        times: name of their column, and the time of each step.
        places: numbers `(t,)` by the name of their column.
        spreads: standard deviations `(t,)` by what they are of.
        flags: of each step, in words; "" for none.
    """
    numbers = {**places, **{f"sd {name}": spread for name, spread in spreads.items()}}
    columns = [[float(value) for value in column] for column in numbers.values()]
    return Table((times[0], *numbers, "flags"), tuple(zip(times[1], *columns, flags, strict=True)))


def shown(cell: Cell) -> str:
    """Return a cell as people read it: numbers with four digits, a dash for what cannot be had."""
    if isinstance(cell, str):
        return cell
    if cell is None or math.isnan(cell):
        return "-"
    return str(cell) if isinstance(cell, int) or math.isinf(cell) else f"{cell:#.4g}".rstrip(".")


def _is_number(rows: tuple[tuple[Cell, ...], ...], place: int) -> bool:
    return not any(isinstance(row[place], str) for row in rows)


_LATEX = {c: f"\\{c}" for c in "&%$#_{}"} | {"\\": r"\textbackslash{}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}",
                                            "<": r"\textless{}", ">": r"\textgreater{}"}


def _latex(text: str) -> str:
    return "".join(_LATEX.get(c, c) for c in text)


def _csv(cell: Cell, decimal: str) -> str | None:
    if isinstance(cell, str):
        # spreadsheets run what begins so
        return f"'{cell}" if cell[:1] in ("=", "+", "-", "@") else cell
    if cell is None or math.isnan(cell):
        return None
    return str(cell).replace(".", decimal)
