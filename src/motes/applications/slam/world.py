"""A made-up robot that drives rounds among objects, sees those near it, and counts its wheels' turns with errors of their own."""

from typing import NamedTuple

import numpy as np

from motes.applications.robot.scenario import dead_reckoning
from motes.applications.slam.model import PLACE_SD
from motes.applications.slam.recording import Graph
from motes.core import checks

STEP, SPEED = 0.5, 1.5
"""Seconds and meters per second."""
OBJECTS, WIDTH, FAR = 40, 60.0, 18.0
"""Objects on a square of so many meters, seen from so far."""
SEEN = 0.2
"""Share of the objects within sight that are seen in a step."""
DRIFT, SHARE = 0.0015, 0.02
"""Errors of the odometry: radians per meter, and a share of each turn."""
SLIP, TURN_SD = 0.02, 0.003
"""Standard deviations of a step's length, meters, and of its turn, radians."""
WRONG = 1e-3
"""Share of sightings that are of something else."""


class World(NamedTuple):
    """A recording, and the truth of it in the frame of its start.

    Attributes:
        graph: what the robot gets.
        truth: its places, `(t, 2)`, meters.
        places: those of the objects, in the order of their numbers, `(L, 2)`.
    """

    graph: Graph
    truth: np.ndarray
    places: np.ndarray


def made_up(seed: int, seconds: float) -> World:
    """Make a recording.

    Args:
        seed: of the objects and of all noise.
        seconds: how long the robot drives, at least 60.

    Raises:
        MotesError: it is shorter.
    """
    if not seconds >= 60:
        checks.refuse("seconds", "at least 60", seconds)
    rng = np.random.default_rng(seed)
    count = int(seconds / STEP)
    clock = STEP * np.arange(count)
    forward = np.full(count, SPEED * STEP)
    turns = SPEED * STEP * (0.07 + 0.03 * np.sin(clock / 23.0))
    path, heading = dead_reckoning(np.zeros(3), forward, turns), np.concatenate([[0.0], np.cumsum(turns)])
    objects = path.mean(axis=0) + rng.uniform(-0.5, 0.5, (OBJECTS, 2)) * WIDTH
    # a step is taken in the heading before it: what the wheels read ahead and to the left
    ahead = (np.diff(path @ [1, 1j])) * np.exp(-1j * heading[:-1])
    read = np.stack([np.real(ahead), np.imag(ahead), turns], axis=1)
    read[:, 0] += SLIP * rng.standard_normal(count)
    # the odometry's own errors are those that the robot has to undo
    read[:, 2] = (read[:, 2] - DRIFT * np.hypot(read[:, 0], read[:, 1])) / (1 + SHARE) + TURN_SD * rng.standard_normal(count)
    apart = (objects[None] - path[:, None]) @ [1, 1j] * np.exp(-1j * heading)[:, None]
    pose, number = np.nonzero((np.abs(apart) < FAR) & (rng.random(apart.shape) < SEEN))
    seen = apart[pose, number]
    wrong = rng.random(len(seen)) < WRONG
    seen = np.where(wrong, FAR * (rng.uniform(-1, 1, len(seen)) + 1j * rng.uniform(-1, 1, len(seen))), seen)
    noise = PLACE_SD * rng.standard_normal((2, len(seen)))
    met, numbers = np.unique(number, return_inverse=True)
    rows = np.column_stack([pose, numbers, np.real(seen) + noise[0], np.imag(seen) + noise[1]])
    return World(Graph(np.concatenate([np.zeros((1, 3)), read]), rows), path, objects[met])
