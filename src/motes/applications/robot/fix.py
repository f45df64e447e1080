"""Where a robot is, by its first ranges alone: the law of its place on a grid, for starts that nobody knows."""

import numpy as np

from motes.core import checks
from motes.io.recordings import RangeOnlyRecording

LOOK = 3.0
"""Seconds of ranges that a start is sought by at least, where the robot does not stand."""
MARGIN, SPACING = 60.0, 2.0
"""Meters: how far beyond the beacons the robot may be, and the spacing of the grid."""
SCALES, SCALE_SD = np.linspace(-0.3, 0.3, 31), 0.1
FAR_OFF = 5.0
"""A range that misses by so many deviations is taken for an outlier."""
MOST = 200
"""Ranges that are used, evenly spread."""


def located(recording: RangeOnlyRecording, until: float, driven: float) -> tuple[np.ndarray, np.ndarray]:
    """Return x, y and a heading of 0, and the standard deviations of x and y, at the start.

    Errors of the ranges count as no smaller than the grid's spacing, and large ones no more than `FAR_OFF` deviations.

    Args:
        recording: the recording.
        until: ranges up to this time are used.
        driven: meters that the robot went until then.

    Raises:
        MotesError: no range came until then.
    """
    first = recording.ranges[recording.ranges[:, 0] <= until]
    if not len(first):
        checks.refuse("start", "known, or ranges at the start to seek it by", f"none in the first {until:.0f} s")
    first = first[np.linspace(0, len(first) - 1, min(MOST, len(first))).astype(int)]
    places = recording.beacons[:, 1:3]
    low, high = places.min(axis=0) - MARGIN, places.max(axis=0) + MARGIN
    x, y = (axis.ravel() for axis in np.meshgrid(*(np.arange(a, b + SPACING, SPACING) for a, b in zip(low, high, strict=True))))
    cost = np.square(SCALES / SCALE_SD)[:, None] / 2 + np.zeros(len(x))
    for beacon in recording.beacons:
        distance = np.hypot(x - beacon[1], y - beacon[2])
        for reading in first[first[:, 1] == beacon[0], 2]:
            miss = np.abs(np.outer(1 + SCALES, distance) - reading) / SPACING
            cost += np.minimum(miss, FAR_OFF) ** 2 / 2
    weights = np.exp(cost.min() - cost).sum(axis=0)
    weights /= weights.sum()
    mean = np.array([weights @ x, weights @ y])
    spread = np.sqrt([weights @ (x - mean[0]) ** 2, weights @ (y - mean[1]) ** 2]) + SPACING / 2 + driven
    return np.array([*mean, 0.0]), spread
