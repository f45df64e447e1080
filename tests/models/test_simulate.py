"""Drawing trajectories."""

import jax.numpy as jnp
import numpy as np

import motes as mo


def test_second_simulation_does_not_trace_again():
    traced = []

    def sensor(x, u, t):
        traced.append(1)
        return x + 1

    def model():
        law = mo.Gaussian(jnp.zeros(1), jnp.eye(1))
        return mo.StateSpaceModel(law, mo.LinearGaussian(jnp.eye(1), jnp.eye(1)), mo.AdditiveGaussian(sensor, jnp.eye(1)))

    first, _ = mo.simulate(0, model(), 5)
    per_call = len(traced)
    traced.clear()
    second, _ = mo.simulate(1, model(), 5)
    # checks of shapes trace the sensor at each call; compiling would add to them
    assert len(traced) < per_call
    again, _ = mo.simulate(0, model(), 5)
    np.testing.assert_array_equal(first, again)
    assert (np.asarray(first) != np.asarray(second)).all()


def test_filter_with_the_same_seed_does_not_know_the_truth():
    law = mo.Gaussian(jnp.zeros(2), jnp.eye(2))
    model = mo.StateSpaceModel(law, mo.LinearGaussian(jnp.eye(2), jnp.eye(2)), mo.LinearGaussian(jnp.eye(2), jnp.eye(2)))
    xs, ys = mo.simulate(0, model, 3)
    history = mo.run(0, mo.ParticleFilter(n=50, policy=mo.resampling.Never()), model, ys, keep=mo.keep.laws)
    distance = np.abs(np.asarray(history.law.particles) - np.asarray(xs)[:, :, None]).max(axis=1)
    assert distance.min() > 1e-4
