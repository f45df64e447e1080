"""A robot in the plane among landmarks that it does not know, in the frame of its start.

By ranges: states are place, heading and the bias of the gyro; a beacon is a place and the logarithm of the scale by which its ranges are
too long. At the first range it may be anywhere on a ring, which is a mixture of Gaussians.

By places: states are place, heading, and two errors of the odometry: a drift of the heading with the way, and a share of each turn. A
landmark is a place, seen ahead and to the left of the robot.
"""

from math import pi
from typing import Any

import jax
import jax.numpy as jnp

from motes.applications.robot.model import DriveNoise, drive
from motes.applications.robot.scenario import RANGE_SD, START_SD
from motes.core.record import record, static
from motes.laws.conditional import AdditiveGaussian
from motes.laws.gaussian import Gaussian
from motes.laws.mixture import Mixture
from motes.models.map_model import MapModel

START = 1e-4
"""Standard deviation of the start, meters and radians: it is where the map begins."""
SPACING = 0.6
"""Tangential standard deviation of a Gaussian of a ring, as a share of the way to its neighbor."""
PLACE_SD = 0.45
"""Of a sighting, meters."""
OUTLIERS = (1e-3, 1e-3)
"""Share of sightings that are of something else, and their density, one in 1 000 square meters."""
AHEAD_SD, ACROSS_SD, TURN_SD = 0.03, 0.01, 0.004
"""Noise of a step of the odometry, meters and radians."""
DRIFT_SD, TURN_SHARE_SD = 2e-3, 0.02
"""Of its errors: radians per meter, and a share of each turn."""


def ranging(beacons: int, gaussians: int, scale: float, range_sd: float = RANGE_SD) -> MapModel:
    """Build the model by ranges; its inputs are those of the robot among known beacons, a `Step`.

    Args:
        beacons: how many there are.
        gaussians: of a ring.
        scale: standard deviation of the scale error of ranges.
        range_sd: that of a range, meters.
    """
    noise = DriveNoise()

    def move(x: jax.Array, u: Any, t: Any) -> jax.Array:
        return drive(jnp.concatenate([x, jnp.zeros(2, x.dtype)]), u, t)[:4]

    initial = Gaussian(jnp.zeros(4), jnp.diag(jnp.array([START, START, START, START_SD[3]])) ** 2)
    dynamics = AdditiveGaussian(move, lambda x, u, t: noise(x, u, t)[:4, :4], angles=(2,))
    return MapModel(initial, dynamics, _range, [[range_sd**2]], birth=Ring(gaussians, scale, range_sd), landmarks=beacons,
                    linear=("gyro_bias",), names=("px", "py", "heading", "gyro_bias"))  # fmt: skip


def _range(x: jax.Array, beacon: jax.Array, u: Any, t: Any) -> jax.Array:
    return jnp.exp(beacon[2]) * jnp.hypot(beacon[0] - x[0], beacon[1] - x[1])[None]


@record
class Ring:
    """The law of a beacon at its first range: place and log scale, a mixture of Gaussians on a ring about the robot.

    Attributes:
        count: of the Gaussians.
        scale: standard deviation of the log scale.
        range_sd: of a range, meters.
    """

    count: int = static()
    scale: float
    range_sd: float

    def __call__(self, x: jax.Array, z: jax.Array) -> Mixture:
        """Return it for a state and a range."""
        angles = 2 * pi / self.count * jnp.arange(self.count)
        c, s = jnp.cos(angles), jnp.sin(angles)
        none, one = jnp.zeros_like(c), jnp.ones_like(c)
        # along the ring, across it, and the scale: what is too long lies nearer
        radial = self.range_sd**2 + (z[0] * self.scale) ** 2
        P = jnp.array([
            [radial, 0, -z[0] * self.scale**2],
            [0, (SPACING * 2 * pi / self.count * z[0]) ** 2, 0],
            [-z[0] * self.scale**2, 0, self.scale**2],
        ])
        turn = jnp.stack([jnp.stack([c, -s, none]), jnp.stack([s, c, none]), jnp.stack([none, none, one])])
        means = jnp.stack([x[0] + z[0] * c, x[1] + z[0] * s, none])
        return Mixture(Gaussian(means, jnp.einsum("ijn,jk,lkn->iln", turn, P, turn)), -jnp.log(self.count) * one)


def seeing(landmarks: int) -> MapModel:
    """Build the model by places; its inputs are `(3,)`: meters ahead and to the left, and the turn in radians, of a step.

    Args:
        landmarks: how many there are.
    """
    deviations = jnp.array([START, START, START, DRIFT_SD, TURN_SHARE_SD])
    return MapModel(
        Gaussian(jnp.zeros(5), jnp.diag(deviations**2)), AdditiveGaussian(_driven, _driven_cov, angles=(2,)), _place,
        PLACE_SD**2 * jnp.eye(2), birth=_placed, landmarks=landmarks, linear=("drift", "turn_share"), outliers=OUTLIERS,
        names=("px", "py", "heading", "drift", "turn_share"),
    )  # fmt: skip


def turned(angle: jax.Array) -> jax.Array:
    """Rotation by an angle, `(2, 2)`."""
    c, s = jnp.cos(angle), jnp.sin(angle)
    return jnp.stack([jnp.stack([c, -s]), jnp.stack([s, c])])


def _driven(x: jax.Array, u: jax.Array, t: Any) -> jax.Array:
    turn = u[2] * (1 + x[4]) + x[3] * jnp.hypot(u[0], u[1])
    return jnp.concatenate([x[:2] + turned(x[2]) @ u[:2], x[2:3] + turn, x[3:]])


def _driven_cov(x: jax.Array, u: jax.Array, t: Any) -> jax.Array:
    turn = turned(x[2])
    place = turn @ jnp.diag(jnp.array([AHEAD_SD**2, ACROSS_SD**2])) @ turn.T
    return jnp.zeros((5, 5)).at[:2, :2].set(place).at[2, 2].set(TURN_SD**2)


def _place(x: jax.Array, landmark: jax.Array, u: Any, t: Any) -> jax.Array:
    return turned(x[2]).T @ (landmark - x[:2])


def _placed(x: jax.Array, z: jax.Array) -> Gaussian:
    return Gaussian(x[:2] + turned(x[2]) @ z, PLACE_SD**2 * jnp.eye(2))
