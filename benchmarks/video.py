"""Follows a car in a clip beside OpenCV's CSRT, KCF and MedianFlow, on the same pictures; writes VIDEO.md beside this file.

    python benchmarks/video.py CLIP TRUTH [--runs 20] [--dry]

The clip is car-detection.mp4 of intel-iot-devkit/sample-videos, 29 pictures from number 207 on, the truth a table frame, x, y, w, h of the
red car. All trackers get the same first box and the same pictures, already decoded, and are judged by the part of their box that lies in
the picture: as they are; with a grey bar over the car in three pictures, which are left out of the errors; with half the light from one
picture to the next; with a copy of the car that stands beside it. Ours runs with so many seeds of 200 particles, the others have no chance
in them. A picture is off where box and truth share less than a fifth of their area; said is how many of these pictures the tracker itself
called lost. A run is lost if it is off in the last picture. Times are medians over pictures of a warm tracker, what is worked out of a
picture included; each tracker runs alone, with the threads that it takes by itself.
"""

import argparse
import time
from dataclasses import replace
from importlib.util import find_spec
from itertools import islice
from tempfile import TemporaryDirectory

import numpy as np
from pages import told, write_page

import motes as mo
from motes.applications.video.frames import looked_at
from motes.applications.video.job import load
from motes.applications.video.settings import Settings
from motes.applications.video.target import overlap
from motes.io.clips import read_clip, write_clip

FIRST, BOX, COUNT = 207, (317, 132, 165, 287), 29
BARRED = slice(12, 15)
OFF = 0.2
COLUMNS = ("case", "tracker", "runs", "lost", "centre off, pixels", "overlap", "worst overlap", "pictures off", "said", "ms a picture")
OURS = {
    "colour and learned": {},
    "colour and learned, first picture alone": {"learning": False},
    "learned": {"cues": ("learned",)},
    "colour": {"cues": ("colour",)},
}


def cases(pictures, true):
    """Return the pictures of each case by its name."""
    left, top, width, height = BOX
    car = pictures[0][top : top + height, left : left + width]

    def barred(step, picture):
        if BARRED.start <= step < BARRED.stop:
            side, _, wide, _ = true[step]
            picture[:, max(0, int(side - 10)) : int(side + wide + 10)] = 128
        return picture

    def doubled(step, picture):
        picture[top : top + height, left + width + 30 : left + 2 * width + 30] = car
        return picture

    changes = {"as it is": lambda step, picture: picture, "grey bar": barred, "twin": doubled,
               "half the light": lambda step, picture: picture // 2 if step >= BARRED.start else picture}  # fmt: skip
    return {name: [change(step, one.copy()) for step, one in enumerate(pictures)] for name, change in changes.items()}


def ours(settings):
    """Return a tracker `(seed, clip, pictures) -> (boxes, whether lost, seconds a picture)` of ours."""

    def track(seed, clip, pictures):
        job = load(replace(settings, data=clip), seed)
        target, filter = job.targets[0], job.worn(job.filters["particle"])
        begun = time.perf_counter()
        ys = list(looked_at(pictures, job.ys.strides))
        history = mo.run(seed, filter, job.model, ys, keep=job.keep)
        found = target.found(history)
        return found, target.is_lost(history), (time.perf_counter() - begun) / len(ys)

    return track


def theirs(made):
    """Return a tracker of OpenCV's; where it says that it is lost it gives no box, and the last one stands."""

    def track(seed, clip, pictures):
        turned = [np.ascontiguousarray(one[..., ::-1]) for one in pictures]
        tracker = made()
        tracker.init(turned[0], BOX)
        boxes, lost, seconds = [BOX], [False], []
        for picture in turned[1:]:
            begun = time.perf_counter()
            good, box = tracker.update(picture)
            seconds.append(time.perf_counter() - begun)
            boxes.append(box if good else boxes[-1])
            lost.append(not good)
        boxes = np.array(boxes, float)
        # the truth is what is to be seen of the car
        corners = np.clip(np.concatenate([boxes[:, :2], boxes[:, :2] + boxes[:, 2:]], axis=1), 0, np.tile(pictures[0].shape[1::-1], 2))
        return np.concatenate([corners[:, :2], corners[:, 2:] - corners[:, :2]], axis=1), np.array(lost), float(np.median(seconds))

    return track


def judged(name, true, runs):
    """Return runs, lost ones, errors and times of a tracker in a case, as the table has them."""
    seen = np.ones(len(true), bool)
    seen[BARRED] = name != "grey bar"
    rows = []
    for found, lost, seconds in runs:
        away = np.hypot(*(found[:, :2] + found[:, 2:] / 2 - true[:, :2] - true[:, 2:] / 2).T)
        shared = overlap(found, true)
        off = (shared < OFF) & seen
        rows.append((off[-1], away[seen].mean(), shared[seen].mean(), off.sum(), (off & lost).sum(), seconds))
    lost, away, shared, off, said, seconds = map(np.array, zip(*rows, strict=True))
    means = [float(one.mean()) for one in (away, shared)]
    return (len(rows), int(lost.sum()), *means, float(shared.min()), float(off.mean()), float(said.mean()), 1e3 * float(np.median(seconds)))


def main():
    """Measure and write the page."""
    parser = argparse.ArgumentParser(description="Trackers of a car in a clip.")
    parser.add_argument("clip", help="car-detection.mp4")
    parser.add_argument("truth", help="table with frame, x, y, w, h of the red car")
    parser.add_argument("--runs", type=int, default=20, help="seeds of ours (20)")
    parser.add_argument("--dry", action="store_true", help="write no page")
    given = parser.parse_args()
    truth = mo.io.read_table(given.truth, ("frame", "x", "y", "w", "h"))
    true = np.stack([truth[name] for name in "xywh"], axis=1)[np.isin(truth["frame"], FIRST + np.arange(COUNT))]
    clip = read_clip(given.clip)
    pictures = list(islice(clip.pictures(FIRST), COUNT))
    box = (",".join(map(str, BOX)),)
    trackers = {name: (given.runs, ours(Settings(box=box, **more))) for name, more in OURS.items()}
    words = "OpenCV was not installed."
    if find_spec("cv2"):
        import cv2

        peers = {"CSRT": cv2.TrackerCSRT.create, "KCF": cv2.TrackerKCF.create, "MedianFlow": cv2.legacy.TrackerMedianFlow.create}
        trackers |= {f"OpenCV {name}": (1, theirs(made)) for name, made in peers.items()}
        words = f"OpenCV {cv2.__version__}."
    rows = []
    with TemporaryDirectory() as folder:
        for case, shown in cases(pictures, true).items():
            path = f"{folder}/{case}.mkv"
            write_clip(path, shown, clip.rate, exact=True)
            for name, (runs, track) in trackers.items():
                track(0, path, shown)  # compiles
                rows.append((case, name, *judged(case, true, [track(seed, path, shown) for seed in range(runs)])))
                print(*rows[-1], flush=True)
    table = mo.io.Table(COLUMNS, tuple(rows))
    if not given.dry:
        write_page("VIDEO", "A car in a clip", f"{told(__doc__)} {words}", table)


if __name__ == "__main__":
    main()
