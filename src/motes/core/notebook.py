"""Bars of progress in a notebook: a few lines of text that are exchanged in place, without widgets and without filling the page."""

import io
import sys
import time
from typing import Any

BETWEEN = 0.5
"""Seconds between two looks."""
WIDTH = 90


def is_here() -> bool:
    """Tell whether a notebook, or something else that shows what Jupyter's kernels send, runs this."""
    shell = getattr(sys.modules.get("IPython"), "get_ipython", lambda: None)()
    return type(shell).__name__ == "ZMQInteractiveShell"


def in_place() -> Any:
    """Return the class of rich's `Progress` whose bars are shown as text, exchanged twice a second at most."""
    from rich.console import Console
    from rich.progress import Progress

    class Bars(Progress):
        def start(self) -> None:
            """Begin to show."""
            self._handle, self._next = _display(""), 0.0
            self._show()

        def stop(self) -> None:
            """Show where it ended, for good; where bars are to vanish, nothing."""
            for task in self.tasks:
                self.stop_task(task.id)
            self._next = 0.0
            self._show(ended=self.live.transient)

        def advance(self, *given: Any, **named: Any) -> None:
            """Get further."""
            super().advance(*given, **named)
            self._show()

        def track(self, sequence: Any, total: float | None = None, completed: int = 0, task_id: Any = None,
                  description: str = "", update_period: float = BETWEEN) -> Any:  # fmt: skip
            """Go through a sequence."""
            task = self.add_task(description, total=total, completed=completed) if task_id is None else task_id
            for item in sequence:
                yield item
                self.advance(task, 1)

        def refresh(self) -> None:
            """Show anew, unless that was just done."""
            self._show()

        def _show(self, ended: bool = False) -> None:
            now = time.monotonic()
            handle = getattr(self, "_handle", None)
            if self.disable or handle is None or now < self._next:
                return
            self._next = now + BETWEEN
            lines = Console(file=io.StringIO(), width=WIDTH, force_jupyter=False, color_system=None)
            if not ended:
                lines.print(self.get_renderable())
            text = lines.file.getvalue().rstrip()  # type: ignore[attr-defined]
            handle.update({"text/plain": text}, raw=True)

    return Bars


def _display(text: str) -> Any:
    from IPython.display import display  # there, because a notebook runs this

    return display({"text/plain": text}, raw=True, display_id=True)
