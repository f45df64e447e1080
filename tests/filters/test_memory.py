"""Memory of a run does not grow with its length, histories apart: asked of the compiled program, so that nothing is timed or run."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import motes as mo
from motes.core import random
from motes.filters.pair import pair
from motes.filters.run import _run
from motes.tracing.identity import Beside

N = 20_000
SHORT, LONG = 100, 10_000


def turning():
    """Two states whose Kalman part has one covariance per particle."""
    dynamics = mo.AdditiveGaussian(lambda x, u, t: jnp.array([0.9 * x[0] + x[1], (1 + 0.1 * jnp.tanh(x[0])) * x[1]]), np.diag([0.5, 0.1]))
    sensor = mo.AdditiveGaussian(lambda x, u, t: jnp.sin(x[:1]), [[0.1]])
    return mo.StateSpaceModel(mo.Gaussian([0.0, 0.0], np.eye(2)), dynamics, sensor)


@pytest.mark.parametrize("filter", [mo.ParticleFilter(n=N), mo.MarginalizedParticleFilter(n=N)], ids=lambda filter: type(filter).__name__)
def test_memory_does_not_grow_with_steps(filter):
    def working(steps, keep):
        ys = jax.ShapeDtypeStruct((steps, 1), jnp.float32)
        known = pair(filter, turning(), None, jax.ShapeDtypeStruct((1,), jnp.float32))
        lowered = _run.lower(random.as_key(0), known.form, known.parts, ys, None, (keep, Beside(keep)), None)
        return lowered.compile().memory_analysis().temp_size_in_bytes

    short, long = working(SHORT, mo.keep.nothing), working(LONG, mo.keep.nothing)
    # the record of each step is a few numbers, held twice while it is put together; the rest is particles
    records = 2 * len(dataclasses.fields(mo.filters.Info)) * 4 * LONG
    assert short > 2 * N * 4
    assert long - records < 1.2 * short
