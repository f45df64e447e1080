"""A target on the field, and the bearings from all nodes: one sensor of each, by name."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from network import FIELD, SIGHT, Network

import motes as mo

STATES = ("x", "y", "vx", "vy")
ACCURACY = np.radians(2.0)
"""Standard deviation of a bearing, radians."""
ANYWHERE, SPEED = 50.0, 5.0
"""Standard deviations of the first place and of the first velocity in each direction, meters and meters per second."""
UNREST = 0.3
"""Intensity of the white noise that is the target's acceleration, m^2/s^3; a step is a second."""


def bearing(x: jax.Array, place: jax.Array, t: Any) -> jax.Array:
    """Return the direction in which a node at a place sees the target, `(1,)`."""
    return jnp.arctan2(x[1] - place[1], x[0] - place[0])[None]


def seen_from(place: np.ndarray) -> mo.AdditiveGaussian:
    """Return the sensor of a node at a place."""
    return mo.AdditiveGaussian(lambda x, u, t: bearing(x, place, t), ACCURACY**2 * jnp.eye(1), angles=(0,))


def moving(sensor: Any) -> mo.StateSpaceModel:
    """Return the model of place and velocity with a sensor."""
    start = mo.Gaussian(jnp.array([FIELD / 2, FIELD / 2, 0, 0]), jnp.diag(jnp.array([ANYWHERE, ANYWHERE, SPEED, SPEED]) ** 2))
    one = jnp.eye(2)
    moves = mo.LinearGaussian(jnp.block([[one, one], [0 * one, one]]), UNREST * jnp.block([[one / 3, one / 2], [one / 2, one]]))
    return mo.StateSpaceModel(start, moves, sensor, STATES)


def of_all_nodes(network: Network) -> mo.StateSpaceModel:
    """Return the model of whoever has all bearings: a sensor for each node, by name."""
    return moving(mo.Independent(**{f"node{node}": seen_from(place) for node, place in enumerate(network.places)}))


def of_a_node() -> mo.StateSpaceModel:
    """Return the model of a node, which finds its own place among the inputs."""
    return moving(mo.AdditiveGaussian(bearing, ACCURACY**2 * jnp.eye(1), angles=(0,)))


def worlds(network: Network, seed: int, runs: int, steps: int) -> tuple[jax.Array, jax.Array]:
    """Draw true states `(runs, t, 4)` and bearings `(runs, t, nodes)`, NaN where a node does not see the target."""
    model = of_all_nodes(network)
    xs, ys = jax.vmap(lambda key: mo.simulate(key, model, steps))(jax.random.split(jax.random.key(seed), runs))
    away = jnp.linalg.norm(xs[:, :, None, :2] - jnp.asarray(network.places, xs.dtype), axis=-1)
    return xs, jnp.where(away < SIGHT, ys, jnp.nan)
