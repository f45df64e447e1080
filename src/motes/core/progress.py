"""Progress of long work on the error stream, where somebody looks: how much is done, for how long, and how long it will take."""

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, TypeVar

from motes.core import notebook

if TYPE_CHECKING:
    from rich.console import Console
    from rich.progress import Progress

T = TypeVar("T")
WINDOW = 600.0
"""Seconds over which speed is averaged: pieces of long work come minutes apart."""


def is_shown(console: "Console", progress: bool | None) -> bool:
    """Tell whether to draw a bar: as was asked, and on a terminal if nothing was."""
    return console.is_terminal or notebook.is_here() if progress is None else progress


def bars(unit: str, progress: bool | None = None, passing: bool = False) -> "Progress":
    """Return bars of work, to be entered with `with`: what is done of each, the time that it took, and the time that is left.

    Args:
        unit: what is counted, such as "steps".
        progress: whether to draw them; where the error stream is a terminal, or in a notebook, if None.
        passing: whether they vanish at the end.
    """
    from rich.console import Console  # here, because every run loads this file, and few need a bar
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

    console = Console(stderr=True)
    columns = (TextColumn("{task.description:<14}"), BarColumn(), MofNCompleteColumn(), TextColumn(unit), TimeElapsedColumn(),
               TextColumn("left"), TimeRemainingColumn())  # fmt: skip
    kind = notebook.in_place() if notebook.is_here() else Progress
    return kind(*columns, console=console, disable=not is_shown(console, progress), transient=passing, speed_estimate_period=WINDOW)


def tracked(items: Sequence[T], label: str, progress: bool | None) -> Iterator[T]:
    """Go through items, with a bar.

    Args:
        items: what to go through.
        label: beside the bar.
        progress: whether to draw it; where the error stream is a terminal, if None.
    """
    with bars("", progress) as drawn:
        yield from drawn.track(items, total=len(items), description=label)
