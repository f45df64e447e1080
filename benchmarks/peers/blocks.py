"""Building blocks: `motes.core` (particle axis last), `jax.numpy` (particle axis first), and written out by hand, entry by entry."""

import jax
import jax.numpy as jnp
import numpy as np

from motes.core import linalg, random
from peers import offers


def product_by_hand(a, b):
    size = range(len(a))
    return jnp.stack([jnp.stack([sum(a[i, j] * b[j, k] for j in size) for k in size]) for i in size])


def cholesky_by_hand(a):
    size, L = len(a), {}
    for j in range(size):
        L[j, j] = jnp.sqrt(a[j, j] - sum(L[j, k] * L[j, k] for k in range(j)))
        for i in range(j + 1, size):
            L[i, j] = (a[i, j] - sum(L[i, k] * L[j, k] for k in range(j))) / L[j, j]
    zero = jnp.zeros_like(a[0, 0])
    return jnp.stack([jnp.stack([L.get((i, j), zero) for j in range(size)]) for i in range(size)])


def solve_lower_by_hand(lower, b):
    z = []
    for i in range(len(b)):
        z.append((b[i] - sum(lower[i, j] * z[j] for j in range(i))) / lower[i, i])
    return jnp.stack(z)


def sandwich_by_hand(a, p):
    return product_by_hand(product_by_hand(a, p), jnp.swapaxes(a, 0, 1))


WAYS = {
    "core": {"product": linalg.product, "cholesky": linalg.cholesky, "solve_lower": linalg.solve_lower, "sandwich": linalg.sandwich},
    "hand": {
        "product": product_by_hand,
        "cholesky": cholesky_by_hand,
        "solve_lower": solve_lower_by_hand,
        "sandwich": sandwich_by_hand,
    },
    "library": {
        "product": jnp.matmul,
        "cholesky": jnp.linalg.cholesky,
        "solve_lower": jax.vmap(lambda lower, b: jax.scipy.linalg.solve_triangular(lower, b, lower=True)),
        "sandwich": jax.vmap(lambda a, p: a @ p @ a.T),
    },
}


def timed(work, times, value, *operands):
    """Make a job that calls a compiled function so many times; its value is taken once, so that only the work itself is timed."""
    work = jax.jit(work)
    result = float(value(work(*operands)))

    def job(seed):
        for _ in range(times):
            jax.block_until_ready(work(*operands))
        return result

    return job


def prepare(task, way):
    offers(task, ("block",))
    n, size, operation = task["n"], task["size"], task["model"]
    if operation == "normal":
        draw = random.normal if way == "core" else jax.random.normal
        # two digits of the standard deviation: the streams differ, their law does not
        spread = lambda drawn: jnp.round(jnp.std(drawn), 2)  # noqa: E731
        return timed(lambda seed: draw(jax.random.key(seed), (n,), jnp.float32), task["runs"], spread, 0)
    values = np.random.default_rng(0).standard_normal((2, n, size, size)).astype(np.float32)
    positive = values[0] @ values[0].swapaxes(1, 2) + 3 * np.eye(size, dtype=np.float32)
    vector = values[1][:, :, 0]
    operands = {
        "product": (values[0], values[1]),
        "cholesky": (positive,),
        "solve_lower": (np.linalg.cholesky(positive), vector),
        "sandwich": (values[0], positive),
    }[operation]
    last = way != "library"
    operands = [jnp.asarray(np.ascontiguousarray(np.moveaxis(operand, 0, -1)) if last else operand) for operand in operands]
    return timed(WAYS[way][operation], task["runs"], jnp.mean, *operands)
