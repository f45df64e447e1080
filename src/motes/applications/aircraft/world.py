"""A made-up flight: straight legs and turns of changing rate, reported as airliners report themselves."""

import numpy as np

from motes.applications.aircraft.scenario import EARTH, KNOT, Reports
from motes.core import checks

STEP, SPEED = 1.0, 120.0
"""Seconds between reports, and meters per second."""
STRAIGHT, TURN, RATE = (60.0, 240.0), (30.0, 120.0), (0.008, 0.04)
"""Shortest and longest leg and turn, seconds; slowest and fastest turn, rad/s."""
PLACE, PLACE_SD, SPEED_SD = (50.0, 8.0), 8.0, 0.5
"""Latitude and longitude where it begins, degrees; errors of what is reported, m and m/s."""


def flown_reports(seed: int, seconds: float = 4800.0) -> Reports:
    """Make up the reports of a flight.

    Args:
        seed: of legs, turns and errors.
        seconds: how long it lasts, at least 120.

    Raises:
        MotesError: it is shorter.
    """
    if not 120 <= seconds < np.inf:
        checks.refuse("duration", "at least 120 s", seconds)
    generator = np.random.default_rng(seed)
    rates: list[float] = []
    while len(rates) < seconds / STEP:
        rates += [0.0] * int(generator.uniform(*STRAIGHT) / STEP)
        rates += [generator.choice([-1.0, 1.0]) * generator.uniform(*RATE)] * int(generator.uniform(*TURN) / STEP)
    rate = np.array(rates[: int(seconds / STEP)])
    # degrees from north grow clockwise
    course = generator.uniform(0, 2 * np.pi) + np.cumsum(rate) * STEP
    north, east = (np.cumsum(SPEED * STEP * part(course)) for part in (np.cos, np.sin))
    north, east = (axis + PLACE_SD * generator.normal(size=axis.size) for axis in (north, east))
    latitude = PLACE[0] + np.degrees(north / EARTH)
    longitude = PLACE[1] + np.degrees(east / EARTH / np.cos(np.radians(PLACE[0])))
    speed = (SPEED + SPEED_SD * generator.normal(size=rate.size)) / KNOT
    return Reports(STEP * np.arange(rate.size), latitude, longitude, speed, np.degrees(course) % 360)
