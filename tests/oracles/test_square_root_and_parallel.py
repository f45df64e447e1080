"""The two other forms of the Kalman filter give what the Kalman filter gives, and the factored one keeps its digits."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import motes as mo

pytestmark = pytest.mark.jax


def model(cross_cov=None):
    """Three states, time-varying dynamics driven by inputs, two measured components, one with a singular process noise."""
    def dynamics(x, u, t):
        return jnp.array([[1.0, 0.3, 0.0], [-0.2, 0.9, 0.1], [0.0, 0.0, 0.97]]) @ x + u * jnp.array([0.1, 0.0, 0.2]) + 0.05 * t

    sensor = mo.LinearGaussian([[1.0, 0.0, 0.4], [0.2, 1.0, 0.0]], [[0.5, 0.1], [0.1, 0.8]])
    start = mo.Gaussian([1.0, 0.0, -0.5], np.diag([2.0, 0.5, 1.0]))
    return mo.StateSpaceModel(start, mo.AdditiveGaussian(dynamics, np.diag([0.3, 0.1, 0.0])), sensor, noise_cross_cov=cross_cov)


INPUTS = np.sin(np.arange(23.0))


def data(model):
    ys = np.array(mo.simulate(3, model, 23, INPUTS)[1])
    ys[4] = np.nan
    ys[9, 1] = ys[17, 0] = np.nan
    return ys


def same(found, wanted, tolerance=1e-9):
    for name in ("mean", "cov", "log_evidence", "log_likelihood"):
        assert np.allclose(getattr(found, name), getattr(wanted, name), rtol=tolerance, atol=tolerance), name
    assert np.allclose(found.info.shortfall, wanted.info.shortfall, rtol=tolerance, atol=tolerance)


@pytest.mark.parametrize("cross", [
    pytest.param(None, marks=pytest.mark.night), [[0.05, 0.02], [0.0, -0.03], [0.0, 0.0]]], ids=["independent", "correlated noises"])
def test_both_forms_equal_the_kalman_filter(cross, double):
    given = model(cross)
    ys = data(given)
    wanted = mo.run(0, mo.KalmanFilter(), given, ys, INPUTS)
    same(mo.run(0, mo.SquareRootKalmanFilter(), given, ys, INPUTS), wanted)
    parallel = mo.filters.run_in_parallel(given, ys, INPUTS)
    same(parallel, wanted)
    more = mo.run(0, mo.KalmanFilter(), given, ys[:5], INPUTS[:5], after=parallel)
    assert int(more.last.step) == 27 and float(more.log_likelihood) < float(parallel.log_likelihood)


def test_the_factor_keeps_its_digits_in_float32():
    """A sharp sensor on a poorly known state: the Kalman filter in float32 errs visibly, the factored one does not."""
    step = mo.LinearGaussian([[1.0, 1.0], [0.0, 1.0]], np.diag([1e-7, 1e-7]))
    scaled = mo.StateSpaceModel(mo.Gaussian([0.0, 0.0], np.diag([1e4, 1e4])), step, mo.LinearGaussian([[1.0, 0.0]], [[1e-4]]))
    ys = 1e-2 * np.arange(12.0)[:, None]
    with jax.enable_x64(True):
        wide = jax.tree.map(lambda leaf: jnp.asarray(leaf, jnp.float64), scaled)
        exact = np.asarray(mo.run(0, mo.KalmanFilter(), wide, ys).cov)
    errors = []
    for filter in (mo.KalmanFilter(), mo.SquareRootKalmanFilter()):
        cov = np.asarray(mo.run(0, filter, scaled, ys).cov)
        errors.append(np.max(np.abs(cov[1:] - exact[1:]) / np.abs(exact[1:])))
    assert errors[0] > 0.1 and errors[1] < 1e-5


def test_one_step_and_refusals():
    given = model()
    ys = data(given)
    same(mo.filters.run_in_parallel(given, ys[:1], INPUTS[:1]), mo.run(0, mo.KalmanFilter(), given, ys[:1], INPUTS[:1]), 1e-5)
    bent = mo.StateSpaceModel(given.initial, mo.AdditiveGaussian(lambda x, u, t: jnp.sin(x), np.eye(3)), given.sensor)
    with pytest.raises(mo.MotesError, match="run_in_parallel model: expected a linear-Gaussian model, got x0: dynamics is nonlinear in it"):
        mo.filters.run_in_parallel(bent, ys)
    with pytest.raises(mo.CollapseError, match="step 3: the innovation lies"):
        mo.filters.run_in_parallel(given, np.where(np.arange(23)[:, None] == 3, 1e8, ys), INPUTS)
