"""A robot that counts its wheels' turns and measures ranges to beacons at known places.

Six states: position (px, py), heading, the gyro's bias, and the scale error and the offset of all ranges.

    heading' = heading + turn - gyro_bias dt + noise
    (px, py)' = (px, py) + forward (cos, sin)(heading + turn / 2) + noise
    range to beacon i = (1 + scale) |(px, py) - beacon i| + offset + noise

Position and heading are nonlinear. The gyro's bias, the scale and the offset are not: they enter linearly once the path is known, so
`mo.structure(model, one step's inputs)` offers them to the Kalman part, and the particles are left with where the robot is.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from motes.core.record import record
from motes.core.types import Inputs
from motes.laws.conditional import AdditiveGaussian
from motes.laws.law import Law
from motes.models.state_space import StateSpaceModel

STATES = ("px", "py", "heading", "gyro_bias", "scale", "offset")


class Step(NamedTuple):
    """Inputs: what the odometry says of one step (or, with the time axis first, of all).

    Attributes:
        dt: its duration, seconds.
        forward: distance driven, meters.
        turn: change of heading, radians, counterclockwise.
    """

    dt: Any
    forward: Any
    turn: Any


def drive(x: jax.Array, u: Step, t: Any) -> jax.Array:
    """Move the robot by one step of its odometry, `(6,)`."""
    px, py, heading, gyro_bias, scale, offset = x
    course = heading + u.turn / 2
    return jnp.array([
        px + u.forward * jnp.cos(course),
        py + u.forward * jnp.sin(course),
        heading + u.turn - gyro_bias * u.dt,
        gyro_bias,
        scale,
        offset,
    ])


@record
class DriveNoise:
    """Covariance `(6, 6)` of the noise of a step. It grows with time and distance, so a step that is cut in two has the same noise.

    Along and across the course the robot slips alike, so the covariance does not turn with the heading.

    Attributes:
        slip: position, meters per square root of a meter driven.
        jitter: position, meters per square root of a second.
        heading: radians per square root of a second.
        turn: heading, radians per square root of a radian turned.
        gyro: walk of the gyro's bias, radians per second per square root of a second.
    """

    slip: float = 0.05
    jitter: float = 0.02
    heading: float = 0.005
    turn: float = 0.02
    gyro: float = 1e-5

    def __call__(self, x: jax.Array, u: Step, t: Any) -> jax.Array:
        """Return the covariance for the inputs of one step."""
        position = self.slip**2 * jnp.abs(u.forward) + self.jitter**2 * u.dt
        heading = self.heading**2 * u.dt + self.turn**2 * jnp.abs(u.turn)
        return jnp.diag(jnp.array([position, position, heading, self.gyro**2 * u.dt, 0, 0]))


@record
class Ranging:
    """Ranges `(b,)` to all beacons, as the radios report them.

    Attributes:
        beacons: places of the beacons, `(b, 2)`, meters.
    """

    beacons: jax.Array

    def __call__(self, x: jax.Array, u: Inputs, t: Any) -> jax.Array:
        """Return the ranges for one state."""
        px, py, _, _, scale, offset = x
        return (1 + scale) * jnp.hypot(px - self.beacons[:, 0], py - self.beacons[:, 1]) + offset


def range_only_model(beacons: jax.Array, initial: Law, range_sd: float, noise: DriveNoise) -> StateSpaceModel:
    """Build the model; its inputs are a `Step`.

    Args:
        beacons: places of the beacons, `(b, 2)`, meters; measurement i is the range to beacon i.
        initial: law of the six states at the start.
        range_sd: standard deviation of a range, meters.
        noise: noise of the odometry.

    Raises:
        MotesError: a piece has the wrong shape.
    """
    sensor = AdditiveGaussian(Ranging(jnp.asarray(beacons)), range_sd**2 * jnp.eye(len(beacons)))
    return StateSpaceModel(initial, AdditiveGaussian(drive, noise), sensor, STATES)
