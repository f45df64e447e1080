"""The tracker of clips as an application: `motes demo video` and `motes run video`."""

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from fractions import Fraction
from itertools import islice
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from motes.applications.interface import Job, Score, with_cloud
from motes.applications.video.frames import looked_at
from motes.applications.video.learning import first_memory, learning
from motes.applications.video.model import CUES, Look, followed
from motes.applications.video.search import anywhere
from motes.applications.video.settings import Settings
from motes.applications.video.world import RATE, World
from motes.core import checks, random
from motes.filters.adapting import Adapting
from motes.filters.history import History
from motes.filters.interface import Filter
from motes.filters.particle import ParticleFilter
from motes.filters.recovering import Recovering
from motes.io.bags import is_bag, read_topic_clip
from motes.io.clips import Clip, read_clip, write_clip
from motes.io.result_table import Table
from motes.io.tables import read_table
from motes.resampling.policy import Always

LOST = -0.7
"""Score of the estimate below which the target is lost."""
SMALLEST = 8
"""Sides of the smallest box that can be followed, pixels."""
LOOKED_AT = 60
"""Pixels of the shorter side of the box that are looked at, or twice as many at most."""
SLOW, FAST, MARGIN = 0.02, 0.97, float(np.exp(14))
"""Of `Recovering`: the target is sought anew where the evidence stays 14 nats below what it was for five pictures."""
SPANS = 8
"""Most times of which is told that the target was lost."""
BOX = ("x", "y", "w", "h")
CLIP, TRUTH = "clip.mkv", "truth.csv"


