"""Second recordings of the form of a first one: mirrored, rotated, cut, resampled, with outliers, with headings that look backward."""

import numpy as np

from motes.core.record import replace
from motes.io.recordings import RangeOnlyRecording


def backward(recording: RangeOnlyRecording) -> RangeOnlyRecording:
    """The column of headings looks backward."""
    truth = recording.truth.copy()
    truth[:, 3] += np.pi
    return replace(recording, truth=truth)


def mirrored(recording: RangeOnlyRecording) -> RangeOnlyRecording:
    """East and west exchanged: left turns are right turns."""
    parts = (recording.truth, recording.odometry, recording.drifting_path, recording.beacons)
    truth, odometry, path, beacons = (part.copy() for part in parts)
    for part, place in ((truth, 1), (path, 0), (beacons, 1)):
        part[:, place] *= -1
    truth[:, 3] = np.pi - truth[:, 3]
    odometry[:, 2] *= -1
    return replace(recording, truth=truth, odometry=odometry, drifting_path=path, beacons=beacons)


def rotated(recording: RangeOnlyRecording, angle: float = 2.0, shift: tuple[float, float] = (300.0, -1200.0)) -> RangeOnlyRecording:
    """Another north and another origin."""
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    truth, path, beacons = recording.truth.copy(), recording.drifting_path @ turn + shift, recording.beacons.copy()
    truth[:, 1:3], beacons[:, 1:3] = truth[:, 1:3] @ turn + shift, beacons[:, 1:3] @ turn + shift
    truth[:, 3] += angle
    return replace(recording, truth=truth, drifting_path=path, beacons=beacons)


def cut(recording: RangeOnlyRecording, begin: float, end: float) -> RangeOnlyRecording:
    """A part of it, from second `begin` to `end`."""
    kept = (recording.truth[:, 0] >= begin) & (recording.truth[:, 0] <= end)
    truth, path = recording.truth[kept].copy(), recording.drifting_path[kept]
    odometry = recording.odometry[kept[1:]][1:].copy() if not kept[0] else recording.odometry[kept[1:]].copy()
    start = truth[0, 0]
    ranges = recording.ranges[(recording.ranges[:, 0] >= start) & (recording.ranges[:, 0] <= truth[-1, 0])].copy()
    for part in (truth, odometry, ranges):
        part[:, 0] -= start
    return replace(recording, truth=truth, odometry=odometry, drifting_path=path, ranges=ranges)


def resampled(recording: RangeOnlyRecording, every: int) -> RangeOnlyRecording:
    """Odometry and truth at every so many steps only; each step goes on along its chord."""
    kept = np.arange(0, len(recording.truth), every)
    truth, path = recording.truth[kept], recording.drifting_path[kept]
    sums = np.add.reduceat(recording.odometry[: kept[-1], 1:], kept[:-1], axis=0)
    odometry = np.column_stack([truth[1:, 0], sums])
    ranges = recording.ranges[recording.ranges[:, 0] <= truth[-1, 0]]
    return replace(recording, truth=truth, odometry=odometry, drifting_path=path, ranges=ranges)


def with_outliers(recording: RangeOnlyRecording, share: float = 0.1, seed: int = 0) -> RangeOnlyRecording:
    """Echoes: some ranges are much too long."""
    rng, ranges = np.random.default_rng(seed), recording.ranges.copy()
    hit = rng.random(len(ranges)) < share
    ranges[hit, 2] += rng.uniform(3, 40, hit.sum())
    return replace(recording, ranges=ranges)
