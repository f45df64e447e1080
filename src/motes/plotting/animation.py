"""Moving pictures: figures drawn one after the other and written as an animated GIF, which every browser shows."""

import io
from collections.abc import Callable
from typing import Any

import numpy as np

from motes.core.checks import need
from motes.core.progress import tracked

COLORS = 64
"""Colors of a picture; more make the file larger than they make it better."""

BEGINNING = 1.5
"""The power by which moments are denser at the beginning, where estimates change most."""


def moments(steps: int, most: int) -> np.ndarray:
    """Return the steps that are shown of so many: the first, the last, and at most so many in all, more of the beginning."""
    return np.unique(np.round((steps - 1) * np.linspace(0, 1, most) ** BEGINNING).astype(int))


class Animation:
    """Pictures that are drawn when they are written."""

    def __init__(self, draw: Callable[[int], Any], count: int, seconds: float = 0.15):
        """Take what draws them.

        Args:
            draw: returns the matplotlib figure of a number, 0 to count - 1; all are of one size.
            count: how many there are.
            seconds: for which each is shown.
        """
        self.draw, self.count, self.seconds = draw, count, seconds

    def savefig(self, file: Any, format: str = "gif", dpi: float = 72) -> None:
        """Write all pictures, as a matplotlib figure is written.

        Args:
            file: path, or a file open for bytes.
            format: "gif".
            dpi: dots of an inch.

        Raises:
            MissingExtraError: matplotlib or pillow is not installed.
        """
        image = need("PIL.Image", "results")
        shown = []
        for number in tracked(range(self.count), "animation", None):
            png = io.BytesIO()
            self.draw(number).savefig(png, format="png", dpi=dpi)
            shown.append(image.open(png).convert("RGB").quantize(COLORS))
        # the last picture stands for a while before it begins again
        times = [int(1000 * self.seconds)] * (self.count - 1) + [2000]
        shown[0].save(file, format=format, save_all=True, append_images=shown[1:], duration=times, loop=0)
