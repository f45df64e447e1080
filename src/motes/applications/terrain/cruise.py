"""Errors of an inertial system in straight level flight (Dahia et al. 2004): `models.inertial` with constant transition and noise."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from motes.applications.terrain.settings import Prior
from motes.core import checks
from motes.laws.conditional import LinearGaussian
from motes.models import inertial
from motes.models.mechanization import attitude_of
from motes.models.terrain import TerrainMap

STRAIGHT = 0.05
"""Share of its length by which a track may leave the straight line flown at constant speed; an even turn by 23 degrees does."""


class Cruise(NamedTuple):
    """A straight level flight at constant speed.

    Attributes:
        latitude: rad.
        height: m above the ellipsoid; above sea level does.
        north: velocity, m/s.
        east: velocity, m/s.
    """

    latitude: float
    height: float
    north: float
    east: float


def cruise_of(terrain: TerrainMap, track: np.ndarray, seconds: np.ndarray) -> Cruise:
    """Return the straight level flight at constant speed that a track is, at the latitude of the map's middle.

    Args:
        terrain: the map.
        track: north, east and altitude, `(t, 3)`, m.
        seconds: time of each fix, `(t,)`.

    Raises:
        MotesError: the map does not know its latitude, or the track is another one.
    """
    if terrain.latitude is None or not abs(terrain.latitude) < 90:
        checks.refuse("terrain latitude", "the latitude of the map's middle (15 inertial states depend on it)", terrain.latitude)
    way, passed = track - track[0], seconds - seconds[0]
    velocity = way[-1] / max(passed[-1], 1e-9)
    off = np.linalg.norm(way - np.outer(passed, velocity), axis=1)
    length = np.linalg.norm(way[-1])
    if off.max() > STRAIGHT * length:
        checks.refuse("inertial states", "straight flight at constant speed for 15",
                      f"a track up to {off.max():.0f} m off that of {length:.0f} m", "Cut it into straight pieces, or take 9.")
    return Cruise(np.radians(terrain.latitude), float(track[:, 2].mean()), float(velocity[0]), float(velocity[1]))


def dynamics(cruise: Cruise, grade: inertial.Grade, position: float, step: float) -> LinearGaussian:
    """Return how the fifteen states go from fix to fix, worked out in float64.

    Args:
        cruise: the flight.
        grade: noise of the sensors.
        position: noise straight on the position, m/sqrt(s).
        step: seconds between fixes.
    """
    velocity = np.array([cruise.north, cruise.east, 0.0])
    turning = 2 * inertial.earth_rate(cruise.latitude) + inertial.transport_rate(cruise.latitude, cruise.height, velocity)
    force = np.cross(turning, velocity) - [0.0, 0.0, inertial.gravity(cruise.latitude, cruise.height)]
    attitude = attitude_of(np.array(0.0), np.array(0.0), np.arctan2(cruise.east, cruise.north))
    growth = inertial.error_growth(cruise.latitude, cruise.height, velocity, force, attitude)
    transition, noise = inertial.discretized(growth, inertial.error_noise(grade, position), step)
    return LinearGaussian(jnp.asarray(transition), jnp.asarray(noise))


def deviations(prior: Prior) -> np.ndarray:
    """Return the standard deviations `(15,)` of the states at the first fix, in their units."""
    attitude, gyro = np.radians(prior.attitude), np.radians(prior.gyro_bias) / 3600
    return along_axes(
        (attitude, attitude),
        (prior.horizontal_velocity, prior.vertical_velocity),
        (prior.horizontal_position, prior.vertical_position),
        (prior.accelerometer_bias, prior.accelerometer_bias),
        (gyro, gyro),
    )


def along_axes(*pairs: tuple[float, float]) -> np.ndarray:
    """Return values for north, east and down, one triple after the other, from pairs of a horizontal and a vertical one."""
    return np.concatenate([(horizontal, horizontal, vertical) for horizontal, vertical in pairs])
