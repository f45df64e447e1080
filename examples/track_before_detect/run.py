"""A target too dim to be detected in any single frame: track before detect, beside plots first and tracks after.

    python examples/track_before_detect/run.py [--runs 100] [--n 8000]

Frames are made up: 24 x 24 pixels, a point spread of one pixel, peaks 3, 6 and 9 dB over the noise of a pixel; the target is there from
frame 12 to 41 of 55. Both trackers may begin one track in 1000 frames of noise. It takes ten to fifteen minutes; pictures
go to out/.
"""

import argparse
from pathlib import Path

import jax
import numpy as np
from model import Target, existence, frames, tracker, tracking
from pictures import Shown
from plots import measured
from trials import Found, before_detect, false_tracks, first_held, scored, threshold_for, through_plots, worlds

import motes as mo
from motes.laws.observed import Observed

DECIBELS = (3, 6, 9)
RATE = 1e-3
"""False tracks that a frame of noise may have."""
THRESHOLDS = (2.0, 2.5, 2.75, 3.0, 3.5, 4.0)
"""On the matched filter, in standard deviations of its noise."""
SCANNED, FEW = 60, 2000
"""Runs and particles with which thresholds are tried."""
COLUMNS = ("dB", "tracker", "threshold", "false tracks", "never held", "delay", "lost", "held", "error, px", "ends after")


def peak(decibels: float) -> float:
    """Return the peak over the standard deviation of the noise."""
    return 10 ** (decibels / 20)


def best_detector(target, decibels, noise):
    """Try all thresholds on runs of their own; return the one with which a target is held longest."""
    truth, films = worlds(target, peak(decibels), 200 + decibels, SCANNED)
    states = np.asarray(truth).reshape(-1, 6)
    live = states[:, 5] > 0
    empty, bright = noise.reshape(-1, *noise.shape[2:]), films.reshape(-1, *films.shape[2:])[live]
    found = []
    for threshold in THRESHOLDS:
        detector = measured(target, threshold, empty, bright, states[live, :2])
        level = threshold_for(through_plots(target, FEW, noise, detector).exists, RATE)
        score = scored(through_plots(target, FEW, films, detector), level, np.asarray(truth))[0]
        print(f"{decibels} dB, threshold {threshold}: {detector.detection:.2f} detected, {detector.false:.2f} false, "
              f"held {score.held:.3f} of the time, delay {score.delay:.1f}, {score.lost} of {SCANNED} lost", flush=True)  # fmt: skip
        found.append((score.held, detector))
    return max(found, key=lambda one: one[0])[1]


def compared(target, n, runs):
    """Run both trackers at every brightness; return the rows of the table and, for the pictures, what the run of median delay gave."""
    noise = worlds(target, 0.0, 100, 3 * runs)[1]
    empty = before_detect(target, n, noise).exists
    level = threshold_for(empty, RATE)
    frames_of_noise, rows, shown = empty.size, [], None
    for decibels in DECIBELS:
        truth, films = worlds(target, peak(decibels), decibels, runs)
        detector = best_detector(target, decibels, noise[:SCANNED])
        silent = through_plots(target, n, noise, detector).exists
        own = threshold_for(silent, RATE)
        direct, through = before_detect(target, n, films), through_plots(target, n, films, detector)
        found = scored(direct, level, np.asarray(truth)), scored(through, own, np.asarray(truth))
        both = found[0][1] & found[1][1]
        names = ("track before detect", "through plots"), ("", f"{detector.threshold:g}")
        for name, threshold, (score, _, distance), (probabilities, limit) in zip(
            *names, found, ((empty, level), (silent, own)), strict=True
        ):
            false = 1000 * false_tracks(probabilities, limit) / frames_of_noise
            error = float(np.sqrt(np.mean(distance[both] ** 2)))
            rows.append((decibels, name, threshold, false, score.missed, score.delay, score.lost, score.held, error, score.after))
        print(mo.io.Table(COLUMNS, tuple(rows[-2:])), flush=True)
        delays = first_held(found[0][1])
        gained = first_held(found[1][1]) - delays
        print(f"earlier by {gained.mean():.2f} frames (standard error {gained.std() / np.sqrt(runs):.2f})", flush=True)
        if shown is None:
            number = int(np.argsort(delays, kind="stable")[runs // 2])
            one = slice(number, number + 1)
            shown = films[one], truth[one], Found(*(each[one] for each in direct)), Found(*(each[one] for each in through))
    return rows, shown


def cloud_of(target, n, film):
    """Return some particles of track before detect `(t, 6, 300)`."""

    def keep(law):
        return {"cloud": law.sample(jax.random.key(0), 300), **existence(law)}

    ys = Observed(film, np.ones(len(film), bool))
    return np.asarray(mo.run(0, tracker(target, n), tracking(target, frames(target)), ys, keep=keep).kept["cloud"])


def main():
    """Compare, print the table and draw the pictures."""
    parser = argparse.ArgumentParser(description="Track before detect.")
    parser.add_argument("--runs", type=int, default=100, help="runs at each brightness; three times as many without a target (100)")
    parser.add_argument("--n", type=int, default=8000, help="particles (8000)")
    given = parser.parse_args()
    target = Target()
    rows, (films, truth, direct, through) = compared(target, given.n, given.runs)
    print(mo.io.Table(COLUMNS, tuple(rows)).to_markdown())
    drawn = Shown(np.asarray(films[0]), np.asarray(truth[0]), direct, through, cloud_of(target, given.n, films[0]))
    Path("out").mkdir(exist_ok=True)
    drawn.figure().savefig("out/track_before_detect.png", dpi=110)
    drawn.animation().savefig("out/track_before_detect.gif")
    print("pictures: out/track_before_detect.png, out/track_before_detect.gif")


if __name__ == "__main__":
    main()
