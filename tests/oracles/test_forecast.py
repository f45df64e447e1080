"""Forecasts against exact laws: NumPy in float64, statsmodels on the Nile, chains of modes; simulated ones at a level of 1e-6."""

import jax
import numpy as np
import pytest

import motes as mo
from data import refused

FAR = 4.9
"""Standard errors beyond which lies one in a million of normal numbers, on both sides."""


def level():
    return mo.models.local_level(15_099.0, 1469.1, mo.Gaussian([0.0], [[1e7]]))


def test_kalman_laws_are_exact(double):
    F, Q, H, R = np.array([[1.0, 0.5], [-0.2, 0.9]]), np.diag([0.3, 0.1]), np.array([[1.0, 2.0]]), np.array([[0.7]])
    model = mo.StateSpaceModel(mo.Gaussian(np.zeros(2), np.eye(2)), mo.LinearGaussian(F, Q), mo.LinearGaussian(H, R))
    history = mo.run(0, mo.KalmanFilter(), model, np.sin(np.arange(20.0))[:, None])
    forecast = mo.forecast(history, 7)
    m, P = np.array(history.mean[-1]), np.array(history.cov[-1])
    for step in range(7):
        m, P = F @ m, F @ P @ F.T + Q
        np.testing.assert_allclose(forecast.states.mean[step], m, atol=1e-10)
        np.testing.assert_allclose(forecast.states.cov[step], P, atol=1e-10)
        np.testing.assert_allclose(forecast.mean[step], H @ m, atol=1e-10)
        np.testing.assert_allclose(forecast.cov[step], H @ P @ H.T + R, atol=1e-10)
    lower, upper = forecast.interval(0.95)
    np.testing.assert_allclose((upper - lower) / forecast.sd, 2 * 1.959963984540054, rtol=1e-9)


def test_nile_as_statsmodels(double):
    series = pytest.importorskip("statsmodels.api")
    pandas = pytest.importorskip("pandas")
    nile = pytest.importorskip("statsmodels.datasets").nile.load_pandas().data["volume"].to_numpy()
    ys = pandas.Series(nile, pandas.period_range("1871", periods=100, freq="Y"), name="volume")
    wanted = series.tsa.UnobservedComponents(ys, "llevel").smooth([15_099.0, 1469.1]).get_forecast(12)
    table = mo.forecast(mo.run(0, mo.KalmanFilter(), level(), ys), 12).to_pandas()
    np.testing.assert_allclose(table["volume"], wanted.predicted_mean, rtol=1e-6)
    np.testing.assert_allclose(table["volume_sd"], wanted.se_mean, rtol=1e-6)
    np.testing.assert_allclose(table[["volume_lower", "volume_upper"]], wanted.conf_int(), rtol=1e-6)
    assert table.index.equals(wanted.predicted_mean.index)


def test_particles_agree_with_the_exact_law():
    ys, n = 3 * np.sin(np.arange(12.0))[:, None], 4_000
    model = mo.StateSpaceModel(mo.Gaussian([0.0], [[4.0]]), mo.LinearGaussian([[0.9]], [[1.0]]), mo.LinearGaussian([[1.0]], [[2.0]]))
    exact = mo.forecast(mo.run(0, mo.KalmanFilter(), model, ys), 6)
    cloud = mo.forecast(mo.run(0, mo.ParticleFilter(n=n), model, ys), 6, key=3)
    # the last cloud was weighted: its effective size is half of n or more
    error = np.asarray(exact.sd)[:, 0] / np.sqrt(n / 4)
    assert (np.abs(cloud.mean - exact.mean)[:, 0] < FAR * error).all()
    assert (np.abs(cloud.quantile(0.9) - exact.quantile(0.9))[:, 0] < 2 * FAR * error).all()


def test_modes_agree_with_the_sum_over_all_paths(double):
    models = [mo.StateSpaceModel(mo.Gaussian([0.0], [[1.0]]), mo.LinearGaussian([[a]], [[q]]), mo.LinearGaussian([[h]], [[0.5]]))
              for a, q, h in ((0.9, 0.1, 1.0), (-0.5, 1.0, 2.0))]  # fmt: skip
    transition = np.array([[0.9, 0.1], [0.3, 0.7]])
    model = mo.JumpMarkovModel([0.5, 0.5], transition, models)
    history = mo.run(0, mo.JumpMarkovFilter(n=64), model, np.array([[0.3], [1.0], [-0.4]]))
    forecast = mo.forecast(history, 2)
    law = history.state
    parts = [(w, s, m, P) for w, s, m, P in zip(np.asarray(law.weights), np.asarray(law.part_modes), law.parts.center[0],
                                                law.parts.covariance[0, 0], strict=True) if w > 0]  # fmt: skip
    for step in range(2):
        moves = enumerate([(0.9, 0.1), (-0.5, 1.0)])
        parts = [(w * transition[s, z], z, a * m, a * a * P + q) for z, (a, q) in moves for w, s, m, P in parts]
        w, h = np.array([part[0] for part in parts]), np.array([(1.0, 2.0)[part[1]] for part in parts])
        m, P = (np.array([part[place] for part in parts]) for place in (2, 3))
        mean = w @ (h * m)
        np.testing.assert_allclose(forecast.mean[step], mean, atol=1e-9)
        np.testing.assert_allclose(forecast.cov[step, 0, 0], w @ (h * h * P + 0.5 + (h * m - mean) ** 2), atol=1e-9)


def test_what_cannot_be_forecast_is_refused(tmp_path):
    model = level()
    history = mo.run(0, mo.KalmanFilter(), model, np.ones((4, 1)))
    again = mo.History.load(history.save(tmp_path / "run.npz"))
    assert np.array_equal(mo.forecast(again, 3, filter=mo.KalmanFilter(), model=model).mean, mo.forecast(history, 3).mean)
    many = jax.vmap(lambda y: mo.run(0, mo.KalmanFilter(), model, y))(np.ones((2, 4, 1)))
    assert jax.vmap(lambda one: mo.forecast(one, 3, filter=mo.KalmanFilter(), model=model))(many).mean.shape == (2, 3, 1)
    calls = {
        "knows its filter and model": lambda: mo.forecast(again, 3),
        "at least 1": lambda: mo.forecast(history, 0),
        "expected one run, got 2": lambda: mo.forecast(many, 3),
        "inputs: expected none": lambda: mo.forecast(history, 2, np.ones(2)),
    }
    for words, call in calls.items():
        with pytest.raises(mo.MotesError) as error:
            call()
        refused(error, words)
