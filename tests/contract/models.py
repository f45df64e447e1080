"""Small asymmetric models for the contract suite."""

import jax.numpy as jnp
import numpy as np

import motes as mo

A = np.array([[0.9, 0.3], [-0.1, 0.7]])
Q = np.array([[0.5, 0.1], [0.1, 0.3]])
H6 = np.array([[1.0, 0.2], [0.3, -1.0], [0.5, 0.5], [1.0, -0.4], [-0.2, 0.8], [0.7, 0.1]])
R6 = np.diag([0.5, 0.8, 1.0, 0.6, 1.2, 0.9]) + 0.1


def linear(components=(0, 1), dtype=None, scale=1.0):
    """Two states, linear-Gaussian, measuring some of six components."""
    dtype = dtype or jnp.result_type(float)
    rows = list(components)
    return mo.StateSpaceModel(
        initial=mo.Gaussian(jnp.array([1.0, -0.5], dtype), jnp.array([[2.0, 0.4], [0.4, 1.0]], dtype)),
        dynamics=mo.LinearGaussian(jnp.array(A, dtype), jnp.array(Q, dtype)),
        sensor=mo.LinearGaussian(jnp.array(H6[rows], dtype), scale * jnp.array(R6[np.ix_(rows, rows)], dtype)),
        names=("a", "b"),
    )
