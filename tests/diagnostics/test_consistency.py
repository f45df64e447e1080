"""Normalized errors and innovations, bands and coverage, on models where their laws are known."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import motes as mo


def linear(noise=1.0):
    return mo.StateSpaceModel(
        mo.Gaussian([1.0, -0.5], [[2.0, 0.3], [0.3, 0.7]]),
        mo.LinearGaussian([[0.9, 0.6], [-0.2, 0.8]], [[0.8, 0.15], [0.15, 0.3]]),
        mo.LinearGaussian([[1.0, 0.4], [0.3, -1.0]], [[0.6 * noise, 0.1], [0.1, 0.9 * noise]]),
    )


def test_squares_lie_in_their_bands_and_leave_them_where_noise_is_wrong(double):
    """400 runs of 12 steps: averages over runs lie in bands of level 1 - 1e-6 at each step; those of half the sensor noise do not."""
    runs, steps = 400, 12

    def one(key, assumed):
        xs, ys = mo.simulate(key, linear(), steps)
        history = mo.run(key, mo.KalmanFilter(), assumed, ys)
        return mo.diagnostics.nees(history, xs), mo.diagnostics.nis(history), mo.diagnostics.coverage(history, xs, 0.9)

    for assumed, right in ((linear(), True), (linear(0.5), False)):
        states, innovations, covered = jax.vmap(one, in_axes=(0, None))(jax.random.split(jax.random.key(4), runs), assumed)
        for squares in (states, innovations):
            low, high = mo.diagnostics.chi_square_band(2, runs, 1 - 1e-6)
            average = np.asarray(squares).mean(0)[1:]
            assert np.all((low < average) & (average < high)) == right
        share = np.asarray(covered).mean()
        assert (abs(share - 0.9) < 4.9 * np.sqrt(0.09 / runs)) == right


def test_band_by_hand():
    low, high = mo.diagnostics.chi_square_band(1, 1, 0.95)
    assert np.isclose(low, 0.000982069, rtol=1e-5) and np.isclose(high, 5.023886, rtol=1e-5)


def test_angles_and_missing_steps(double):
    model = mo.StateSpaceModel(mo.Gaussian([3.1], [[0.01]]), mo.LinearGaussian([[1.0]], [[0.01]]), mo.LinearGaussian([[1.0]], [[0.01]]))
    history = mo.run(0, mo.KalmanFilter(), model, np.array([[3.1], [np.nan], [3.15]]))
    assert float(mo.diagnostics.nees(history, history.mean - 2 * np.pi, angles=(0,)).max()) < 1e-9
    assert float(mo.diagnostics.nees(history, history.mean - 2 * np.pi).min()) > 100
    assert (
        float(mo.diagnostics.nis(history)[1]) == 0
        and float(mo.diagnostics.nis(history)[0]) == 0
        and float(mo.diagnostics.nis(history)[2]) > 0
    )


@pytest.mark.parametrize(("line", "call"), [
    ("nees truth: expected shape", lambda h: mo.diagnostics.nees(h, np.zeros((2, 2)))),
    ("coverage level: expected a probability", lambda h: mo.diagnostics.coverage(h, h.mean, 95)),
    ("chi_square_band runs: expected", lambda h: mo.diagnostics.chi_square_band(2, 0)),
    ("nis history: expected a run of a Kalman filter",
     lambda h: mo.diagnostics.nis(mo.run(0, mo.ParticleFilter(n=9), linear(), np.zeros((3, 2))))),
])  # fmt: skip
def test_bad_input_is_named(line, call):
    history = mo.run(0, mo.KalmanFilter(), linear(), jnp.zeros((3, 2)))
    with pytest.raises(mo.MotesError, match=line):
        call(history)
