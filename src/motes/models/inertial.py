"""Inertial navigation: the Earth, how errors grow (psi-angle model, 15 states), and discretization (Dahia et al. 2004, equations 17 to 19).

Axes are north, east, down (NED). An error is what must be ADDED to the inertial value to get the true one. The states, in order:

    psi  attitude errors about north, east, down, rad          b_a  accelerometer biases, m/s^2
    dV   velocity errors, m/s                                  b_g  gyro biases, rad/s
    dR   position errors, m

    psi' = -(rho + Omega) x psi - eps_g
    dV'  = -psi x f + eps_a + dg - (rho + 2 Omega) x dV
    dR'  = dV - rho x dR

with the specific force f, the Earth's rate Omega, the transport rate rho, eps = C b + white noise (C from body to NED axes), and the change
of gravity dg = (-g/R dR_N, -g/R dR_E, 2 g/R dR_D), which makes horizontal errors swing with the Schuler period and heights unstable.
"""

from typing import Any

import numpy as np
from scipy.linalg import expm

from motes.core import checks
from motes.core.record import record, values

NAMES = (
    "psi_N", "psi_E", "psi_D", "vN", "vE", "vD", "rN", "rE", "rD", "accel_x", "accel_y", "accel_z", "gyro_x", "gyro_y", "gyro_z",
)  # fmt: skip
PSI, VELOCITY, POSITION, ACCELEROMETER, GYRO = (slice(i, i + 3) for i in range(0, 15, 3))

EARTH_RATE = 7.292115e-5
"""Rotation of the Earth, rad/s (WGS 84)."""
SEMI_MAJOR = 6_378_137.0
"""Equatorial radius, m (WGS 84)."""
ECCENTRICITY_SQUARED = 6.69437999014e-3
"""Of the WGS 84 ellipsoid."""

_PER_HOUR = np.pi / 180 / 3600
"""One degree per hour in rad/s."""
_PER_ROOT_HOUR = np.pi / 180 / 60
"""One degree per root hour in rad/sqrt(s)."""
_MICRO_G = 9.80665e-6


@record
class Grade:
    """How good the sensors of an inertial navigation system are; all standard deviations.

    Attributes:
        gyro_bias: rad/s.
        angle_random_walk: white noise of the gyros, rad/sqrt(s).
        accelerometer_bias: m/s^2.
        velocity_random_walk: white noise of the accelerometers, m/s/sqrt(s).
        gyro_drift: random walk of the gyro biases, rad/s/sqrt(s).
        accelerometer_drift: random walk of the accelerometer biases, m/s^2/sqrt(s).
    """

    gyro_bias: float
    angle_random_walk: float
    accelerometer_bias: float
    velocity_random_walk: float
    gyro_drift: float = 0.0
    accelerometer_drift: float = 0.0

    def __post_init__(self) -> None:
        """Refuse what is no standard deviation.

        Raises:
            MotesError: a value is negative or not finite.
        """
        for name, value in values(self).items():
            if checks.is_concrete(value) and not 0 <= value < np.inf:
                checks.refuse(f"Grade {name}", "a standard deviation of at least 0", value)


NAVIGATION = Grade(0.01 * _PER_HOUR, 0.002 * _PER_ROOT_HOUR, 50 * _MICRO_G, 0.01 / 60)
TACTICAL = Grade(1.0 * _PER_HOUR, 0.1 * _PER_ROOT_HOUR, 1000 * _MICRO_G, 0.05 / 60)
CONSUMER = Grade(100.0 * _PER_HOUR, 0.5 * _PER_ROOT_HOUR, 5000 * _MICRO_G, 0.1 / 60)
GRADES = {"navigation": NAVIGATION, "tactical": TACTICAL, "consumer": CONSUMER}
"""Typical sensors: 0.01, 1 and 100 degrees per hour; 50, 1 000 and 5 000 micro-g."""


def radii(latitude: Any) -> tuple[Any, Any]:
    """Return the radii of curvature of the ellipsoid along the meridian and across it, m, at a latitude (or latitudes) in rad."""
    bulge = 1 - ECCENTRICITY_SQUARED * np.sin(latitude) ** 2
    return SEMI_MAJOR * (1 - ECCENTRICITY_SQUARED) / bulge**1.5, SEMI_MAJOR / np.sqrt(bulge)


