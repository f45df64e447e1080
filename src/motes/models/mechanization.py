"""Strapdown mechanization: from what accelerometers and gyros read to attitude, velocity and position, and back; NED axes, float64.

A step takes the readings of one interval, constant in it. With the rotations of the body and of the NED axes over the interval,

    C+ = exp(-[w_n] dt) C exp([w_b] dt),     v+ = v + dt (C_mid f + g - (2 Omega + rho) x v),     position by the mean of v and v+,

so that readings worked out from a motion (`readings`) lead back to it exactly (`mechanized`).
"""

from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from motes.core import checks
from motes.models.inertial import Grade, earth_rate, gravity, radii, transport_rate


class Motion(NamedTuple):
    """A motion over the Earth at t instants.

    Attributes:
        latitude: rad, `(t,)`.
        longitude: rad, `(t,)`.
        height: m above the ellipsoid, `(t,)`.
        velocity: north, east, down, m/s, `(t, 3)`.
        attitude: rotation from body to NED axes, `(t, 3, 3)`.
    """

    latitude: np.ndarray
    longitude: np.ndarray
    height: np.ndarray
    velocity: np.ndarray
    attitude: np.ndarray


class Readings(NamedTuple):
    """What ideal or real sensors read, one row per interval between two instants.

    Attributes:
        rate: angular rate of the body against inertial space, body axes, rad/s, `(t - 1, 3)`.
        force: specific force, body axes, m/s^2, `(t - 1, 3)`.
    """

    rate: np.ndarray
    force: np.ndarray


def attitude_of(roll: np.ndarray, pitch: np.ndarray, heading: np.ndarray) -> np.ndarray:
    """Return rotations from body (forward, right, down) to NED axes, `(..., 3, 3)`, from angles in rad."""
    angles = np.stack(np.broadcast_arrays(heading, pitch, roll), axis=-1)
    return Rotation.from_euler("ZYX", angles.reshape(-1, 3)).as_matrix().reshape(*angles.shape[:-1], 3, 3)


def moved(start: tuple[float, float, float], velocity: np.ndarray, attitude: np.ndarray, step: float) -> Motion:
    """Return the motion that begins at a place and has the given velocities and attitudes.

    Args:
        start: latitude and longitude in rad, height in m.
        velocity: `(t, 3)`, m/s.
        attitude: `(t, 3, 3)`.
        step: seconds between instants.

    Raises:
        MotesError: shapes do not fit, or the step is not positive.
    """
    _check_motion(velocity, attitude, step)
    place = [np.asarray(start, np.float64)]
    for now, then in zip(velocity[:-1], velocity[1:], strict=True):
        place.append(_displaced(place[-1], (now + then) / 2, step))
    latitude, longitude, height = np.stack(place, axis=1)
    return Motion(latitude, longitude, height, velocity, attitude)


def readings(motion: Motion, step: float) -> Readings:
    """Return what ideal sensors read along a motion; `mechanized` leads back to it."""
    rates, forces = [], []
    for k in range(len(motion.latitude) - 1):
        place, velocity, attitude = _at(motion, k)
        turned, pull = _surroundings(place, velocity, step)
        after = motion.attitude[k + 1]
        turn = Rotation.from_matrix(attitude.T @ turned.T @ after)
        middle = _halfway(turned) @ attitude @ _halfway(turn.as_matrix())
        rates.append(turn.as_rotvec() / step)
        forces.append(middle.T @ ((motion.velocity[k + 1] - velocity) / step - pull))
    return Readings(np.array(rates), np.array(forces))


def mechanized(start: Motion, read: Readings, step: float) -> Motion:
    """Return the motion that an inertial navigation system works out.

    Args:
        start: where it believes to begin, a motion of one instant.
        read: what its sensors read.
        step: seconds between instants.
    """
    place, velocity, attitude = _at(start, 0)
    instants = [(place, velocity, attitude)]
    for rate, force in zip(read.rate, read.force, strict=True):
        turned, pull = _surroundings(place, velocity, step)
        turn = Rotation.from_rotvec(rate * step).as_matrix()
        middle = _halfway(turned) @ attitude @ _halfway(turn)
        after = velocity + step * (middle @ force + pull)
        place = _displaced(place, (velocity + after) / 2, step)
        velocity, attitude = after, turned @ attitude @ turn
        instants.append((place, velocity, attitude))
    places, velocities, attitudes = (np.stack(part) for part in zip(*instants, strict=True))
    latitude, longitude, height = places.T
    return Motion(latitude, longitude, height, velocities, attitudes)


