"""dynamax: JAX, float32, jitted; Kalman filter only."""

import jax
import jax.numpy as jnp
from dynamax.linear_gaussian_ssm.inference import lgssm_filter, make_lgssm_params
from problems import TRACK

from peers import Unavailable


def prepare(task):
    if task["kind"] != "kalman":
        raise Unavailable("has no particle filter for general models")
    numbers = {name: jnp.asarray(TRACK[name], jnp.float32) for name in TRACK}
    P, Q, R = (jnp.diag(numbers[name]) for name in "PQR")
    parameters, ys = make_lgssm_params(numbers["mean"], P, numbers["A"], Q, numbers["H"], R), jnp.asarray(task["ys"], jnp.float32)
    filter = jax.jit(lambda ys: lgssm_filter(parameters, ys).marginal_loglik)
    return lambda seed: float(filter(ys))