def gravity(latitude: float, height: float = 0.0) -> float:
    """Return normal gravity, m/s^2 (Somigliana's formula, reduced with the square of the distance from the Earth's center).

    Args:
        latitude: rad.
        height: m above the ellipsoid.
    """
    square = np.sin(latitude) ** 2
    on_ground = 9.7803253359 * (1 + 0.00193185265241 * square) / np.sqrt(1 - ECCENTRICITY_SQUARED * square)
    return on_ground * (SEMI_MAJOR / (SEMI_MAJOR + height)) ** 2


def earth_rate(latitude: float) -> np.ndarray:
    """Return the Earth's rotation in NED axes `(3,)`, rad/s, at a latitude in rad."""
    return EARTH_RATE * np.array([np.cos(latitude), 0.0, -np.sin(latitude)])


def transport_rate(latitude: float, height: float, velocity: np.ndarray) -> np.ndarray:
    """Return the rotation of the NED axes `(3,)`, rad/s, that comes from moving over the round Earth.

    Args:
        latitude: rad.
        height: m.
        velocity: north, east, down `(3,)`, m/s.
    """
    meridian, across = radii(latitude)
    north, east = velocity[0] / (meridian + height), velocity[1] / (across + height)
    return np.array([east, -north, -east * np.tan(latitude)])


def cross_matrix(v: np.ndarray) -> np.ndarray:
    """Return the matrix `(3, 3)` that takes a vector w to v x w."""
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])


def error_growth(
    latitude: float, height: float, velocity: np.ndarray, force: np.ndarray, attitude: np.ndarray, time_constant: float = np.inf
) -> np.ndarray:
    """Return the matrix F `(15, 15)` of the error model x' = F x + noise.

    Args:
        latitude: rad.
        height: m above the ellipsoid.
        velocity: north, east, down `(3,)`, m/s.
        force: specific force in NED axes `(3,)`, m/s^2; (0, 0, -g) in level flight at constant velocity.
        attitude: rotation from body to NED axes `(3, 3)`.
        time_constant: of the biases (first-order Gauss-Markov), s; infinite for biases that are constant or walk.
    """
    earth, transport = earth_rate(latitude), transport_rate(latitude, height, velocity)
    stiffness = gravity(latitude, height) / (SEMI_MAJOR + height)
    F = np.zeros((15, 15))
    F[PSI, PSI] = -cross_matrix(transport + earth)
    F[PSI, GYRO] = -attitude
    F[VELOCITY, PSI] = cross_matrix(force)
    F[VELOCITY, VELOCITY] = -cross_matrix(transport + 2 * earth)
    F[VELOCITY, POSITION] = np.diag([-stiffness, -stiffness, 2 * stiffness])
    F[VELOCITY, ACCELEROMETER] = attitude
    F[POSITION, VELOCITY] = np.eye(3)
    F[POSITION, POSITION] = -cross_matrix(transport)
    F[ACCELEROMETER, ACCELEROMETER] = F[GYRO, GYRO] = -np.eye(3) / time_constant
    return F


def error_noise(grade: Grade, position: float = 0.0) -> np.ndarray:
    """Return the intensity `(15, 15)` of the white noise that drives the error model, in the squared units of each state per second.

    Args:
        grade: the sensors; those of one kind are equally noisy about all axes, so that the attitude does not matter.
        position: noise straight on the position, m/sqrt(s). No inertial system has it: it stands for what map and model leave out.
    """
    each = (grade.angle_random_walk, grade.velocity_random_walk, position, grade.accelerometer_drift, grade.gyro_drift)
    return np.diag(np.repeat(np.square(each), 3))


def discretized(F: np.ndarray, noise: np.ndarray, step: float) -> tuple[np.ndarray, np.ndarray]:
    """Return transition matrix and covariance, both `(x, x)` in float64, of x' = F x + white noise over one step, exactly (Van Loan 1978).

    Args:
        F: `(x, x)`, 1/s.
        noise: intensity of the noise, `(x, x)`.
        step: s.
    """
    blocks = expm(np.block([[-F, noise], [np.zeros_like(F), F.T]]) * step)
    n = F.shape[0]
    transition = blocks[n:, n:].T
    covariance = transition @ blocks[:n, n:]
    return transition, 0.5 * (covariance + covariance.T)
