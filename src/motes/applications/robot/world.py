"""A made-up recording: a robot that drives loops among four beacons, with odometry that slips and radios that read long."""

import numpy as np

from motes.applications.robot.scenario import dead_reckoning
from motes.core import checks
from motes.io.recordings import RangeOnlyRecording

STEP, SPEED = 0.2, 1.0
"""Seconds and meters per second."""
BEACONS = np.array([[1.0, -20.0, -5.0], [2.0, 22.0, -8.0], [3.0, 18.0, 25.0], [4.0, -16.0, 24.0]])
"""Id and place."""
INSIDE, TIGHT = 25.0, 0.2
"""Meters from the middle of the beacons beyond which the robot turns back, by so many radians of a meter at most."""
LONG, DELAY, RANGE_SD = 0.07, 0.1, 0.5
"""By how much ranges are too long, as a share and in meters, and their standard deviation."""
SLIP, TURN_SD, DRIFT = 0.03, 0.002, 0.0005
"""Standard deviations of a step's length, as a share, and of its turn, radians; and the turn of the drifting odometry in each step."""


def simulated(seed: int, seconds: float = 600.0) -> RangeOnlyRecording:
    """Make a recording: the robot stands for 5 s, then drives.

    Args:
        seed: of the noise.
        seconds: how long it drives, at least 60.

    Raises:
        MotesError: it is shorter.
    """
    if not seconds >= 60:
        checks.refuse("seconds", "at least 60", seconds)
    generator = np.random.default_rng(seed)
    steps = int(seconds / STEP)
    times = STEP * np.arange(steps + 1)
    moving = times[1:] > 5.0
    forward = np.where(moving, SPEED * STEP, 0.0)
    start = np.array([0.0, 0.0, generator.uniform(-np.pi, np.pi)])
    turns = _loops(start, times[1:], forward)
    place = dead_reckoning(start, forward, turns)
    heading = start[2] + np.concatenate([[0.0], np.cumsum(turns)])
    slipped = forward * (1 + SLIP * generator.normal(size=steps))
    read = np.column_stack([times[1:], slipped, turns + TURN_SD * moving * generator.normal(size=steps)])
    drifting = dead_reckoning(start, forward, turns + DRIFT * moving)
    count = int(1.5 * seconds)
    at = np.sort(generator.uniform(0, times[-1], count))
    which = generator.integers(0, len(BEACONS), count)
    seen = np.stack([np.interp(at, times, axis) for axis in place.T], axis=1)
    ranges = (1 + LONG) * np.hypot(*(seen - BEACONS[which, 1:]).T) + DELAY + RANGE_SD * generator.normal(size=count)
    log = np.column_stack([at, BEACONS[which, 0], np.maximum(ranges, 0.0)])
    return RangeOnlyRecording(np.column_stack([times, place, heading]), read, drifting, log, BEACONS.copy(), "a made-up recording")


def _loops(start: np.ndarray, times: np.ndarray, forward: np.ndarray) -> np.ndarray:
    """Turns of the steps that end at some times `(t,)`: loops of changing width, and back where they lead away from the beacons."""
    bends = 0.03 + 0.06 * np.sin(times / 17.0) + 0.05 * np.cos(times / 41.0)
    middle, place, heading, turns = BEACONS[:, 1:].mean(axis=0) @ [1, 1j], start[:2] @ [1, 1j], start[2], np.zeros(len(times))
    for step, (bend, length) in enumerate(zip(bends, forward, strict=True)):
        if abs(place - middle) > INSIDE:
            bend = np.clip(np.angle((middle - place) * np.exp(-1j * heading)), -TIGHT, TIGHT)
        turns[step] = bend * length
        place += length * np.exp(1j * (heading + turns[step] / 2))
        heading += turns[step]
    return turns
