"""Two tanks one below the other: a pump fills the upper one, which runs into the lower one, which runs out; both can overflow.

With levels x1 and x2 in volts, the pump's voltage u, and c(x) = x held between 0 and 10 V (the height of a tank):

    x1' = c(x1) - k1 sqrt c(x1) + k4 u
    x2' = c(x2) + k2 sqrt c(x1) - k3 sqrt c(x2) + k5 (x1 - c(x1))       y = c(x2) + noise

What is over the brim of the upper tank, x1 - c(x1), is left over for one step, of which the lower tank gets the share k5. So written, all
five parameters are linear given the levels.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

import motes as mo

NAMES = ("upper", "lower", "k1", "k2", "k3", "k4", "k5")
PRIOR, PRIOR_SD = np.array([0.2, 0.2, 0.2, 0.2, 1.0]), np.array([0.1, 0.1, 0.1, 0.1, 1.0])
MADE_UP, MADE_UP_LEVEL = np.array([0.24, 0.14, 0.14, 0.2, 0.9]), 5.0
"""Parameters and first levels of the tanks that are simulated."""
MEASURED = 0.05
"""Standard deviation of the measured level, V."""


class Recording(NamedTuple):
    """Voltages of the pump and levels of the lower tank, `(t,)` each: of the half to learn from, and of the half to foretell."""

    u: np.ndarray
    y: np.ndarray
    u_test: np.ndarray
    y_test: np.ndarray


def recorded(path):
    """Read the recording: columns uEst, uVal, yEst, yVal."""
    u, u_test, y, y_test = np.loadtxt(path, delimiter=",", skiprows=1, usecols=range(4), dtype=np.float32).T
    return Recording(u, y, u_test, y_test)


def made_up(steps=1024, seed=0):
    """Simulate tanks of the same kind, pumped by sinusoids of random phases."""
    rng, found = np.random.default_rng(seed), []
    turns = 2 * np.pi * np.arange(1, 13)[:, None] * np.arange(steps) / 1024
    for _ in range(2):
        waves = np.cos(turns + rng.uniform(0, 2 * np.pi, (12, 1))).sum(axis=0)
        u = np.clip(2.8 + 1.4 * waves / waves.std(), 0.4, 6.5)
        y = simulated(MADE_UP, MADE_UP_LEVEL, MADE_UP_LEVEL, u) + MEASURED * rng.normal(size=steps)
        found += [u.astype(np.float32), np.asarray(y, np.float32)]
    return Recording(*found)


def held(level):
    """Level in a tank; the least is above zero, where the root has no slope."""
    return jnp.clip(level, 0.01, 10.0)


def moved(x1, x2, k, u):
    """Levels after one step."""
    upper, lower = held(x1), held(x2)
    over = x1 - jnp.minimum(x1, 10.0)
    return upper - k[0] * jnp.sqrt(upper) + k[3] * u, lower + k[1] * jnp.sqrt(upper) - k[2] * jnp.sqrt(lower) + k[4] * over


@jax.jit
def simulated(k, x1, x2, u):
    """Return levels of the lower tank `(t,)` from parameters `(5,)`, first levels and pump voltages `(t,)` alone."""

    def step(levels, voltage):
        return moved(*levels, k, voltage), held(levels[1])

    return jax.lax.scan(step, (jnp.float32(x1), jnp.float32(x2)), jnp.asarray(u, jnp.float32))[1]


def tanks(first, walk, noise, capped="sensor"):
    """Return the model of levels and parameters.

    Args:
        first: first measured level.
        walk: standard deviation of a parameter's step, in those of its prior; 0 for constants.
        noise: standard deviation of what moves the levels beside the pump, V.
        capped: where the lower level is held at the brim: in the "sensor", which leaves the parameters linear, or in the "dynamics", for
            filters that linearize and would see no slope of a sensor at its stop.
    """

    def dynamics(x, u, t):
        x1, x2 = moved(x[0], x[1], x[2:], u)
        return jnp.concatenate([jnp.stack([x1, held(x2) if capped == "dynamics" else x2]), x[2:]])

    def sensor(x, u, t):
        return held(x[1:2]) if capped == "sensor" else x[1:2]

    start = mo.Gaussian(jnp.array([5.0, first, *PRIOR]), jnp.diag(jnp.array([2.0, 0.1, *PRIOR_SD]) ** 2))
    moves = jnp.diag(jnp.array([noise, noise, *(walk * PRIOR_SD)]) ** 2)
    return mo.StateSpaceModel(start, mo.AdditiveGaussian(dynamics, moves), mo.AdditiveGaussian(sensor, MEASURED**2 * jnp.eye(1)), NAMES)
