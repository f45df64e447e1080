"""Flights into the notch that are made up, and the plots that a radar has of these or of recorded flights.

Each goes inbound, turns across the line of sight, flies there until the radar has lost it, and turns out.
"""

from typing import NamedTuple

import numpy as np

from motes.applications.target_tracking.settings import Radar
from motes.core import checks
from motes.io.clocks import Clock

SPEED, BEGIN, RATE = 200.0, 34e3, (0.04, 0.06)
"""Speed, m/s; range at which it begins, m; slowest and fastest turn, rad/s."""
INBOUND, LEG, OUT = (32.0, 48.0), (32.0, 44.0), (0.8, 1.5)
"""Shortest and longest inbound leg and leg across, s; angles of the turn out, rad."""
CLOSING = 20.0
"""Range rate at which the turn across ends: still closing by so much, m/s."""
FINE = 20
"""Steps of the flight between two scans."""
APPEARS, ENDS = (0.0, 0.3), (0.8, 1.0)
"""When one of several flights appears and when it ends at the earliest and at the latest, as shares of all scans."""


MOST = 100
"""Flights that are made up at most."""


class World(NamedTuple):
    """What was flown, and what the radar saw of it.

    Attributes:
        times: of the scans, s, `(t,)`.
        names: of the m targets.
        states: true states `(t, m, 4)`, NaN where a target is not there.
        scans: plots of range, azimuth (from east) and range rate `(m, 3)` of each scan.
        start: time 0 in the recording, s (of dates Unix seconds).
        clock: how times are written there.
    """

    times: np.ndarray
    names: tuple[str, ...]
    states: np.ndarray
    scans: list[np.ndarray]
    start: float = 0.0
    clock: Clock = Clock()


def range_rate(states: np.ndarray) -> np.ndarray:
    """Range rates of states `(..., 4)`, m/s."""
    return np.sum(states[..., :2] * states[..., 2:4], axis=-1) / np.hypot(states[..., 0], states[..., 1])


def flown(generator: np.random.Generator, scans: int, period: float) -> np.ndarray:
    """Return the states `(t, 4)` of a flight at its scans."""
    azimuth = generator.uniform(-np.pi, np.pi)
    place, course = BEGIN * np.array([np.cos(azimuth), np.sin(azimuth)]), azimuth + np.pi + generator.uniform(-0.1, 0.1)
    across, leg, out = generator.uniform(*INBOUND), generator.uniform(*LEG), generator.uniform(*OUT)
    sides, rate, dt = generator.choice([-1.0, 1.0], 2), generator.uniform(*RATE), period / FINE
    states, phase, left = [], "inbound", 0.0
    for step in range(scans * FINE):
        velocity = SPEED * np.array([np.cos(course), np.sin(course)])
        if step % FINE == 0:
            states.append([*place, *velocity])
        if phase == "inbound" and step * dt > across:
            phase = "turning across"
        if phase == "turning across" and place @ velocity > -CLOSING * np.hypot(*place):
            phase, left = "across", leg
        if phase == "across" and left <= 0:
            phase, left = "turning out", out
        if phase == "turning out" and left <= 0:
            phase = "out"
        turn = {"turning across": sides[0] * rate, "turning out": sides[1] * rate}.get(phase, 0.0)
        left -= dt * (rate if phase == "turning out" else 1.0)
        course += turn * dt
        place = place + dt * velocity
    return np.array(states)


def made_up(seed: int, scans: int, period: float, radar: Radar, targets: int = 1) -> World:
    """Make flights up, and the scans of a radar. A single one is there from the first scan to the last; several come and go.

    Args:
        seed: of both.
        scans: how many, at least 10.
        period: seconds between them.
        radar: its numbers.
        targets: number of flights.

    Raises:
        MotesError: there are fewer, or the period is no time.
    """
    if not scans >= 10:
        checks.refuse("scans", "at least 10", scans)
    checks.above_zero("period", period, 10.0)
    if not 0 <= targets <= MOST:
        checks.refuse("targets", f"a number from 0 to {MOST}", targets)
    generator = np.random.default_rng(seed)
    states = np.full((scans, targets, 4), np.nan)
    for target in range(targets):
        flight = flown(generator, scans, period)
        begin, end = (round(scans * generator.uniform(*share)) for share in (APPEARS, ENDS)) if targets > 1 else (0, scans)
        states[begin:end, target] = flight[: end - begin]
    names = tuple(str(target + 1) for target in range(targets))
    times = period * np.arange(scans)
    return World(times, names, states, seen(generator, states, radar))


def seen(generator: np.random.Generator, states: np.ndarray, radar: Radar) -> list[np.ndarray]:
    """Draw the scans of a radar, in which the plots of targets come at any place among false ones.

    Args:
        generator: of random numbers.
        states: true states `(t, m, 4)`, NaN where a target is not there.
        radar: its numbers; it sees nothing further off than `farthest`.
    """
    scans, targets = states.shape[:2]
    distance, rate = np.hypot(states[..., 0], states[..., 1]), range_rate(states)
    chances = radar.detection / (1 + np.exp(-(np.abs(rate) - radar.notch) / radar.edge))
    heard = (generator.random((scans, targets)) < chances) & (distance < radar.farthest)
    noise = generator.standard_normal((scans, targets, 3)) * [radar.distance, radar.azimuth, radar.rate]
    own = np.stack([distance, np.arctan2(states[..., 1], states[..., 0]), rate], axis=-1) + noise
    own[..., 1] = (own[..., 1] + np.pi) % (2 * np.pi) - np.pi
    found = []
    for plots, there in zip(own, heard, strict=True):
        count = generator.poisson(radar.false)
        false = generator.uniform([0, -np.pi, -radar.fastest], [radar.farthest, np.pi, radar.fastest], (count, 3))
        found.append(generator.permutation(np.concatenate([plots[there], false])))
    return found
