"""A clip that is rendered: a patchwork that moves over clouds, with all that makes it hard to follow.

It goes by its twin, which stands still for the first fifth of the clip, and a grey bar covers it; the light halves; its hue turns; it is
gone for a while and comes back elsewhere. All of it is a function of the number of the picture, so that a clip need never be in memory.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from motes.core import checks

WIDTH, HEIGHT, RATE = 320, 240, Fraction(25)
SIDES = (44, 36)
"""Width and height of the target, pixels."""
PATCHES = 4
"""Squares of the patchwork along a side."""
BARRED = 3
"""Pictures in which a bar covers it."""
LEAST = 10
"""Pictures of the shortest clip."""


@dataclass(frozen=True)
class World:
    """A clip.

    Attributes:
        seed: of colours and ways.
        count: pictures.
        twin: whether there is a twin.
        bar: whether a bar covers the target for three pictures, after 30 of 100.
        light: share of the light that is left after two fifths of the clip.
        turn: by which the hue turns between one and three quarters of the clip, degrees.
        gone: pictures for which the target is out of sight, after 80 of 100; 0 for none.
    """

    seed: int
    count: int = 200
    twin: bool = True
    bar: bool = True
    light: float = 0.5
    turn: float = 120.0
    gone: int = 20

    def __post_init__(self) -> None:
        """Check the length."""
        if self.count < LEAST:
            checks.refuse("frames", f"at least {LEAST} pictures of a clip that is rendered, or 0 for as many as it has", self.count)

    @property
    def hidden(self) -> np.ndarray:
        """Whether the target is gone, `(t,)`."""
        begin = 4 * self.count // 5
        return (np.arange(self.count) >= begin) & (np.arange(self.count) < begin + self.gone)

    @property
    def barred(self) -> np.ndarray:
        """Whether the bar covers the target, `(t,)`."""
        begin = 3 * self.count // 10
        return self.bar & (np.arange(self.count) >= begin) & (np.arange(self.count) < begin + BARRED)

    @property
    def boxes(self) -> np.ndarray:
        """True boxes `(t, 4)`: left, top, width, height; NaN where the target is gone."""
        middle = self._middle()
        boxes = np.concatenate([middle - np.array(SIDES) / 2, np.broadcast_to(np.array(SIDES, float), middle.shape)], axis=1)
        boxes[self.hidden] = np.nan
        return boxes

    def _middle(self) -> np.ndarray:
        """Middle of the target, `(t, 2)`: a smooth way, and after it was gone another one."""
        first, second = np.random.default_rng([self.seed, 1]).uniform(0, 2 * np.pi, (2, 2))
        steps = np.arange(self.count)[:, None]
        back = 4 * self.count // 5 + self.gone
        phase = np.where((steps >= back) & (self.gone > 0), second + np.pi, first) + steps * np.array([0.035, 0.049])
        room = (np.array([WIDTH, HEIGHT]) - np.array(SIDES)) / 2 - 6
        return np.round(np.array([WIDTH, HEIGHT]) / 2 + room * np.sin(phase))

    def pictures(self, begin: int = 0) -> Iterator[np.ndarray]:
        """Give the pictures from a number on, RGB, uint8 `(240, 320, 3)`."""
        generator = np.random.default_rng([self.seed, 2])
        ground = _clouds(generator)
        patches = generator.uniform(0.15, 1.0, (PATCHES, PATCHES, 3)) * np.array([1.0, 0.45, 0.35])
        # the same in all pictures, so that the file in which nothing is lost stays small
        grain = generator.normal(0, 0.01, (HEIGHT, WIDTH, 1))
        rows, columns = (np.arange(side) * PATCHES // side for side in SIDES[::-1])
        middle, hidden = self._middle(), self.hidden
        corners = (middle - np.array(SIDES) / 2).astype(int)
        twin = corners[self.count // 10] + np.array([0, 50 if middle[self.count // 10, 1] < HEIGHT / 2 else -50])
        for number in range(begin, self.count):
            picture = ground.copy()
            _paint(picture, twin, patches[rows][:, columns], self.twin and number < self.count // 5)
            share = np.clip((number - self.count / 4) / (self.count / 2), 0, 1)
            _paint(picture, corners[number], (patches @ _turned(self.turn * share))[rows][:, columns], not hidden[number])
            if self.barred[number]:
                across = int(corners[number, 0])
                picture[:, max(0, across - 5) : across + SIDES[0] + 5] = 0.5
            if number >= 2 * self.count // 5:
                picture *= self.light
            # in place: what is allocated anew for each picture costs more than the sums
            picture += grain
            np.clip(picture, 0, 1, out=picture)
            picture *= 255
            yield picture.astype(np.uint8)


def _clouds(generator: np.random.Generator) -> np.ndarray:
    """Return a ground of soft spots, `(240, 320, 3)`, from 0 to 1."""
    cells = (HEIGHT // 20 + 2, WIDTH // 20 + 2)
    coarse = generator.uniform(0.3, 0.6, cells)[..., None] + generator.uniform(-0.12, 0.12, (*cells, 3))
    y, x = np.arange(HEIGHT) / 20, np.arange(WIDTH) / 20
    row, column = y.astype(int), x.astype(int)
    down, across = (y - row)[:, None, None], (x - column)[None, :, None]
    above, below = (coarse[which][:, column] * (1 - across) + coarse[which][:, column + 1] * across for which in (row, row + 1))
    return above * (1 - down) + below * down


def _paint(picture: np.ndarray, corner: np.ndarray, patches: np.ndarray, there: bool) -> None:
    left, top = np.clip(corner, 0, np.array([WIDTH, HEIGHT]) - SIDES)
    if there:
        picture[top : top + SIDES[1], left : left + SIDES[0]] = patches


def _turned(degrees: float) -> np.ndarray:
    """Return the matrix `(3, 3)` that turns the hue of a row of RGB: a rotation about grey."""
    axis, angle = np.full(3, 3**-0.5), np.radians(degrees)
    cross = np.cross(np.eye(3), axis)
    return np.cos(angle) * np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * np.outer(axis, axis)
