"""A made-up building of rooms along a corridor, a robot that drives through it, and what its laser and its wheels say."""

import numpy as np

from motes.applications.laser.grid import Grid
from motes.applications.laser.scans import Scans, all_around
from motes.core import checks

CELL, SIZE, BEAMS, REACH = 0.1, (30.0, 18.0), 24, 10.0
"""Meters of a cell, of the building, beams of a scan, and how far they reach, meters."""
CORRIDOR = (8.0, 10.0)
WALLS = {False: (0.0, 5.0, 12.0, 16.0, 24.0, 30.0), True: (0.0, 8.0, 13.0, 21.0, 26.0, 30.0)}
"""Walls between the rooms to the south and to the north of the corridor."""
CUPBOARDS = (1, 1, 1, 3), (8, 3, 2, 1), (14, 0, 2, 2), (20, 4, 1, 1), (26, 1, 3, 1), (2, 15, 3, 1), (10, 12, 1, 2), (16, 15, 1, 3)
"""Their south-west corners and sides: no two rooms are alike."""
STEP, SPEED, TURN = 0.5, 0.6, 0.6
"""Seconds of a step, meters per second, and the most radians of a step."""
RANGE_SD, SLIP, TURN_SD = 0.05, 0.05, 0.01


def building() -> Grid:
    """Return the map."""
    wide, high = (round(side / CELL) for side in SIZE)
    occupied = np.zeros((high, wide), bool)
    occupied[[0, -1]], occupied[:, [0, -1]] = True, True
    cell = lambda meters: min(round(meters / CELL), wide - 1)  # noqa: E731
    for north, walls in WALLS.items():
        edge, rows = (CORRIDOR[1], slice(cell(CORRIDOR[1]), high)) if north else (CORRIDOR[0], slice(0, cell(CORRIDOR[0])))
        occupied[cell(edge)] = True
        for left, right in zip(walls, walls[1:], strict=False):
            occupied[rows, cell(right)] = True
            door = _door(left, right)
            occupied[cell(edge), cell(door - 0.6) : cell(door + 0.6)] = False
    for x, y, w, h in CUPBOARDS:
        occupied[cell(y) : cell(y + h), cell(x) : cell(x + w)] = True
    return Grid(occupied, ~occupied, CELL, (0.0, 0.0))


def _door(left: float, right: float) -> float:
    return left + 0.4 * (right - left)


def _route(rng: np.random.Generator, count: int) -> np.ndarray:
    """Poses `(count, 3)` of a drive from room to room, in an order that is drawn."""
    middle = sum(CORRIDOR) / 2
    rooms = [(_door(left, right), inner) for north, inner in ((False, 6.0), (True, 12.0))
             for left, right in zip(WALLS[north], WALLS[north][1:], strict=False)]  # fmt: skip
    poses, place, heading = [], np.array([rng.uniform(2, 28), middle]), rng.uniform(-np.pi, np.pi)
    while len(poses) < count:
        x, y = rooms[rng.integers(len(rooms))]
        for goal in ((x, middle), (x, y), (x, middle)):
            apart = np.array(goal) - place
            if np.hypot(*apart) < 1e-6:
                continue
            off = np.angle(np.exp(1j * (np.arctan2(apart[1], apart[0]) - heading)))
            turns, steps = int(np.ceil(abs(off) / TURN)), int(np.ceil(np.hypot(*apart) / (SPEED * STEP)))
            poses += [(*place, heading + off * (i + 1) / turns) for i in range(turns)]
            heading += off
            poses += [(*(place + apart * (i + 1) / steps), heading) for i in range(steps)]
            place = np.array(goal)
    return np.array(poses[:count])


def driven(seed: int, seconds: float, kidnap: float, outliers: float) -> tuple[Grid, Scans]:
    """Make a building and a recording of scans; outliers change nothing else of it.

    Raises:
        MotesError: a setting cannot be used.
    """
    if not seconds >= 60:
        checks.refuse("seconds", "at least 60", seconds)
    if not 0 <= kidnap < seconds:
        checks.refuse("kidnap", f"0, or seconds below {seconds:g}", kidnap)
    if not 0 <= outliers < 1:
        checks.refuse("outliers", "a share from 0 to below 1", outliers)
    rng, grid, count, at = np.random.default_rng(seed), building(), int(seconds / STEP), int(kidnap / STEP)
    poses = np.concatenate([_route(rng, at), _route(rng, count - at)]) if at else _route(rng, count)
    moved = np.diff(poses, axis=0, prepend=poses[:1])
    moved[at] = 0
    forward, turn = np.hypot(moved[:, 0], moved[:, 1]), np.angle(np.exp(1j * moved[:, 2]))
    read = forward * (1 + SLIP * rng.standard_normal(count)), turn * (1 + SLIP * rng.standard_normal(count))
    ranges = np.maximum(cast(grid, poses) + RANGE_SD * rng.standard_normal((count, BEAMS)), 0)
    wrong, instead = rng.random(ranges.shape) < outliers, rng.uniform(0.2, REACH, ranges.shape)
    ranges = np.where(wrong, instead, ranges)
    turned = read[1] + TURN_SD * (forward > 0) * rng.standard_normal(count)
    return grid, Scans(STEP * np.arange(count), read[0], turned, ranges, all_around(BEAMS), poses)


def cast(grid: Grid, poses: np.ndarray) -> np.ndarray:
    """Return the true ranges `(t, BEAMS)` from poses `(t, 3)`; NaN beyond the reach."""
    reach = np.arange(0, REACH, grid.resolution / 2)
    course = poses[:, 2:] + all_around(BEAMS)
    ends = (poses[:, None, None, :2] + reach[:, None] * np.stack([np.cos(course), np.sin(course)], axis=-1)[:, :, None]
            - np.array(grid.origin)) / grid.resolution  # fmt: skip
    column, row = (np.clip(ends[..., i].astype(int), 0, grid.occupied.shape[1 - i] - 1) for i in (0, 1))
    hit = grid.occupied[row, column]
    return np.where(hit.any(axis=-1), reach[hit.argmax(axis=-1)], np.nan)
