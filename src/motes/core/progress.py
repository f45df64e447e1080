"""Progress of long work on the error stream, where somebody looks."""

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, TypeVar

if TYPE_CHECKING:
    from rich.console import Console

T = TypeVar("T")


def is_shown(console: "Console", progress: bool | None) -> bool:
    """Tell whether to draw a bar: as was asked, and on a terminal if nothing was."""
    return console.is_terminal if progress is None else progress


def tracked(items: Sequence[T], label: str, progress: bool | None) -> Iterable[T]:
    """Go through items, with a bar.

    Args:
        items: what to go through.
        label: beside the bar.
        progress: whether to draw it; where the error stream is a terminal, if None.
    """
    from rich.console import Console  # here, because every run loads this file, and few need a bar
    from rich.progress import track

    console = Console(stderr=True)
    return track(items, label, console=console, disable=not is_shown(console, progress))
