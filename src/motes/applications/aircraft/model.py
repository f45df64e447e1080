"""An aircraft that flies straight or turns, seen by a radar at the origin.

Five states: east and north (m), their velocities (m/s), and the rate of turn (rad/s, counterclockwise). The aircraft flies straight on or
on a circle, with white acceleration on top. While it flies straight the rate of the turn to come is drawn anew at every step, so that on
entering a turn it is that of any turn; in a turn it walks.
"""

from typing import Any

import jax
import jax.numpy as jnp

from motes.core.record import record
from motes.laws.cluttered import Cluttered, room_for
from motes.laws.conditional import AdditiveGaussian
from motes.laws.gaussian import Gaussian
from motes.laws.noise import Uniform
from motes.models.jump_markov import JumpMarkovModel
from motes.models.state_space import StateSpaceModel

STATES = ("east", "north", "v_east", "v_north", "turn")
STRAIGHT, TURN = 0, 1


@record
class Flight:
    """Numbers of the model.

    Attributes:
        straight: intensity of the white acceleration in straight flight, m^2/s^3.
        turning: the same in a turn.
        straight_time: mean duration of straight flight, s.
        turn_time: mean duration of a turn, s.
        rate: standard deviation of the rate of a new turn, rad/s.
        walk: walk of the rate in a turn, rad/s per square root of a second.
    """

    straight: float = 0.1
    turning: float = 1.0
    straight_time: float = 120.0
    turn_time: float = 60.0
    rate: float = 0.035
    walk: float = 0.005


@record
class Radar:
    """What a radar sees.

    Attributes:
        distance: standard deviation of the range, m.
        azimuth: of the azimuth, radians.
        detection: probability that the aircraft gives a plot.
        false: expected number of false plots in a scan; 0 where the tracker gets the aircraft's own plot alone.
        farthest: range to which false plots lie, m.
    """

    distance: float = 30.0
    azimuth: float = 1e-3
    detection: float = 0.95
    false: float = 0.0
    farthest: float = 150e3

    @property
    def room(self) -> int:
        """Plots of a scan that there is room for."""
        return room_for(self.false) + 1

    def sensor(self) -> AdditiveGaussian | Cluttered:
        """Range and azimuth (from east, counterclockwise) of a plot, `(2,)`, or a scan of such."""
        own = AdditiveGaussian(plot, jnp.diag(jnp.array([self.distance**2, self.azimuth**2])), angles=(1,))
        if not self.false:
            return own
        region = Uniform(jnp.array([0.0, -jnp.pi]), jnp.array([self.farthest, jnp.pi]))
        return Cluttered(own, self.detection, clutter=(self.false, region), plots=self.room)


def plot(x: jax.Array, u: Any, t: Any) -> jax.Array:
    """Range and azimuth of the aircraft, `(2,)`."""
    return jnp.stack([jnp.hypot(x[0], x[1]), jnp.arctan2(x[1], x[0])])


def white_acceleration(intensity: float, dt: jax.Array) -> jax.Array:
    """Covariance `(4, 4)` of east, north and their velocities after dt seconds of white acceleration, m^2/s^3."""
    return jnp.kron(intensity * jnp.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]]), jnp.eye(2))


def turned(x: jax.Array, dt: jax.Array) -> jax.Array:
    """East, north and velocities `(4,)` after dt seconds on a circle, at the rate of turn of x `(5,)`."""
    angle = x[4] * dt
    small = jnp.abs(angle) < 1e-3
    safe = jnp.where(small, 1.0, angle)
    along = dt * jnp.where(small, 1 - angle**2 / 6, jnp.sin(safe) / safe)
    across = dt * jnp.where(small, angle / 2, (1 - jnp.cos(safe)) / safe)
    c, s = jnp.cos(angle), jnp.sin(angle)
    return jnp.stack([
        x[0] + along * x[2] - across * x[3],
        x[1] + across * x[2] + along * x[3],
        c * x[2] - s * x[3],
        s * x[2] + c * x[3],
    ])


def constant_velocity(initial: Gaussian, intensity: float, radar: Radar) -> StateSpaceModel:
    """Build the model without turns: four states and white acceleration; inputs are the durations of the steps, s."""

    def f(x: jax.Array, u: Any, t: Any) -> jax.Array:
        return jnp.concatenate([x[:2] + u * x[2:], x[2:]])

    dynamics = AdditiveGaussian(f, lambda x, u, t: white_acceleration(intensity, u))
    return StateSpaceModel(initial, dynamics, radar.sensor(), STATES[:4])


def jumping(initial: Gaussian, flight: Flight, radar: Radar) -> JumpMarkovModel:
    """Build the jump-Markov model; inputs are the durations of the steps, s.

    Args:
        initial: law of east, north and velocities; the aircraft starts in straight flight.
        flight: numbers of the dynamics.
        radar: accuracy of the plots.
    """

    def noise(intensity: float, rate: Any) -> Any:
        def Q(x: jax.Array, u: Any, t: Any) -> jax.Array:
            return jnp.zeros((5, 5)).at[:4, :4].set(white_acceleration(intensity, u)).at[4, 4].set(rate(u))

        return Q

    def straight(x: jax.Array, u: Any, t: Any) -> jax.Array:
        return jnp.concatenate([x[:2] + u * x[2:4], x[2:4], jnp.zeros(1)])

    def turn(x: jax.Array, u: Any, t: Any) -> jax.Array:
        return jnp.concatenate([turned(x, u), x[4:]])

    def transition(u: Any, t: Any) -> jax.Array:
        leave = 1 - jnp.exp(-u / jnp.array([flight.straight_time, flight.turn_time]))
        return jnp.stack([jnp.stack([1 - leave[0], leave[0]]), jnp.stack([leave[1], 1 - leave[1]])])

    wide = jnp.zeros((5, 5)).at[:4, :4].set(initial.cov()).at[4, 4].set(flight.rate**2)
    start = Gaussian(jnp.append(initial.mean(), 0.0), wide)
    modes = (
        AdditiveGaussian(straight, noise(flight.straight, lambda dt: flight.rate**2)),
        AdditiveGaussian(turn, noise(flight.turning, lambda dt: flight.walk**2 * dt)),
    )
    return JumpMarkovModel([1.0, 0.0], transition, tuple(StateSpaceModel(start, mode, radar.sensor(), STATES) for mode in modes))
