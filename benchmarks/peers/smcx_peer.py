"""smcx: JAX, float32, one outer jit, histories off."""

import jax
import jax.numpy as jnp
import smcx
from problems import TRACK

from peers import offers
from peers.jax_model import model_functions


def prepare(task):
    offers(task, ("bootstrap", "many", "kalman"))
    ys = jnp.asarray(task["ys"], jnp.float32)
    if task["kind"] == "kalman":
        numbers = {name: jnp.asarray(TRACK[name], jnp.float32) for name in TRACK}
        P, Q, R = (jnp.diag(numbers[name]) for name in "PQR")
        filter = jax.jit(lambda ys: smcx.kalman_filter(numbers["mean"], P, numbers["A"], Q, numbers["H"], R, ys).marginal_loglik)
        return lambda seed: float(filter(ys))
    initial, move, log_density = model_functions(task["model"])

    def once(key):
        return smcx.bootstrap_filter(
            key,
            lambda key, n: jax.vmap(initial)(jax.random.split(key, n)),
            move,
            log_density,
            ys,
            task["n"],
            resampling_threshold=1.1,
            store_history=False,
        ).marginal_loglik

    if task["kind"] == "many":
        every = jax.jit(jax.vmap(once))
        return lambda seed: float(jnp.mean(every(jax.random.split(jax.random.key(seed), task["runs"]))))
    run = jax.jit(once)
    return lambda seed: float(run(jax.random.key(seed)))