def disturbed(seed: int, ideal: Readings, grade: Grade, step: float) -> tuple[Readings, np.ndarray]:
    """Return what sensors of a grade read, and the biases `(t - 1, 6)` of accelerometers (m/s^2) and gyros (rad/s) that they have.

    A bias is what must be added to a reading to get the true value.
    """
    generator = np.random.default_rng(seed)
    count = len(ideal.rate)
    initial = np.repeat([grade.accelerometer_bias, grade.gyro_bias], 3) * generator.standard_normal(6)
    drift = np.repeat([grade.accelerometer_drift, grade.gyro_drift], 3) * np.sqrt(step)
    walk = np.cumsum(generator.standard_normal((count, 6)) * drift, axis=0)
    biases = initial + walk
    white = np.repeat([grade.velocity_random_walk, grade.angle_random_walk], 3) / np.sqrt(step) * generator.standard_normal((count, 6))
    errors = biases + white
    return Readings(ideal.rate - errors[:, 3:], ideal.force - errors[:, :3]), biases


def errors(true: Motion, inertial: Motion) -> np.ndarray:
    """Return the error states of `models.inertial` without biases, `(t, 9)`: psi (rad), velocity (m/s) and position (m).

    Both motions are compared in the NED axes of the place where the inertial system believes to be (the computer's axes), to which the
    psi-angle model refers; attitude errors are therefore free of the part that position errors make.
    """
    meridian, across = radii(true.latitude)
    position = np.stack([
        (true.latitude - inertial.latitude) * (meridian + true.height),
        (true.longitude - inertial.longitude) * (across + true.height) * np.cos(true.latitude),
        inertial.height - true.height,
    ], axis=1)  # fmt: skip
    carried = _axes(inertial) @ np.swapaxes(_axes(true), 1, 2)
    psi = Rotation.from_matrix(inertial.attitude @ np.swapaxes(carried @ true.attitude, 1, 2)).as_rotvec()
    velocity = np.einsum("tij,tj->ti", carried, true.velocity) - inertial.velocity
    return np.concatenate([psi, velocity, position], axis=1)


def _axes(motion: Motion) -> np.ndarray:
    """Rotations from Earth-fixed to NED axes, `(t, 3, 3)`."""
    zero = np.zeros_like(motion.latitude)
    (sin_lat, cos_lat), (sin_lon, cos_lon) = ((np.sin(a), np.cos(a)) for a in (motion.latitude, motion.longitude))
    north = (-sin_lat * cos_lon, -sin_lat * sin_lon, cos_lat)
    rows = [north, (-sin_lon, cos_lon, zero), (-cos_lat * cos_lon, -cos_lat * sin_lon, -sin_lat)]
    return np.moveaxis(np.array(rows), -1, 0)


def _check_motion(velocity: np.ndarray, attitude: np.ndarray, step: float) -> None:
    checks.shape("velocity", velocity, (None, 3))
    checks.shape("attitude", attitude, (len(velocity), 3, 3), "(one rotation per instant)")
    if not 0 < step < np.inf:
        checks.refuse("step", "a positive number of seconds", step)


def _at(motion: Motion, k: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    return np.array([motion.latitude[k], motion.longitude[k], motion.height[k]]), motion.velocity[k], motion.attitude[k]


def _displaced(place: np.ndarray, velocity: np.ndarray, step: float) -> np.ndarray:
    meridian, across = radii(place[0])
    north, east, down = velocity * step
    return place + np.array([north / (meridian + place[2]), east / ((across + place[2]) * np.cos(place[0])), -down])


def _surroundings(place: np.ndarray, velocity: np.ndarray, step: float) -> tuple[np.ndarray, np.ndarray]:
    """Return how the NED axes turn in one step, and the acceleration that is not specific force."""
    earth, transport = earth_rate(place[0]), transport_rate(place[0], place[2], velocity)
    turned = Rotation.from_rotvec(-(earth + transport) * step).as_matrix()
    return turned, np.array([0.0, 0.0, gravity(place[0], place[2])]) - np.cross(2 * earth + transport, velocity)


def _halfway(turn: np.ndarray) -> np.ndarray:
    return Rotation.from_rotvec(Rotation.from_matrix(turn).as_rotvec() / 2).as_matrix()
