"""Small asymmetric models that the contract is asked on."""

from collections.abc import Callable, Sequence

import jax
import jax.numpy as jnp
import numpy as np

from motes.laws.conditional import LinearGaussian
from motes.laws.custom import Custom
from motes.laws.gaussian import Gaussian
from motes.models.state_space import StateSpaceModel

A = np.array([[0.9, 0.3], [-0.1, 0.7]])
Q = np.array([[0.5, 0.1], [0.1, 0.3]])
H = np.array([[1.0, 0.2], [0.3, -1.0], [0.5, 0.5], [1.0, -0.4], [-0.2, 0.8], [0.7, 0.1]])
R = np.diag([0.5, 0.8, 1.0, 0.6, 1.2, 0.9]) + 0.1


def linear(components: Sequence[int] = (0, 1), scale: float = 1.0) -> StateSpaceModel:
    """Two states, linear-Gaussian.

    Args:
        components: which of six components are measured.
        scale: factor on the measurement noise.
    """
    dtype, rows = jnp.result_type(float), list(components)
    return StateSpaceModel(
        initial=Gaussian(jnp.array([1.0, -0.5], dtype), jnp.array([[2.0, 0.4], [0.4, 1.0]], dtype)),
        dynamics=LinearGaussian(jnp.array(A, dtype), jnp.array(Q, dtype)),
        sensor=LinearGaussian(jnp.array(H[rows], dtype), scale * jnp.array(R[np.ix_(rows, rows)], dtype)),
        names=("a", "b"),
    )


def one_state() -> StateSpaceModel:
    """One state, measured twice at each step."""
    initial = Gaussian(jnp.array([0.5]), jnp.array([[1.0]]))
    dynamics = LinearGaussian(jnp.array([[0.9]]), jnp.array([[0.5]]))
    return StateSpaceModel(initial, dynamics, LinearGaussian(jnp.array([[1.0], [0.5]]), jnp.eye(2)), ("a",))


EXTREME: dict[str, Callable[[jax.Array], jax.Array]] = {
    "ordinary": lambda x: jnp.zeros(()),
    "zero for every state": lambda x: jnp.full((), -jnp.inf),
    "exp(-1e30) for every state": lambda x: jnp.full((), -1e30),
    "infinite for some states": lambda x: jnp.where(x[0] > 1.0, jnp.inf, -1.0),
    "not a number for some states": lambda x: jnp.where(x[0] > 1.0, jnp.nan, -1.0),
}
"""Likelihoods of a state `(x,)`, as their logs."""


def extreme() -> StateSpaceModel:
    """A model whose input is the number of a likelihood of `EXTREME`, which takes the place of the usual one unless it is 0."""
    usual = linear()

    def log_prob(y: jax.Array, x: jax.Array, u: jax.Array, t: jax.Array) -> jax.Array:
        return jnp.stack([-0.5 * jnp.sum((y - x) ** 2), *(found(x) for found in list(EXTREME.values())[1:])])[u.astype(int)]

    return StateSpaceModel(usual.initial, usual.dynamics, Custom(log_prob=log_prob), usual.names)
