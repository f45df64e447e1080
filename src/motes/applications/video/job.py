"""The tracker of clips as an application: `motes demo video` and `motes run video`."""

import re
import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from itertools import islice, tee
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from motes.applications.interface import Job, Moment, Score, with_cloud
from motes.applications.video.frames import looked_at, steps_alone
from motes.applications.video.learning import first_memory
from motes.applications.video.model import CUES, Look, followed
from motes.applications.video.settings import Settings
from motes.applications.video.target import Target
from motes.applications.video.together import apart, together
from motes.applications.video.world import RATE, World
from motes.core import checks, random
from motes.core.record import replace
from motes.filters import notices
from motes.filters.history import History, joined
from motes.filters.interface import Filter
from motes.filters.keep import Keep
from motes.filters.particle import ParticleFilter
from motes.filters.run import run
from motes.io.bags import is_bag, read_topic_clip
from motes.io.clips import Clip, read_clip, write_clip
from motes.io.result_table import Table
from motes.io.tables import read_table
from motes.models.interface import Model
from motes.report.scene import Scene
from motes.resampling.policy import Always

SMALLEST = 8
"""Sides of the smallest box that can be followed, pixels."""
LOOKED_AT = 60
"""Pixels of the shorter side of the box that are looked at, or twice as many at most."""
BOX, FORM = ("x", "y", "w", "h"), "x,y,w,h in pixels, such as --box 317,132,165,287"
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
        checks.natural(name, getattr(settings, name))
    for cue in settings.cues:
        checks.option("cues", cue, CUES)
    if not settings.cues:
        checks.refuse("cues", f"at least one of {', '.join(CUES)}", "none")
    world = None if settings.data else World(seed, settings.frames or World.count)
    source = world or (read_topic_clip(settings.data, settings.topic) if is_bag(settings.data) else read_clip(settings.data))
    first = next(source.pictures(settings.frame), None)
    if first is None:
        checks.refuse("frame", "the number of a picture that can be decoded", f"{settings.frame}, of {_length(source)}")
    boxes = [world.boxes[settings.frame]] if world is not None and not settings.box else _boxes(settings.box, first)
    if np.isnan(boxes).any():
        checks.refuse("frame", "the number of a picture in which the target is to be seen", settings.frame)
    names = [str(number + 1) for number in range(len(boxes))]
    truth = _truth(settings, world, names)
    targets = tuple(_target(settings, seed, name, box, first, truth[name]) for name, box in zip(names, boxes, strict=True))
    strides = tuple(sorted({target.look.stride for target in targets}))
    return VideoJob(
        model=targets[0].model, ys=Pictures(source, settings.frame, settings.frames, strides), keep=with_score, targets=targets,
        filters={"particle": ParticleFilter(n=200, policy=Always())}, counted=("x", "y"),
        blocks={"middle": ("x", "y"), "size": ("log_size",)},
        # a run of a study that ends farther off than the box is long
        lost=("middle", float(np.prod(boxes[0][2:]) ** 0.5)),
    )  # fmt: skip


