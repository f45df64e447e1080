"""Pictures of a clip in which a target was followed: a strip of some, and all of them as a clip."""

from typing import Any

import numpy as np

from motes.core.checks import need
from motes.filters.history import History
from motes.plotting.figures import ESTIMATE, INERTIAL, TRUE, new_figure, tidy

SHOWN = 6
"""Pictures of the strip."""
FOUND, LOST, PARTICLE, TEXT = (0, 200, 255), (255, 80, 0), (255, 220, 0), (255, 255, 255)


class Followed:
    """The clip with the box, the particles and the score in each picture, drawn when it is written."""

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


def annotated(history: History, job: Any, chosen: Any = None) -> Any:
    """Give pictures with what was found in them, RGB, uint8, one after the other; of all steps, or of those that are chosen."""
    steps, boxes, lost = len(np.asarray(history.ess)), job.found(history), job.is_lost(history)
    score, cloud = job.score_of(history), history.kept.get("cloud")
    blank = np.zeros((*job.size[::-1], 3), np.uint8)
    for step, picture in zip(range(steps), job.ys.shown(), strict=False):
        if chosen is None or step in chosen:
            points = None if cloud is None else np.asarray(cloud[step, :2]).T
            text = f"{job.ys.first + step}   {score[step]:+.2f}"
            yield _marked(blank if picture is None else picture, boxes[step], points, lost[step], text)


def _marked(picture: np.ndarray, box: np.ndarray, points: np.ndarray | None, lost: bool, text: str) -> np.ndarray:
    image = need("PIL.Image", "results").fromarray(np.ascontiguousarray(picture))
    pen, font = need("PIL.ImageDraw", "results").Draw(image), need("PIL.ImageFont", "results")
    thick = max(1, round(max(image.size) / 320))
    for x, y in [] if points is None else points.tolist():
        pen.rectangle([x - thick / 2, y - thick / 2, x + thick / 2, y + thick / 2], fill=PARTICLE)
    color = LOST if lost else FOUND
    if min(box[2:]) >= 1:
        pen.rectangle([*box[:2], *(box[:2] + box[2:])], outline=color, width=thick)
    size = max(10, image.size[1] // 22)
    pen.text((size / 2, size / 3), f"{text}{'   lost' if lost else ''}", fill=color if lost else TEXT, font=font.load_default(size),
             stroke_width=1, stroke_fill=(0, 0, 0))  # fmt: skip
    return np.asarray(image)


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
    axes.axhline(job.below, color=INERTIAL, linewidth=1.0, linestyle="--", label="lost below")
    axes.plot(numbers, job.score_of(history), color=ESTIMATE, linewidth=1.4, label="score of the estimate")
    axes.plot(numbers[chosen], np.full(len(chosen), 1.08), "v", color=TRUE, markersize=5, clip_on=False, label="shown above")
    axes.set(ylim=(-1.1, 1.18), xlim=(numbers[0], max(numbers[-1], numbers[0] + 1)), xlabel="picture", ylabel="score")
    axes.legend(loc="lower left", ncols=3, frameon=False, fontsize="small")
    return figure
