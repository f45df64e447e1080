"""A robot that counts its wheels' turns and measures ranges to beacons at known places.

Six states: position (px, py), heading, the gyro's bias, and the scale error and the offset of all ranges.

    heading' = heading + turn - gyro_bias dt + noise
    (px, py)' = (px, py) + forward (cos, sin)(heading + turn / 2) + noise
    range to beacon i = (1 + scale) |(px, py) - beacon i| + offset + noise

Position and heading are nonlinear. The gyro's bias, the scale and the offset are not: they enter linearly once the path is known, so
`mo.structure(model, one step's inputs)` offers them to the Kalman part, and the particles are left with where the robot is.
"""

from statistics import NormalDist
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from motes.core import checks
from motes.core.record import record, replace, static
from motes.core.types import Inputs
from motes.laws.conditional import AdditiveGaussian
from motes.laws.law import Law
from motes.models.state_space import StateSpaceModel

STATES = ("px", "py", "heading", "gyro_bias", "scale", "offset")
CLUTTER = "clutter"
"""A seventh state where ranges have outliers: drawn anew at every step, it says whether a particle takes the step's ranges for some."""


OUTLIER_SD = 10.0
"""Meters."""


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


def rolled(pose: jax.Array, forward: Any, turn: Any) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Return the pose, x, y and heading, after a step of so many meters and radians, which goes by the heading of its middle."""
    course = pose[2] + turn / 2
    return pose[0] + forward * jnp.cos(course), pose[1] + forward * jnp.sin(course), pose[2] + turn


def drive(x: jax.Array, u: Step, t: Any) -> jax.Array:
    """Move the robot by one step of its odometry, `(6,)`, or `(7,)` with outliers."""
    gyro_bias, scale, offset = x[3:6]
    px, py, heading = rolled(x[:3], u.forward, u.turn)
    return jnp.array([
        px,
        py,
        heading - gyro_bias * u.dt,
        gyro_bias,
        scale,
        offset,
        *([0.0] * (len(x) - 6)),
    ])


@record
class DriveNoise:
    """Covariance `(6, 6)`, or `(7, 7)` with outliers, of the noise of a step.

    It grows with time and distance, so a step that is cut in two has the same noise.
    Along and across the course the robot slips alike, so the covariance does not turn with the heading.

    Attributes:
        slip: position, meters per square root of a meter driven.
        jitter: position, meters per square root of a second.
        heading: radians per square root of a second.
        turn: heading, radians per square root of a radian turned.
        gyro: walk of the gyro's bias, radians per second per square root of a second.
        scale: walk of the scale error, a share per square root of a second; particles that carry it need some.
        clutter: whether there is a seventh state, drawn anew at every step.
    """

    slip: float = 0.05
    jitter: float = 0.02
    heading: float = 0.005
    turn: float = 0.02
    gyro: float = 1e-5
    scale: float = 0.0
    clutter: bool = static(default=False)

    def __call__(self, x: jax.Array, u: Step, t: Any) -> jax.Array:
        """Return the covariance for the inputs of one step."""
        position = self.slip**2 * jnp.abs(u.forward) + self.jitter**2 * u.dt
        heading = self.heading**2 * u.dt + self.turn**2 * jnp.abs(u.turn)
        return jnp.diag(jnp.array([position, position, heading, self.gyro**2 * u.dt, self.scale**2 * u.dt, 0, *([1] * self.clutter)]))


@record
class Ranging:
    """Ranges `(b,)` to all beacons, as the radios report them.

    Attributes:
        beacons: places of the beacons, `(b, 2)`, meters.
    """

    beacons: jax.Array

    def __call__(self, x: jax.Array, u: Inputs, t: Any) -> jax.Array:
        """Return the ranges for one state."""
        px, py, _, _, scale, offset = x[:6]
        return (1 + scale) * jnp.hypot(px - self.beacons[:, 0], py - self.beacons[:, 1]) + offset


@record
class OutlierNoise:
    """Covariance `(b, b)` of ranges of which a share are outliers: a mixture of two Gaussians, as the particle's clutter says.

    Each particle weighs the ranges by the law that its clutter has drawn, so that all together weigh them by the mixture.

    Attributes:
        count: number of beacons b.
        usual: standard deviation of a range, meters.
        wide: that of an outlier, meters.
        limit: clutter above it means an outlier.
    """

    count: int = static()
    usual: float = 0.5
    wide: float = 10.0
    limit: float = 1.3

    def __call__(self, x: jax.Array, u: Inputs, t: Any) -> jax.Array:
        """Return the covariance for one state."""
        return jnp.where(x[6] > self.limit, self.wide, self.usual) ** 2 * jnp.eye(self.count)


def range_only_model(beacons: jax.Array, initial: Law, range_sd: float, noise: DriveNoise, outliers: float = 0.0) -> StateSpaceModel:
    """Build the model; its inputs are a `Step`.

    Args:
        beacons: places of the beacons, `(b, 2)`, meters; measurement i is the range to beacon i.
        initial: law of the six states at the start; of seven with outliers.
        range_sd: standard deviation of a range, meters.
        noise: noise of the odometry.
        outliers: share of ranges that are outliers, with a standard deviation of `OUTLIER_SD`.

    Raises:
        MotesError: a piece has the wrong shape, or the share is none below one half.
    """
    ranging = Ranging(jnp.asarray(beacons))
    if outliers == 0:
        sensor = AdditiveGaussian(ranging, range_sd**2 * jnp.eye(len(beacons)))
        return StateSpaceModel(initial, AdditiveGaussian(drive, noise), sensor, STATES)
    checks.above_zero("outliers", outliers, 0.5)
    mixed = OutlierNoise(len(beacons), range_sd, OUTLIER_SD, NormalDist().inv_cdf(1 - outliers))
    dynamics = AdditiveGaussian(drive, replace(noise, clutter=True))
    return StateSpaceModel(initial, dynamics, AdditiveGaussian(ranging, mixed), (*STATES, CLUTTER))
