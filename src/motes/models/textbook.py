"""Small models to begin with: those that papers share, with the numbers that they leave open filled in."""

import jax
import jax.numpy as jnp
import numpy as np

from motes.laws.conditional import AdditiveGaussian, LinearGaussian
from motes.laws.gaussian import Gaussian
from motes.models.jump_markov import JumpMarkovModel
from motes.models.state_space import StateSpaceModel


def constant_velocity(period: float = 1.0, acceleration: float = 0.1) -> StateSpaceModel:
    """A point of nearly constant velocity in the plane, its position measured: linear and Gaussian, so that `KalmanFilter` is exact.

    Position and velocity along two axes: m, m/s. Each axis is driven by white noise of acceleration (Bar-Shalom, Li, Kirubarajan 2001,
    section 6.2.2), and measured with a standard deviation of 1 m.

    Args:
        period: seconds between measurements.
        acceleration: spectral density of its square, m^2/s^3.
    """
    A = np.eye(4) + period * np.eye(4, k=2)
    Q = acceleration * np.kron([[period**3 / 3, period**2 / 2], [period**2 / 2, period]], np.eye(2))
    kind = jnp.result_type(float)
    return StateSpaceModel(
        Gaussian(jnp.zeros(4), jnp.diag(jnp.array([10.0, 10, 1, 1]))),
        LinearGaussian(jnp.asarray(A, kind), jnp.asarray(Q, kind)),
        LinearGaussian(jnp.eye(2, 4), jnp.eye(2)),
        ("px", "py", "vx", "vy"),
    )


def maneuvers(period: float = 1.0) -> JumpMarkovModel:
    """A target that flies straight and now and then maneuvers: a jump-Markov system of two modes of `constant_velocity`.

    The second mode has 400 times the noise of acceleration; a maneuver begins with probability 0.05 in a step and ends with 0.2.

    Args:
        period: seconds between measurements.
    """
    calm, wild = constant_velocity(period, 0.01), constant_velocity(period, 4.0)
    return JumpMarkovModel(jnp.array([0.8, 0.2]), jnp.array([[0.95, 0.05], [0.2, 0.8]]), (calm, wild))


def radar_tracking(period: float = 0.5) -> StateSpaceModel:
    """An aircraft of constant acceleration, seen by a radar in range and azimuth (Karlsson, Schon, Gustafsson 2005, equation 13).

    Position, velocity and acceleration along two axes: m, m/s, m/s^2. The paper prints neither period nor start; these are a target some
    hundred meters away, where the azimuth of 1 mrad is sharp.

    Args:
        period: seconds between measurements.
    """
    A = np.eye(6)
    for axis in (0, 1):
        A[axis, axis + 2] = A[axis + 2, axis + 4] = period
        A[axis, axis + 4] = period**2 / 2

    def radar(x: jax.Array, u: None, t: jax.Array) -> jax.Array:
        return jnp.stack([jnp.hypot(x[0], x[1]), jnp.arctan2(x[1], x[0])])

    def diagonal(*variances: float) -> jax.Array:
        return jnp.diag(jnp.array(variances))

    return StateSpaceModel(
        Gaussian(jnp.array([300.0, 300, 5, -5, 0, 0]), diagonal(4, 4, 16, 16, 0.04, 0.04)),
        LinearGaussian(jnp.asarray(A, jnp.result_type(float)), diagonal(1, 1, 1, 1, 0.01, 0.01)),
        AdditiveGaussian(radar, diagonal(100, 1e-6), angles=(1,)),
        ("px", "py", "vx", "vy", "ax", "ay"),
    )


def growth() -> StateSpaceModel:
    """The growth model, bimodal and strongly nonlinear: x' = x/2 + 25 x/(1 + x^2) + 8 cos(1.2 t) + N(0, 10), y = x^2/20 + N(0, 1).

    x_0 has the law N(0, 5); papers differ in that and in the phase of the cosine.
    """
    return StateSpaceModel(
        Gaussian(jnp.zeros(1), 5 * jnp.eye(1)),
        AdditiveGaussian(lambda x, u, t: x / 2 + 25 * x / (1 + x**2) + 8 * jnp.cos(1.2 * t), 10 * jnp.eye(1)),
        AdditiveGaussian(lambda x, u, t: x**2 / 20, jnp.eye(1)),
    )
