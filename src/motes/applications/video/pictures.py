"""Pictures of a clip in which targets were followed: a strip of some, and all of them as a clip.

Each target has a colour of its own, told apart by those who do not see all colours, too; a box that is lost is dashed.
"""

from typing import Any, NamedTuple

import numpy as np

from motes.applications.video.target import LOST
from motes.core.checks import need
from motes.filters.history import History
from motes.plotting.figures import COLORS, ESTIMATE, INERTIAL, TRUE, new_figure, tidy

SHOWN = 6
"""Pictures of the strip."""
DASH = 6
"""Length of a dash, in widths of the line."""
LIGHT, DARK = (255, 255, 255), (0, 0, 0)


class Followed:
    """The clip with the boxes, the particles and the scores in each picture, drawn when it is written."""

    def __init__(self, history: History, job: Any):
        """Take a run with `cloud` `(t, x, k)` where the filter has particles, and what was run."""
        self.history, self.job = history, job

    def savefig(self, file: Any, format: str = "mp4", dpi: float = 0) -> None:
        """Write the clip, as a matplotlib figure is written.

        Args:
            file: path, or a file open for bytes.
            format: "mp4".
            dpi: of no use here.

        Raises:
            MissingExtraError: PyAV or pillow is not installed.
        """
        from motes.io.clips import write_clip

        write_clip(file, annotated(self.history, self.job), self.job.rate)


class Mark(NamedTuple):
    """What is drawn of a target.

    Attributes:
        boxes: found, `(t, 4)`.
        lost: whether it is lost, `(t,)`.
        cloud: particles `(t, x, k)`, or None.
        texts: one for each step.
        color: of all of it.
    """

    boxes: np.ndarray
    lost: np.ndarray
    cloud: Any
    texts: list[str]
    color: str


def annotated(history: History, job: Any, chosen: Any = None) -> Any:
    """Give pictures with what was found in them, RGB, uint8, one after the other; of all steps, or of those that are chosen."""
    each, steps = job.each(history), len(np.asarray(history.ess))
    marks = [Mark(target.found(own), target.is_lost(own), own.kept.get("cloud"),
                  [f"{f'{target.name}  ' if len(each) > 1 else ''}{score:+.2f}" for score in target.score_of(own)], color)
             for (target, own), color in zip(each, colors(len(each)), strict=True)]  # fmt: skip
    blank = np.zeros((*job.size[::-1], 3), np.uint8)
    for step, picture in zip(range(steps), job.ys.shown(), strict=False):
        if chosen is None or step in chosen:
            yield _marked(blank if picture is None else picture, marks, step, str(job.ys.first + step))


def colors(count: int) -> list[str]:
    """Return the colours of so many targets, those first that show best on pictures."""
    return [COLORS[::-1][number % len(COLORS)] for number in range(count)]


def _marked(picture: np.ndarray, marks: list[Mark], step: int, number: str) -> np.ndarray:
    image = need("PIL.Image", "results").fromarray(np.ascontiguousarray(picture))
    pen, font = need("PIL.ImageDraw", "results").Draw(image), need("PIL.ImageFont", "results")
    thick, size = max(1, round(max(image.size) / 320)), max(10, image.size[1] // 22)
    written = {"font": font.load_default(size), "stroke_width": 1, "stroke_fill": DARK}
    for mark in marks:
        for x, y in [] if mark.cloud is None else np.asarray(mark.cloud[step, :2]).T.tolist():
            pen.rectangle([x - thick / 2, y - thick / 2, x + thick / 2, y + thick / 2], fill=mark.color)
    for mark in marks:
        left, top, width, height = mark.boxes[step].tolist()
        _outline(pen, (left, top, left + width, top + height), mark.color, thick, bool(mark.lost[step]))
        high, text = 1.4 * size, f"{mark.texts[step]}{'  lost' if mark.lost[step] else ''}"
        across = min(max(left, 2), image.size[0] - pen.textlength(text, font=written["font"]) - 2)
        down = min(top - high if top > high else top + thick + 1, image.size[1] - high)
        pen.text((across, down), text, fill=mark.color, **written)
    pen.text((size / 2, size / 3), number, fill=LIGHT, **written)
    return np.asarray(image)


def _outline(pen: Any, corners: tuple[float, ...], color: str, thick: int, dashed: bool) -> None:
    """Draw a box inside of a dark line, so that it shows on any ground; nothing of one that is out of sight."""
    left, top, right, bottom = corners
    if right - left < 1 or bottom - top < 1:
        return
    around = (left - thick, top - thick, right + thick, bottom + thick)
    if not dashed:
        pen.rectangle(around, outline=DARK, width=1)
        pen.rectangle(corners, outline=color, width=thick)
        return
    for x0, y0, x1, y1 in ((left, top, right, top), (left, bottom, right, bottom), (left, top, left, bottom), (right, top, right, bottom)):
        length, dash = max(x1 - x0, y1 - y0), DASH * thick
        for begin in np.arange(0, length, 2 * dash):
            near, far = begin / length, min(1, (begin + dash) / length)
            pen.line([x0 + near * (x1 - x0), y0 + near * (y1 - y0), x0 + far * (x1 - x0), y0 + far * (y1 - y0)], fill=color, width=thick)


def strip(history: History, job: Any) -> Any:
    """Draw some pictures, and under them the score of all.

    Raises:
        MissingExtraError: matplotlib or pillow is not installed.
    """
    steps = len(np.asarray(history.ess))
    chosen = sorted(set(np.linspace(0, steps - 1, SHOWN).round().astype(int).tolist()))
    width, height = job.size
    figure = new_figure(13, 13 / SHOWN * height / width + 2.6)
    grid = figure.add_gridspec(2, len(chosen), height_ratios=[13 / SHOWN * height / width, 2.2])
    for place, picture in enumerate(annotated(history, job, chosen)):
        axes = figure.add_subplot(grid[0, place])
        axes.imshow(picture)
        axes.set_axis_off()
        axes.set_title(f"{job.ys.first + chosen[place]}", fontsize=9)
    axes = figure.add_subplot(grid[1, :])
    tidy(axes)
    numbers = job.ys.first + np.arange(steps)
    axes.axhline(LOST, color=INERTIAL, linewidth=1.0, linestyle="--", label="lost below")
    each = job.each(history)
    for (target, own), color in zip(each, colors(len(each)) if len(each) > 1 else [ESTIMATE], strict=True):
        label = f"target {target.name}" if len(each) > 1 else "score of the estimate"
        axes.plot(numbers, target.score_of(own), color=color, linewidth=1.4, label=label)
    axes.plot(numbers[chosen], np.full(len(chosen), 1.08), "v", color=TRUE, markersize=5, clip_on=False, label="shown above")
    axes.set(ylim=(-1.1, 1.18), xlim=(numbers[0], max(numbers[-1], numbers[0] + 1)), xlabel="picture", ylabel="score")
    axes.legend(loc="lower left", ncols=4, frameon=False, fontsize="small")
    return figure
