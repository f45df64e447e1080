"""What is seen of a law on a page: coordinates, what stands behind them, and what is known to be true."""

import io
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

import numpy as np

from motes.core.checks import need, refuse

MOST_PIXELS = 1200
"""Longer side of a picture that is sent to a page."""


class Marks(NamedTuple):
    """Places that stay.

    Attributes:
        label: what they are, such as "beacon".
        places: along the first two coordinates, `(m, 2)`.
        shape: how they are drawn.
    """

    label: str
    places: np.ndarray
    shape: Literal["triangle", "cross", "line"] = "triangle"


class Moving(NamedTuple):
    """Places that the law itself knows, such as landmarks.

    Attributes:
        label: what they are.
        of: gives them, of a law, along the first two coordinates, `(m, 2)`; traced by JAX.
        shape: how they are drawn; a "line" goes through them and back to the first.
    """

    label: str
    of: Callable[[Any], Any]
    shape: Literal["triangle", "cross", "line"] = "cross"


@dataclass(frozen=True, eq=False, kw_only=True)
class Scene:
    """Coordinates in which a law is drawn, and what is drawn with it.

    Attributes:
        names: of the coordinates; the first two, or the only one, are what is drawn unless others are chosen.
        units: of the coordinates; "" where there is none.
        place: takes points `(x, n)`, the inputs of the step and its number, and gives coordinates `(k, n)`; the states if None.
        extent: left, right, bottom, top of what the first two coordinates show; None to follow the law. A bottom above the top turns the
            picture over, as coordinates of pictures ask.
        picture: behind them, uint8 `(height, width, 3)`, top row first; it fills the extent.
        marks: places that stay.
        moving: places that the law knows, or None.
        truth: true coordinates `(t, k)`, NaN where they are not known; None where none are.
        angles: coordinates that are angles in radians.
        judged: coordinates, of one unit, whose distance from the truth is the error.
        title: what is shown.
    """

    names: tuple[str, ...]
    units: tuple[str, ...] = ()
    place: Callable[[np.ndarray, Any, int], np.ndarray] | None = None
    extent: tuple[float, float, float, float] | None = None
    picture: np.ndarray | None = None
    marks: tuple[Marks, ...] = ()
    moving: Moving | None = None
    truth: np.ndarray | None = None
    angles: tuple[int, ...] = ()
    judged: tuple[int, ...] = (0, 1)
    title: str = ""

    def __post_init__(self) -> None:
        """Refuse what does not fit together."""
        if not self.names:
            refuse("scene names", "at least one coordinate", "none")
        if self.truth is not None and np.shape(self.truth)[1:] != (len(self.names),):
            refuse("scene truth", f"(steps, {len(self.names)}), as there are names", f"shape {np.shape(self.truth)}")

    def described(self) -> dict[str, Any]:
        """Return what a page is told of it, for JSON: all but pictures."""
        units = [*self.units, *[""] * len(self.names)][: len(self.names)]
        marks = [{"label": one.label, "shape": one.shape, "places": np.round(np.asarray(one.places, np.float64), 4).tolist()}
                 for one in self.marks]  # fmt: skip
        extent = None if self.extent is None else [float(side) for side in self.extent]
        return {"names": list(self.names), "units": units, "extent": extent, "marks": marks, "title": self.title,
                "moving": None if self.moving is None else {"label": self.moving.label, "shape": self.moving.shape},
                "judged": [self.names[place] for place in self.judged if place < len(self.names)],
                "picture": self.picture is not None, "truth": self.truth is not None}  # fmt: skip


def scene_of(names: tuple[str, ...], truth: Any = None, circular: tuple[int, ...] = ()) -> Scene:
    """Return the scene of states that stand for themselves: the first two on a plane, or the only one over time.

    Args:
        names: of the states.
        truth: true states `(t, x)`, or None.
        circular: states that are angles.
    """
    truth = None if truth is None else np.asarray(truth, np.float64)
    return Scene(names=names, truth=truth, angles=circular, judged=tuple(range(min(2, len(names)))))


def encoded(picture: np.ndarray, kind: str) -> bytes:
    """Return a picture `(height, width, 3)` as "JPEG" or "PNG", made smaller where it is very large.

    Raises:
        MissingExtraError: pillow is not installed.
    """
    image = need("PIL.Image", "results").fromarray(np.asarray(picture, np.uint8))
    image.thumbnail((MOST_PIXELS, MOST_PIXELS))
    file = io.BytesIO()
    image.save(file, kind, quality=80)
    return file.getvalue()
