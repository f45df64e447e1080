"""A model whose state has its parameters in it, so that particles carry both."""

from typing import Any

import jax
import jax.numpy as jnp

from motes.core import checks, random
from motes.laws.cloud import Cloud
from motes.laws.custom import Custom
from motes.models.state_space import StateSpaceModel, as_state_space
from motes.parameters.posterior import Parametric


def augmented(given: Parametric, thetas: jax.Array, key: jax.Array, deviations: jax.Array) -> StateSpaceModel:
    """Return the model of states (theta, x), theta a random walk.

    Args:
        given: prior, model and measurements.
        thetas: parameters `(p, n)` of n particles at the start; each gets a state from its own model.
        key: for these states.
        deviations: standard deviations of a step of the walk, `(p,)`.
    """
    size, n = thetas.shape

    def of(z: jax.Array) -> StateSpaceModel:
        return as_state_space("parameters", given.model(z[:size]))

    def moved(key: jax.Array, z: jax.Array, u: Any, t: Any) -> jax.Array:
        theta = z[:size] + deviations * random.normal(random.child(key, random.NOISE), (size,), z.dtype)
        model = as_state_space("parameters", given.model(theta))
        x = model.dynamics.sample(random.child(key, random.PREDICT), z[size:, None], u, t)[:, 0]
        return jnp.concatenate([theta, x])

    def log_prob(y: jax.Array, z: jax.Array, u: Any, t: Any) -> jax.Array:
        return of(z).sensor.log_prob(y, z[size:, None], u, t)[0]

    if of(thetas[:, 0]).correlated:
        checks.refuse("parameters model", "measurement noise that is independent of the process noise", "noise_cross_cov",
                      "Use PMMH, particle Gibbs or smc_squared.")
    keys = random.step_keys(key, n)
    X = jax.vmap(lambda key, theta: of(theta).initial.sample(key, 1)[:, 0], in_axes=(0, -1), out_axes=-1)(keys, thetas)
    angles = tuple(size + a for a in of(thetas[:, 0]).circular)
    return StateSpaceModel(Cloud.equal(jnp.concatenate([thetas, X])), Custom(moved, angles=angles), Custom(log_prob=log_prob))
