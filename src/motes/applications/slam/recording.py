"""What a robot without a map is given, from a recording of either kind, and what its answer is held against."""

import os
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from motes.applications.robot import scenario
from motes.core import checks
from motes.io.archive import whole_file
from motes.io.files import label, reject
from motes.io.recordings import RangeOnlyRecording
from motes.laws.observed import Observed
from motes.laws.sightings import sightings

ODOMETRY, LANDMARK = "ODOMETRY", "LANDMARK"


class Way(NamedTuple):
    """A robot's way.

    Attributes:
        ys: sightings of each step.
        inputs: what the odometry says of each, time axis first.
        times: seconds, `(t,)`; None where steps are only numbered.
        alone: the way by odometry alone, `(t, 2)`, meters from the start.
        landmarks: how many there are.
        truth: true places `(t, 2)`, NaN where they are not known; None where none are.
        places: true places of the landmarks, `(L, 2)`, or None.
    """

    ys: Observed
    inputs: Any
    times: np.ndarray | None
    alone: np.ndarray
    landmarks: int
    truth: np.ndarray | None
    places: np.ndarray | None


class Graph(NamedTuple):
    """A recording of steps and of landmarks seen.

    Attributes:
        steps: meters ahead and to the left, and turn in radians, that lead to each pose, `(t, 3)`; zeros for the first.
        seen: pose, landmark, meters ahead and to the left of each sighting, `(s, 4)`; landmarks are numbered from 0 on.
    """

    steps: np.ndarray
    seen: np.ndarray


def by_ranges(recording: RangeOnlyRecording) -> Way:
    """Return the way of a robot that measures ranges to beacons; turns are those of the odometry that drifts."""
    made = scenario.scenario(recording, scenario.drifting_turns(recording))
    pairs = [[(beacon, [float(z)]) for beacon, z in enumerate(row) if not np.isnan(z)] for row in np.asarray(made.ys)]
    truth = np.full((len(made.times), 2), np.nan)
    truth[made.scored] = np.asarray(made.truth)[:, :2]
    forward, turn = np.asarray(made.inputs.forward, np.float64), np.asarray(made.inputs.turn, np.float64)
    alone = scenario.dead_reckoning(np.zeros(3), forward[1:], turn[1:])
    return Way(sightings(pairs), made.inputs, made.times, alone, len(made.beacons), truth, np.asarray(made.beacons))


def by_places(graph: Graph, truth: np.ndarray | None = None, places: np.ndarray | None = None) -> Way:
    """Return the way of a robot that sees landmarks; where they are known, with true places `(t, 2)` and those of landmarks `(L, 2)`."""
    pairs: list[list[tuple[int, np.ndarray]]] = [[] for _ in graph.steps]
    for pose, landmark, ahead, left in graph.seen:
        pairs[int(pose)].append((int(landmark), np.array([ahead, left])))
    # a step is taken in the heading before it
    heading = np.concatenate([[0.0], np.cumsum(graph.steps[1:, 2])[:-1]]) if len(graph.steps) > 1 else np.zeros(0)
    moved = (graph.steps[1:, 0] + 1j * graph.steps[1:, 1]) * np.exp(1j * heading)
    path = np.concatenate([[0.0], np.cumsum(moved)])
    count = int(graph.seen[:, 1].max()) + 1
    return Way(sightings(pairs), graph.steps, None, np.stack([np.real(path), np.imag(path)], axis=1), count, truth, places)


def read_graph(path: str | os.PathLike[str]) -> Graph:
    """Read a text file of odometry between successive poses and of landmarks seen from them.

    Poses are taken in the order of their numbers; landmarks have numbers of the same row of numbers, and are renumbered. Covariances, which
    follow in each line, are left out.

    Args:
        path: file of lines "ODOMETRY i j dx dy dtheta ..." and "LANDMARK i k x y ...".

    Raises:
        FileError: the file cannot be read, a line is none of these, the poses are no chain, or nothing was seen.
    """
    try:
        with open(path, encoding="ascii") as file:
            lines = [line.split() for line in file]
    except (OSError, UnicodeDecodeError) as reason:
        reject(path, "a file that can be read", getattr(reason, "strerror", None) or "one that is no text")
    steps, seen = [], []
    for number, words in enumerate(lines, 1):
        if not words:
            continue
        rows, count = (steps, 6) if words[0] == ODOMETRY else (seen, 5) if words[0] == LANDMARK else (None, 0)
        try:
            values = [float(word) for word in words[1:count]]
        except ValueError:
            values = []
        if rows is None or len(values) != count - 1 or not np.isfinite(values).all():
            wanted = '"ODOMETRY i j dx dy dtheta" or "LANDMARK i k x y" with finite numbers'
            checks.refuse(f"{label(path)}: line {number}", wanted, repr(" ".join(words)[:60]), error=checks.FileError)
        rows.append(values)
    if not steps or not seen:
        reject(path, f"lines {ODOMETRY} and lines {LANDMARK}", f"{len(steps)} and {len(seen)} of them")
    odometry, sighted = np.array(steps), np.array(seen)
    odometry = odometry[np.argsort(odometry[:, 1], kind="stable")]
    if (odometry[1:, 0] != odometry[:-1, 1]).any():
        row = int(np.argmax(odometry[1:, 0] != odometry[:-1, 1])) + 1
        reject(path, f"a step from pose {odometry[row - 1, 1]:g}, to which the one before leads", f"one from {odometry[row, 0]:g}")
    poses = np.concatenate([odometry[:1, 0], odometry[:, 1]])
    order = np.searchsorted(poses, sighted[:, 0])
    unknown = (order == len(poses)) | (poses[np.minimum(order, len(poses) - 1)] != sighted[:, 0])
    if unknown.any():
        reject(path, "landmarks seen from poses to which steps lead", f"one from pose {sighted[unknown][0, 0]:g}")
    numbers = np.unique(sighted[:, 1], return_inverse=True)[1]
    return Graph(np.concatenate([np.zeros((1, 3)), odometry[:, 2:]]), np.column_stack([order, numbers, sighted[:, 2:]]))


def write_graph(path: str | os.PathLike[str], graph: Graph) -> None:
    """Write a recording as `read_graph` reads it: landmarks are numbered behind the poses."""
    count = len(graph.steps)
    lines = [f"{ODOMETRY} {i - 1} {i} " + " ".join(map(repr, map(float, graph.steps[i]))) for i in range(1, count)]
    lines += [f"{LANDMARK} {int(pose)} {count + int(k)} {float(x)!r} {float(y)!r}" for pose, k, x, y in graph.seen]
    with whole_file(Path(path)) as file:
        file.write(("\n".join(lines) + "\n").encode("ascii"))