def _target(settings: Settings, seed: int, name: str, box: np.ndarray, first: np.ndarray, boxes: Mapping[int, np.ndarray]) -> Target:
    """Learn what a target looks like from the first picture."""
    look = Look(max(1, int(min(box[2:]) // LOOKED_AT)), settings.cues)
    kind = jnp.result_type(float)
    start = jnp.array([*(box[:2] + box[2:] / 2), np.log(np.prod(box[2:])) / 2], kind)
    picture = jax.tree.map(jnp.asarray, next(looked_at([first], (look.stride,))))
    memory = first_memory(random.as_key(seed), look, picture, start, jnp.asarray(box[2] / box[3], kind))
    return Target(name=name, model=followed(look, start), box=box, look=look, memory=memory, learns=settings.learning,
                  first=settings.frame, size=first.shape[1::-1], boxes=boxes)  # fmt: skip


@dataclass(frozen=True)
class Pictures:
    """Measurements of a clip, one after the other; called with a step it begins there.

    Attributes:
        source: where the pictures come from.
        first: number of the picture of step 0.
        count: how many there are at most; 0 for all.
        strides: of the pixels that are looked at; see `looked_at`.
    """

    source: Clip | World
    first: int
    count: int
    strides: tuple[int, ...]

    def __call__(self, step: int = 0) -> Iterator[Any]:
        """Give the measurements from a step on; the picture before is looked at for what moved since."""
        before, damaged = min(step, 1), 0
        for one in islice(looked_at(self.shown(step - before), self.strides), before, None):
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
    """One target in a clip, or several, each followed by a filter of its own as it would be alone. The model is that of the first.

    Attributes:
        ys: the pictures.
        targets: the targets.
    """

    ys: Pictures  # type: ignore[reportGeneralTypeIssues]
    targets: tuple[Target, ...]

    @property
    def rate(self) -> Fraction:
        """Pictures per second."""
        return self.ys.source.rate if isinstance(self.ys.source, Clip) else RATE

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the pictures."""
        return self.targets[0].size

    def worn(self, filter: Filter) -> Filter:
        """Return a filter that learns, and seeks the target where it was lost; of the first target."""
        return self.targets[0].worn(filter)

    def piece(self, seed: int, filter: Filter, ys: Any, keep: Keep, after: History | None) -> History:
        """Follow all targets through some pictures.

        One by one: a program of one step needs less memory than one of many while it is compiled and after, and takes no longer.
        """
        found = {}
        for target in self.targets:
            before = end = self.of(target, after)
            worn, parts = target.worn(filter), []
            with warnings.catch_warnings():
                # what is to be said of the piece is not said of each step
                warnings.simplefilter("ignore", checks.MotesWarning)
                for y in steps_alone(ys, target.look.stride):
                    end = run(seed, worn, target.model, y, None, keep, end)
                    parts[-1:] = [replace(one, last=None) for one in parts[-1:]] + [end]
            found[target.name] = joined(parts)
            notices.warn(found[target.name], before)
        if len(found) == 1:
            return found[self.targets[0].name]
        if keep is not self.keep:
            checks.refuse("smoother", "none where several targets are followed", "one")
        values = {str(target.look.stride): found[target.name].last.y.value for target in self.targets}
        return together(found, values if len(values) > 1 else next(iter(values.values())))

    def of(self, target: Target, history: History | None) -> History | None:
        """Return the history of one target."""
        if history is None or len(self.targets) == 1:
            return history
        return apart(history, target.name, target.model.names, target.look.stride)

    def each(self, history: History) -> list[tuple[Target, History]]:
        """Return all targets, each with its history."""
        return [(target, self.of(target, history)) for target in self.targets]  # type: ignore[misc]

    def simulated(self) -> Model:
        """Return a model that draws pictures, made from the first one.

        Raises:
            MotesError: there are several targets.
        """
        from motes.applications.video.cutout import cut_out

        if len(self.targets) > 1:
            checks.refuse("box", "one, to be planned or studied", len(self.targets))
        return cut_out(self.targets[0], next(self.ys.shown()))  # type: ignore[arg-type]

    def length(self) -> int | None:
        """Return how many pictures there are, at most."""
        source = self.ys.source
        return self.ys.count or (source.count - self.ys.first if source.count else None)

    def moments(self) -> Iterator[Moment]:
        """Give the pictures as the first target is looked for in them, and as they are."""
        shown, seen = tee(self.ys.shown())
        for step, (picture, y) in enumerate(zip(shown, looked_at(seen, (self.targets[0].look.stride,)), strict=True)):
            yield Moment(y, None, float((self.ys.first + step) / self.rate), picture)

    def scene(self) -> Scene:
        """Return the picture in pixels with the box of the first target."""
        return self.targets[0].scene()

    def told(self) -> str:
        """Tell what is followed, and how."""
        return repr([(target.box.tolist(), target.look, target.learns) for target in self.targets])

    def about(self) -> str:
        """Tell of clip and boxes."""
        width, height = self.size
        seen = ", ".join(f"{target.box[2]:g} x {target.box[3]:g}" for target in self.targets)
        what = "the target is" if len(self.targets) == 1 else f"the {len(self.targets)} targets are"
        return (f"{width} x {height} pixels, {float(self.rate):.4g} pictures a second; {what} {seen} pixels in picture {self.ys.first}, "
                f"told by {', '.join(self.targets[0].look.cues)}.")  # fmt: skip

    def title(self, steps: int) -> str:
        """Return how many pictures and targets there were."""
        return f"{steps} pictures" if len(self.targets) == 1 else f"{steps} pictures, {len(self.targets)} targets; means over all"

    def scores(self, history: History) -> tuple[Score, ...]:
        """Judge a run by the true boxes, where they are known, and by its own score."""
        each = self.each(history)
        lost = Score("lost in", float(sum(np.sum(target.is_lost(own)) for target, own in each)), "pictures", 0)
        off, shared = np.concatenate([target.errors(own) for target, own in each], axis=1)
        if not off.size:
            return (lost,)
        return (Score("centre off", float(off.mean()), "pixels", 1), Score("overlap", float(shared.mean()), "", 3), lost)

    def verdict(self, history: History) -> str:
        """Tell where each target was lost, and whether the clip ended early."""
        said = [f"{f'Target {target.name}: ' if len(self.targets) > 1 else ''}{target.verdict(own)}" for target, own in self.each(history)]
        steps, source = len(np.asarray(history.ess)), self.ys.source
        asked = self.ys.count or (source.count - self.ys.first if isinstance(source, Clip) else steps)
        if steps < asked:
            said.append(f"The clip ended after {steps} of {asked} pictures.")
        return " ".join(said)

    def stamps(self, history: History) -> tuple[str, list[int]]:
        """Return the number of each picture."""
        return "frame", list(range(self.ys.first, self.ys.first + np.shape(history.info.ess)[0]))

    def tables(self, history: History) -> dict[str, Table]:
        """Return the boxes, picture by picture."""
        rows = zip(*(zip(target.found(own).tolist(), target.score_of(own).tolist(), target.is_lost(own).tolist(), strict=True)
                     for target, own in self.each(history)), strict=True)  # fmt: skip
        boxes = Table(("frame", "time", "target", *BOX, "score", "lost"), tuple(
            (self.ys.first + step, float((self.ys.first + step) / self.rate), target.name, *(round(side, 2) for side in box),
             round(score, 4), int(lost))
            for step, row in enumerate(rows) for target, (box, score, lost) in zip(self.targets, row, strict=True)))  # fmt: skip
        return {"boxes": boxes}

    def pictures(self, histories: Mapping[str, History]) -> dict[str, Any]:
        """Draw a strip of pictures, and the clip with the boxes and the particles in it."""
        from motes.applications.video.pictures import Followed, strip

        history = next(iter(histories.values()))
        return {"strip.png": strip(history, self), "followed.mp4": Followed(history, self)}

    def written(self, folder: Path, settings: Settings) -> Settings:
        """Write a clip that was rendered, without loss, and its true boxes."""
        world = self.ys.source
        if not isinstance(world, World):
            return settings
        write_clip(str(folder / CLIP), world.pictures(), RATE, exact=True)
        true = self.targets[0].boxes.items()
        Table(("frame", *BOX), tuple((number, *box) for number, box in true)).save(folder / TRUTH)
        boxes = tuple(",".join(f"{side:g}" for side in target.box) for target in self.targets)
        return replace(settings, data=str(folder / CLIP), truth=str(folder / TRUTH), box=boxes)


def _length(source: Clip | World) -> str:
    return f"{source.count} pictures" if source.count else "a clip that ends before"


def _boxes(texts: tuple[str, ...], picture: np.ndarray) -> list[np.ndarray]:
    """Return left, top, width and height of each box that a user gave."""
    if not texts:
        checks.refuse("box", FORM, "none")
    return [_box("box" if len(texts) == 1 else f"box {number}", text, picture) for number, text in enumerate(texts, 1)]


def _box(name: str, text: str, picture: np.ndarray) -> np.ndarray:
    number = r"\s*(-?\d+\.?\d*)\s*"
    given = re.fullmatch(",".join([number] * 4), text)
    if given is None:
        checks.refuse(name, FORM, repr(text[:80]))
    box, (height, width) = np.array([float(part) for part in given.groups()]), picture.shape[:2]
    if (box[:2] < 0).any() or box[0] + box[2] > width or box[1] + box[3] > height:
        checks.refuse(name, f"one inside of the picture, {width} x {height} pixels", text)
    if (box[2:] < SMALLEST).any():
        checks.refuse(name, f"at least {SMALLEST} pixels wide and high", text)
    return box


def _truth(settings: Settings, world: World | None, names: Sequence[str]) -> dict[str, dict[int, np.ndarray]]:
    """Return true boxes by the name of the target and the number of the picture; all are of the first where no name is told."""
    table: Any = {}
    if settings.truth:
        table = read_table(settings.truth, ("frame", *BOX), ("target",))
    elif world is not None:
        table = {"frame": np.arange(world.count), **dict(zip(BOX, world.boxes.T, strict=True))}
    found: dict[str, dict[int, np.ndarray]] = {name: {} for name in names}
    if table:
        rows = np.stack([table[name] for name in BOX], axis=1)
        whose = table["target"] if "target" in table else [names[0]] * len(rows)
        called = [str(int(cell)) if isinstance(cell, float) and cell == np.floor(cell) else str(cell) for cell in whose]
        for name, number, row in zip(called, table["frame"], rows, strict=True):
            if name in found and np.isfinite(number) and number == int(number) and not np.isnan(row).any():
                found[name][int(number)] = row
        if not any(found.values()):
            told = ", ".join(sorted(set(called))[:5]) or "none"
            wanted = f"one of {', '.join(names)}, with whole boxes"
            checks.refuse(f"{settings.truth or 'truth'}: target", wanted, told, "", checks.FileError)
    return found