def load(settings: Settings, seed: int) -> "VideoJob":
    """Open the clip that the settings name, or render one, and learn from the first picture.

    Args:
        settings: of the application.
        seed: of a clip that is rendered, and of what is learned.

    Raises:
        FileError: the clip or the file of true boxes cannot be used.
        MotesError: a setting cannot be used.
    """
    for name in ("frame", "frames"):
        if getattr(settings, name) < 0:
            checks.refuse(name, "a whole number of at least 0", getattr(settings, name))
    for cue in settings.cues:
        checks.option("cues", cue, CUES)
    if not settings.cues:
        checks.refuse("cues", f"at least one of {', '.join(CUES)}", "none")
    world = None if settings.data else World(seed, settings.frames or World.count)
    source = world or (read_topic_clip(settings.data, settings.topic) if is_bag(settings.data) else read_clip(settings.data))
    first = next(source.pictures(settings.frame), None)
    if first is None:
        checks.refuse("frame", "the number of a picture that can be decoded", f"{settings.frame}, of {_length(source)}")
    box = _box(settings.box, first) if world is None or settings.box else world.boxes[settings.frame]
    look = Look(float(box[2]), float(box[3]), max(1, int(min(box[2:]) // LOOKED_AT)), settings.cues)
    start = jnp.array([box[0] + box[2] / 2, box[1] + box[3] / 2, 0.0], jnp.result_type(float))
    picture = jax.tree.map(jnp.asarray, next(looked_at([first], look.stride)))
    return VideoJob(
        model=followed(look, start), ys=Pictures(source, settings.frame, settings.frames, look.stride), keep=with_score, look=look,
        memory=first_memory(random.as_key(seed), look, picture, start), learns=settings.learning, size=first.shape[1::-1],
        boxes=_truth(settings, world), filters={"particle": ParticleFilter(n=200, policy=Always())}, counted=("x", "y"),
    )  # fmt: skip


@dataclass(frozen=True)
class Pictures:
    """Measurements of a clip, one after the other; called with a step it begins there.

    Attributes:
        source: where the pictures come from.
        first: number of the picture of step 0.
        count: how many there are at most; 0 for all.
        stride: of the pixels that are looked at.
    """

    source: Clip | World
    first: int
    count: int
    stride: int

    def __call__(self, step: int = 0) -> Iterator[Any]:
        """Give the measurements from a step on; the picture before is looked at for what moved since."""
        before, damaged = min(step, 1), 0
        for one in islice(looked_at(self.shown(step - before), self.stride), before, None):
            if one is None:
                damaged += 1
                continue
            # a clip ends with its last picture that can be decoded
            yield from [None] * damaged
            damaged = 0
            yield one

    def shown(self, step: int = 0) -> Iterator[np.ndarray | None]:
        """Give the pictures from a step on."""
        return islice(self.source.pictures(self.first + step), self.count - step if self.count else None)


def with_score(law: Any) -> dict[str, jax.Array]:
    """Keep mean, covariance, some particles, and the score of the mean."""
    return {**with_cloud(law), "score": law.beside["score"]}


@dataclass(frozen=True, eq=False, kw_only=True)
class VideoJob(Job):
    """A target in a clip.

    Attributes:
        ys: the pictures.
        look: how they are looked at.
        memory: what was learned from the first picture.
        learns: whether more is learned on the way.
        size: width and height of the pictures.
        boxes: true boxes by the number of the picture; empty where none is known.
        below: score of the estimate below which the target is lost.
    """

    ys: Pictures  # type: ignore[reportGeneralTypeIssues]
    look: Look
    memory: dict[str, jax.Array]
    learns: bool
    size: tuple[int, int]
    boxes: Mapping[int, np.ndarray]
    below: float = LOST

    @property
    def rate(self) -> Fraction:
        """Pictures per second."""
        return self.ys.source.rate if isinstance(self.ys.source, Clip) else RATE

    def worn(self, filter: Filter) -> Filter:
        """Return a filter that learns, and seeks the target where it was lost."""
        seeking = Recovering(filter, anywhere(self.look, *self.size), SLOW, FAST, MARGIN)
        return Adapting(seeking, self.memory, learning(self.look, self.learns))

    def about(self) -> str:
        """Tell of clip and box."""
        width, height = self.size
        return (f"{width} x {height} pixels, {float(self.rate):.4g} pictures a second; the target is {self.look.width:g} x "
                f"{self.look.height:g} pixels in picture {self.ys.first}, told by {', '.join(self.look.cues)}.")  # fmt: skip

    def title(self, steps: int) -> str:
        """Return how many pictures there were."""
        return f"{steps} pictures"

    def scores(self, history: History) -> tuple[Score, ...]:
        """Judge a run by the true boxes, where they are known, and by its own score."""
        lost = Score("lost in", float(np.sum(self.is_lost(history))), "pictures", 0)
        found = self.found(history)
        pairs = [(found[step], self.boxes[self.ys.first + step]) for step in range(len(found)) if self.ys.first + step in self.boxes]
        if not pairs:
            return (lost,)
        ours, true = (np.array(part) for part in zip(*pairs, strict=True))
        off = np.hypot(*(ours[:, :2] + ours[:, 2:] / 2 - true[:, :2] - true[:, 2:] / 2).T)
        return (Score("centre off", float(off.mean()), "pixels", 1), Score("overlap", float(overlap(ours, true).mean()), "", 3), lost)

    def found(self, history: History) -> np.ndarray:
        """Return the visible parts of the boxes that were found, `(t, 4)`: left, top, width, height in pixels."""
        means = np.asarray(history.mean)
        corners = self.look.stride * np.asarray(self.look.boxes(jnp.asarray(means.T))).T
        corners = np.clip(corners, 0, np.tile(self.size, 2))
        return np.concatenate([corners[:, :2], corners[:, 2:] - corners[:, :2]], axis=1)

    def score_of(self, history: History) -> np.ndarray:
        """Return the score of each step's estimate, `(t,)`, whatever was kept."""
        return np.asarray(history.kept["score"] if "score" in history.kept else history.law.beside["score"])

    def is_lost(self, history: History) -> np.ndarray:
        """Tell in which pictures the target is lost, `(t,)`: by the score, or because it is sought."""
        return (self.score_of(history) < self.below) | (np.asarray(history.info.recovered) > 0)

    def verdict(self, history: History) -> str:
        """Tell where the target was lost, and whether the clip ended early."""
        edges = np.flatnonzero(np.diff(np.concatenate([[False], self.is_lost(history), [False]]).astype(int))).reshape(-1, 2)
        spans = [f"{self.ys.first + begin} to {self.ys.first + end - 1}" for begin, end in edges]
        shown = f"{', '.join(spans[:SPANS])}{' ...' if len(spans) > SPANS else ''}"
        said = [f"Lost (score below {self.below}, or sought anew) in pictures {shown}." if spans else "Never lost."]
        steps, source = len(np.asarray(history.ess)), self.ys.source
        asked = self.ys.count or (source.count - self.ys.first if isinstance(source, Clip) else steps)
        if steps < asked:
            said.append(f"The clip ended after {steps} of {asked} pictures.")
        return " ".join(said)

    def tables(self, history: History) -> dict[str, Table]:
        """Return the boxes."""
        rows = zip(self.found(history).tolist(), self.score_of(history).tolist(), self.is_lost(history).tolist(), strict=True)
        boxes = Table(("frame", "time", *BOX, "score", "lost"), tuple(
            (self.ys.first + step, float((self.ys.first + step) / self.rate), *(round(side, 2) for side in box), round(score, 4), int(lost))
            for step, (box, score, lost) in enumerate(rows)))  # fmt: skip
        return {"boxes": boxes}

    def pictures(self, histories: Mapping[str, History]) -> dict[str, Any]:
        """Draw a strip of pictures, and the clip with the box and the particles in it."""
        from motes.applications.video.pictures import Followed, strip

        history = next(iter(histories.values()))
        return {"strip.png": strip(history, self), "followed.mp4": Followed(history, self)}

    def written(self, folder: Path, settings: Settings) -> Settings:
        """Write a clip that was rendered, without loss, and its true boxes."""
        world = self.ys.source
        if not isinstance(world, World):
            return settings
        write_clip(str(folder / CLIP), world.pictures(), RATE, exact=True)
        Table(("frame", *BOX), tuple((number, *box) for number, box in self.boxes.items())).save(folder / TRUTH)
        box = ",".join(f"{side:g}" for side in world.boxes[settings.frame])
        return replace(settings, data=str(folder / CLIP), truth=str(folder / TRUTH), box=settings.box or box)


def overlap(ours: np.ndarray, true: np.ndarray) -> np.ndarray:
    """Return the area that boxes `(t, 4)` share over the area of both, `(t,)`."""
    low, high = np.maximum(ours[:, :2], true[:, :2]), np.minimum(ours[:, :2] + ours[:, 2:], true[:, :2] + true[:, 2:])
    shared = np.prod(np.maximum(high - low, 0), axis=1)
    return shared / (np.prod(ours[:, 2:], axis=1) + np.prod(true[:, 2:], axis=1) - shared)


def _length(source: Clip | World) -> str:
    return f"{source.count} pictures" if source.count else "a clip that ends before"


def _box(text: str, picture: np.ndarray) -> np.ndarray:
    """Return left, top, width and height that a user gave."""
    number = r"\s*(-?\d+\.?\d*)\s*"
    given = re.fullmatch(",".join([number] * 4), text)
    if given is None:
        checks.refuse("box", "x,y,w,h in pixels, such as --box 317,132,165,287", repr(text[:80]) if text else "none")
    box, (height, width) = np.array([float(part) for part in given.groups()]), picture.shape[:2]
    if (box[:2] < 0).any() or box[0] + box[2] > width or box[1] + box[3] > height:
        checks.refuse("box", f"one inside of the picture, {width} x {height} pixels", text)
    if (box[2:] < SMALLEST).any():
        checks.refuse("box", f"at least {SMALLEST} pixels wide and high", text)
    return box


def _truth(settings: Settings, world: World | None) -> dict[int, np.ndarray]:
    """Return true boxes by the number of the picture."""
    if settings.truth:
        table = read_table(settings.truth, ("frame", *BOX))
        numbers, rows = table["frame"], np.stack([table[name] for name in BOX], axis=1)
    elif world is not None:
        numbers, rows = np.arange(world.count), world.boxes
    else:
        return {}
    return {int(number): row for number, row in zip(numbers, rows, strict=True) if not np.isnan(row).any() and number == int(number)}
