"""cuthbert: JAX, float32, jitted; only the evidence is returned, so that the compiler may drop the histories that its scan stacks."""

import cuthbert
import jax
import jax.numpy as jnp
from cuthbert.gaussian import kalman
from cuthbert.smc import particle_filter
from cuthbertlib.resampling import systematic
from problems import TRACK

from peers import offers
from peers.jax_model import model_functions


def prepare(task):
    offers(task, ("bootstrap", "many", "kalman"))
    ys = jnp.asarray(task["ys"], jnp.float32)
    if task["kind"] == "kalman":
        filter = jax.jit(kalman_evidence)
        return lambda seed: float(filter(ys))
    initial, move, log_density = model_functions(task["model"])

    def once(key):
        filter = particle_filter.build_filter(
            initial, lambda key, x, y: move(key, x), lambda before, x, y: log_density(y, x), task["n"], systematic.resampling
        )
        first, rest = jax.random.split(key)
        # its first measurement comes after the first move; ours measures the initial state, hence the first weights by hand
        start = filter.init_prepare(key=first)
        weights = jax.vmap(lambda x: log_density(ys[0], x))(start.particles)
        start = start._replace(log_weights=weights, log_normalizing_constant=jax.nn.logsumexp(weights) - jnp.log(task["n"]))
        return cuthbert.filter(filter, ys[1:], start, key=rest).log_normalizing_constant[-1]

    if task["kind"] == "many":
        every = jax.jit(jax.vmap(once))
        return lambda seed: float(jnp.mean(every(jax.random.split(jax.random.key(seed), task["runs"]))))
    run = jax.jit(once)
    return lambda seed: float(run(jax.random.key(seed)))


def kalman_evidence(ys):
    A, H, mean = (jnp.asarray(TRACK[name], jnp.float32) for name in ("A", "H", "mean"))
    spread, process, noise = (jnp.diag(jnp.sqrt(jnp.asarray(TRACK[name], jnp.float32))) for name in "PQR")

    def dynamics(entry):
        # the first measurement is of the initial state: stand still once
        first = entry["first"]
        return jnp.where(first, jnp.eye(4), A), jnp.zeros(4), jnp.where(first, 0.0, process)

    filter = kalman.build_filter(mean, spread, dynamics, lambda entry: (H, jnp.zeros(2), noise, entry["y"]))
    entries = {"y": ys, "first": jnp.arange(ys.shape[0]) == 0}
    return cuthbert.filter(filter, entries, filter.init_prepare()).log_normalizing_constant[-1]
