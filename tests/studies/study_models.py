"""Small experiments; other processes import this module too."""

import jax.numpy as jnp
import numpy as np

import motes as mo

A = np.array([[0.9, 0.4], [0.0, 0.8]])
Q = np.array([[0.5, 0.1], [0.1, 0.3]])
BLOCKS = {"place": ("a",), "both": ("b", "a")}


def bent(x, u, t):
    return jnp.stack([x[0] + 0.2 * x[0] ** 2, x[0] * x[1]])


def model(gain=1.0, noise=0.4, offsets=(0.1, 0.0)):
    """Two states, a bent sensor with Laplacian noise; the gain is a number, the offsets are an array inside of a function."""
    offsets = jnp.array(offsets)
    return mo.StateSpaceModel(
        mo.Gaussian([1.0, -0.5], [[1.0, 0.3], [0.3, 0.8]]),
        mo.LinearGaussian(A, Q),
        mo.AdditiveNoise(lambda x, u, t: gain * bent(x, u, t) + offsets, mo.Laplace([noise, 0.7])),
        ("a", "b"),
    )


def experiment(runs=10, seed=3, filters=None, **changes):
    filters = filters or {"first": mo.ParticleFilter(n=40), "second": mo.ParticleFilter(n=25, policy=mo.resampling.Always())}
    return mo.Experiment(model(), filters, **({"steps": 7, "runs": runs, "seed": seed, "blocks": BLOCKS} | changes))


def wrong_kind():
    return 3


def many(runs):
    """For other processes, which hand over words."""
    return experiment(runs=int(runs))
