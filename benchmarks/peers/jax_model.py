"""The models as the JAX peers want them: functions of one key and one state."""

import jax
import jax.numpy as jnp
import numpy as np
from problems import LINE, RADAR


def model_functions(model):
    """Return `initial(key)`, `move(key, x)` and `log_density(y, x)` of a model, made afresh."""
    if model == "line":
        mean, spread, noise = (jnp.full(1, value, jnp.float32) for value in (LINE["mean"], LINE["variance"] ** 0.5, LINE["q"] ** 0.5))
        A, R = jnp.full((1, 1), LINE["a"], jnp.float32), jnp.full(1, LINE["r"], jnp.float32)
        measure = lambda x: x  # noqa: E731
    else:
        mean, spread, noise = (jnp.asarray(value, jnp.float32) for value in (RADAR["mean"], np.sqrt(RADAR["P"]), np.sqrt(RADAR["Q"])))
        A, R = jnp.asarray(RADAR["A"], jnp.float32), jnp.asarray(RADAR["R"], jnp.float32)
        measure = lambda x: jnp.array([jnp.hypot(x[0], x[1]), jnp.arctan2(x[1], x[0])])  # noqa: E731
    constant = -0.5 * jnp.sum(jnp.log(2 * jnp.pi * R))

    def initial(key):
        return mean + spread * jax.random.normal(key, mean.shape)

    def move(key, x):
        return A @ x + noise * jax.random.normal(key, mean.shape)

    def log_density(y, x):
        return constant - 0.5 * jnp.sum((y - measure(x)) ** 2 / R)

    return initial, move, log_density
