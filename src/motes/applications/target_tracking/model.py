"""An aircraft that flies straight or turns, and a radar at the origin that is blind to what flies across its line of sight.

Four states: east and north (m), and their velocities (m/s). Three modes: straight on, a turn to the left, a turn to the right, each with
white acceleration on top. A scan is a set of plots of range, azimuth (from east, counterclockwise) and range rate. The filter that keeps
echoes of the ground out keeps out all that closes or opens as slowly as the ground does, so that the probability of detection falls with
the range rate (Ristic, Arulampalam, Gordon 2004), and a scan without a plot speaks for an aircraft in that notch.
"""

from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp

from motes.applications.aircraft.model import turned, white_acceleration
from motes.applications.target_tracking.settings import Radar
from motes.core.record import record
from motes.laws.cluttered import Cluttered
from motes.laws.conditional import AdditiveGaussian
from motes.laws.gaussian import Gaussian
from motes.laws.noise import Uniform
from motes.models.jump_markov import JumpMarkovModel
from motes.models.state_space import StateSpaceModel

STATES = ("east", "north", "v_east", "v_north")


@record
class Motion:
    """Numbers of the dynamics.

    Attributes:
        straight: intensity of the white acceleration in straight flight, m^2/s^3.
        turning: the same in a turn.
        straight_time: mean duration of straight flight, s.
        turn_time: mean duration of a turn, s.
        rate: rate of a turn, rad/s.
    """

    straight: float = 1.0
    turning: float = 20.0
    straight_time: float = 40.0
    turn_time: float = 20.0
    rate: float = 0.05


def detected(radar: Radar) -> Any:
    """Return the probability that a state `(4,)` gives a plot, a user function."""

    def probability(x: jax.Array, u: Any, t: Any) -> jax.Array:
        return radar.detection * jax.nn.sigmoid((jnp.abs(predicted_plot(x, u, t)[2]) - radar.notch) / radar.edge)

    return probability


def scanned(radar: Radar, plots: int, knows: bool = True) -> Cluttered:
    """Return the sensor of scans.

    Args:
        radar: its numbers.
        plots: most plots of a scan.
        knows: whether the tracker knows of the notch, and not of the probability outside of it alone.
    """
    cov = jnp.diag(jnp.array([radar.distance**2, radar.azimuth**2, radar.rate**2]))
    low, high = jnp.array([0.0, -jnp.pi, -radar.fastest]), jnp.array([radar.farthest, jnp.pi, radar.fastest])
    sensor = AdditiveGaussian(predicted_plot, cov, angles=(1,))
    return Cluttered(sensor, detected(radar) if knows else radar.detection, clutter=(radar.false, Uniform(low, high)), plots=plots)


def predicted_plot(x: jax.Array, u: Any, t: Any) -> jax.Array:
    """Range, azimuth and range rate of a state `(4,)`, `(3,)`."""
    distance = jnp.hypot(x[0], x[1])
    return jnp.stack([distance, jnp.arctan2(x[1], x[0]), (x[0] * x[2] + x[1] * x[3]) / jnp.maximum(distance, 1.0)])


def jumping(initial: Gaussian, motion: Motion, sensor: Cluttered) -> JumpMarkovModel:
    """Build the model; inputs are the durations of the steps, s, as `{"dt": ...}`.

    Args:
        initial: law of the states; the aircraft starts in straight flight.
        motion: numbers of the dynamics.
        sensor: of scans.
    """

    def mode(rate: float, intensity: float) -> AdditiveGaussian:
        def f(x: jax.Array, u: Any, t: Any) -> jax.Array:
            return turned(jnp.append(x, rate), u["dt"])

        return AdditiveGaussian(f, lambda x, u, t: white_acceleration(intensity, u["dt"]))

    def transition(u: Any, t: Any) -> jax.Array:
        leave = 1 - jnp.exp(-u["dt"] / jnp.array([motion.straight_time, motion.turn_time, motion.turn_time]))
        # out of a turn it is straight on
        towards = jnp.array([[0.0, 0.5, 0.5], [1.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
        return jnp.diag(1 - leave) + leave[:, None] * towards

    modes = (mode(0.0, motion.straight), mode(motion.rate, motion.turning), mode(-motion.rate, motion.turning))
    return JumpMarkovModel([1.0, 0.0, 0.0], transition, tuple(StateSpaceModel(initial, each, sensor, STATES) for each in modes))


@dataclass(frozen=True)
class Tracker:
    """Makes the model of a track.

    Attributes:
        radar: its numbers.
        room: most plots of a scan, at least so many as the false ones need (`room_for`).
        knows: see `scanned`.
    """

    radar: Radar
    room: int
    knows: bool = True

    @property
    def sensor(self) -> Cluttered:
        """That of scans."""
        return scanned(self.radar, self.room, self.knows)

    def __call__(self, mean: Any, cov: Any) -> JumpMarkovModel:
        """Return the model of a track that begins with mean `(4,)` and covariance `(4, 4)` of its states."""
        return jumping(Gaussian(mean, cov), Motion(), self.sensor)
