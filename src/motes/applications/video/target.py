"""One target of a clip: what is known of it, and what a run says of it."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from motes.applications.video.learning import learning
from motes.applications.video.model import Look, sides
from motes.applications.video.search import anywhere
from motes.filters.adapting import Adapting
from motes.filters.history import History
from motes.filters.interface import Filter
from motes.filters.recovering import Recovering
from motes.models.state_space import StateSpaceModel
from motes.report.scene import Moving, Scene

LOST = -0.7
"""Score of the estimate below which the target is lost."""
SLOW, FAST, MARGIN = 0.02, 0.97, float(np.exp(14))
"""Of `Recovering`: the target is sought anew where the evidence stays 14 nats below what it was for five pictures."""
SPANS = 8
"""Most times of which is told that the target was lost."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Target:
    """A target in a clip.

    Attributes:
        name: by which tables and pictures tell it from others.
        model: of its box.
        box: left, top, width and height when it is first seen, pixels.
        look: how it is looked at.
        memory: what was learned from the first picture.
        learns: whether more is learned on the way.
        first: number of the picture in which it is first seen.
        size: width and height of the pictures.
        boxes: true boxes by the number of the picture; empty where none is known.
    """

    name: str
    model: StateSpaceModel
    box: np.ndarray
    look: Look
    memory: dict[str, jax.Array]
    learns: bool
    first: int
    size: tuple[int, int]
    boxes: Mapping[int, np.ndarray]

    def worn(self, filter: Filter) -> Filter:
        """Return a filter that learns, and seeks the target where it was lost."""
        seeking = Recovering(filter, anywhere(self.look, *self.size), SLOW, FAST, MARGIN)
        return Adapting(seeking, self.memory, learning(self.look, self.learns))

    def found(self, history: History) -> np.ndarray:
        """Return the visible parts of the boxes that were found, `(t, 4)`: left, top, width, height in pixels."""
        means = jnp.asarray(history.mean).T
        reach = sides(means[2], self.memory) / 2
        corners = np.clip(np.asarray(jnp.concatenate([means[:2] - reach, means[:2] + reach]).T), 0, np.tile(self.size, 2))
        return np.concatenate([corners[:, :2], corners[:, 2:] - corners[:, :2]], axis=1)

    def score_of(self, history: History) -> np.ndarray:
        """Return the score of each step's estimate, `(t,)`, whatever was kept."""
        return np.asarray(history.kept["score"] if "score" in history.kept else history.law.beside["score"])

    def is_lost(self, history: History) -> np.ndarray:
        """Tell in which pictures the target is lost, `(t,)`: by the score, or because it is sought."""
        return (self.score_of(history) < LOST) | (np.asarray(history.info.recovered) > 0)

    def errors(self, history: History) -> np.ndarray:
        """Return by how much the middle is off, pixels, and the overlap in the pictures of which the true box is known, `(2, t)`."""
        found = self.found(history)
        pairs = [(found[step], self.boxes[self.first + step]) for step in range(len(found)) if self.first + step in self.boxes]
        if not pairs:
            return np.zeros((2, 0))
        ours, true = (np.array(part) for part in zip(*pairs, strict=True))
        off = np.hypot(*(ours[:, :2] + ours[:, 2:] / 2 - true[:, :2] - true[:, 2:] / 2).T)
        return np.stack([off, overlap(ours, true)])

    def scene(self) -> Scene:
        """Return the picture in pixels, rows downward, with the box."""
        width, height = self.size
        names, last = tuple(self.model.names), max(self.boxes, default=-1) - self.first
        truth = np.full((max(last, -1) + 1, len(names)), np.nan)
        for number, box in self.boxes.items():
            if number >= self.first:
                truth[number - self.first, :2] = box[:2] + box[2:] / 2
        return Scene(names=names, units=("pixels", "pixels"), extent=(0, width, height, 0), title="Video",
                     truth=truth if len(truth) else None, moving=Moving("box", _corners, "line"))  # fmt: skip

    def verdict(self, history: History) -> str:
        """Tell where the target was lost."""
        edges = np.flatnonzero(np.diff(np.concatenate([[False], self.is_lost(history), [False]]).astype(int))).reshape(-1, 2)
        spans = [f"{self.first + begin} to {self.first + end - 1}" for begin, end in edges]
        shown = f"{', '.join(spans[:SPANS])}{' ...' if len(spans) > SPANS else ''}"
        return f"Lost (score below {LOST}, or sought anew) in pictures {shown}." if spans else "Never lost."


def _corners(law: Any) -> jax.Array:
    """Return the corners `(4, 2)` of the box of a law that carries the memory of the target."""
    mean = law.mean()
    reach = sides(mean[2], law.beside) / 2
    return mean[:2] + reach * jnp.array([[-1, -1], [1, -1], [1, 1], [-1, 1]], mean.dtype)


def overlap(ours: np.ndarray, true: np.ndarray) -> np.ndarray:
    """Return the area that boxes `(t, 4)` share over the area of both, `(t,)`."""
    low, high = np.maximum(ours[:, :2], true[:, :2]), np.minimum(ours[:, :2] + ours[:, 2:], true[:, :2] + true[:, 2:])
    shared = np.prod(np.maximum(high - low, 0), axis=1)
    return shared / (np.prod(ours[:, 2:], axis=1) + np.prod(true[:, 2:], axis=1) - shared)
