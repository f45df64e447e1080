"""The marginalized filter as one writes it at first: `jax.vmap` of `jnp.linalg`, arrays (n, k, k), resampling by searchsorted.

The steps are Alg. 1 of Karlsson et al. (2005), as in ours; only the two positions are particles, and nothing else depends on their noise.
"""

import jax
import jax.numpy as jnp
from problems import RADAR

from peers import Unavailable

P_STATES = 2


def turned(position):
    """Rotation of the velocity at a position; see problems.turned."""
    angle = 0.01 * jnp.tanh(position[0] / 1000) + 0.02 * jnp.tanh(position[1] / 1000)
    return jnp.array([[jnp.cos(angle), -jnp.sin(angle)], [jnp.sin(angle), jnp.cos(angle)]])


def prepare(task):
    if task["kind"] != "marginalized":
        raise Unavailable("marginalized filters only")
    n, turning = task["n"], task["model"] == "turning"
    ys, A, mean = (jnp.asarray(value, jnp.float32) for value in (task["ys"], RADAR["A"], RADAR["mean"]))
    Q, R, P = (jnp.diag(jnp.asarray(RADAR[name], jnp.float32)) for name in "QRP")
    A_p, A_k, Q_p, Q_k = A[:P_STATES, P_STATES:], A[P_STATES:, P_STATES:], Q[:P_STATES, :P_STATES], Q[P_STATES:, P_STATES:]

    def log_density(y, position):
        seen = jnp.array([jnp.hypot(position[0], position[1]), jnp.arctan2(position[1], position[0])])
        scaled = jax.scipy.linalg.solve_triangular(jnp.linalg.cholesky(R), y - seen, lower=True)
        return -0.5 * scaled @ scaled - 0.5 * jnp.linalg.slogdet(2 * jnp.pi * R)[1]

    def move(position, center, cov, noise):
        S = A_p @ cov @ A_p.T + Q_p
        expected = position + A_p @ center
        moved = expected + jnp.linalg.cholesky(S) @ noise
        gain = jnp.linalg.solve(S, A_p @ cov).T
        center, cov = center + gain @ (moved - expected), cov - gain @ S @ gain.T
        F = A_k.at[:2].set(turned(position) @ A_k[:2]) if turning else A_k
        return moved, F @ center, F @ cov @ F.T + Q_k

    # one covariance for all where it depends on no particle
    spread = 0 if turning else None
    move_all = jax.vmap(move, in_axes=(0, 0, spread, 0), out_axes=(0, 0, spread))

    def step(carry, entry):
        (positions, centers, covs, log_weights), (y, key) = carry, entry
        first, second = jax.random.split(key)
        edges = jnp.cumsum(jnp.exp(log_weights))
        points = (jax.random.uniform(first) + jnp.arange(n)) / n * edges[-1]
        chosen = jnp.clip(jnp.searchsorted(edges, points), 0, n - 1)
        covs = covs[chosen] if turning else covs
        positions, centers, covs = move_all(positions[chosen], centers[chosen], covs, jax.random.normal(second, (n, P_STATES)))
        return weighed(positions, centers, covs, y)

    def weighed(positions, centers, covs, y):
        likelihood = jax.vmap(log_density, in_axes=(None, 0))(y, positions)
        total = jax.nn.logsumexp(likelihood)
        return (positions, centers, covs, likelihood - total), total - jnp.log(n)

    @jax.jit
    def run(key):
        first, rest = jax.random.split(key)
        positions = mean[:P_STATES] + jax.random.normal(first, (n, P_STATES)) @ jnp.sqrt(P[:P_STATES, :P_STATES])
        cov = P[P_STATES:, P_STATES:]
        carry, evidence = weighed(
            positions, jnp.broadcast_to(mean[P_STATES:], (n, 4)), jnp.broadcast_to(cov, (n, 4, 4)) if turning else cov, ys[0]
        )
        _, more = jax.lax.scan(step, carry, (ys[1:], jax.random.split(rest, ys.shape[0] - 1)))
        return evidence + jnp.sum(more)

    return lambda seed: float(run(jax.random.key(seed)))
