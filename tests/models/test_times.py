"""Measurements with time stamps, however uneven, of one sensor or several."""

import jax.numpy as jnp
import numpy as np
import pytest

import motes as mo

EVEN = mo.textbook.constant_velocity(period=0.5)


def moved(x, u, t):
    return jnp.stack([x[0] + u["dt"] * x[2], x[1] + u["dt"] * x[3], x[2], x[3]])


def noise(x, u, t):
    T = u["dt"]
    return 0.1 * jnp.kron(jnp.array([[T**3 / 3, T**2 / 2], [T**2 / 2, T]]), jnp.eye(2))


UNEVEN = mo.StateSpaceModel(EVEN.initial, mo.AdditiveGaussian(moved, noise), EVEN.sensor, EVEN.names)
XS, YS = (np.array(drawn) for drawn in mo.simulate(1, EVEN, 12))
STAMPS = 0.5 * np.arange(12)


def test_even_stamps_are_the_model_of_that_period():
    wanted = mo.run(0, mo.KalmanFilter(), EVEN, YS)
    dates = np.datetime64("2026-01-01T00:00:00", "ms") + np.round(1000 * STAMPS).astype("timedelta64[ms]")
    for stamps, start in ((STAMPS + 100.0, 100.0), (dates, dates[0].astype("datetime64[s]").astype(float))):
        history = mo.run(0, mo.KalmanFilter(), UNEVEN, mo.times(stamps, YS))
        np.testing.assert_allclose(history.mean, wanted.mean, rtol=1e-4, atol=1e-4)
        np.testing.assert_allclose(history.times, start + STAMPS)


def test_lists_of_numbers_are_measurements_and_none_is_nothing():
    np.testing.assert_array_equal(mo.times(STAMPS.tolist(), YS.tolist()).ys, YS)
    line = mo.times(radar=([0.0, 1.0], [[1, None], [2, 3]]), sonar=([1.0], [[4]]))
    np.testing.assert_array_equal(line.ys["radar"], [[1.0, np.nan], [2.0, 3.0]])
    np.testing.assert_array_equal(line.ys["sonar"], [[np.nan], [4.0]])


def test_steps_without_measurement_change_nothing_when_left_out():
    gappy = YS.copy()
    gappy[[3, 4, 8]] = np.nan
    kept = np.delete(np.arange(12), [3, 4, 8])
    whole = mo.run(0, mo.KalmanFilter(), UNEVEN, mo.times(STAMPS, gappy))
    few = mo.run(0, mo.KalmanFilter(), UNEVEN, mo.times(STAMPS[kept], YS[kept]))
    np.testing.assert_allclose(few.mean, np.asarray(whole.mean)[kept], rtol=1e-3, atol=1e-3)


def test_a_run_over_a_timeline_is_smoothed_and_forecast_with_it(precision):
    line, smoother = mo.times(STAMPS, YS), mo.smoothers.RauchTungStriebelSmoother()
    assert line.inputs["dt"].dtype == precision
    history = mo.run(0, mo.KalmanFilter(), UNEVEN, line, keep=mo.keep.laws)
    found = mo.smooth(1, smoother, UNEVEN, history, line)
    np.testing.assert_array_equal(found.mean, mo.smooth(1, smoother, UNEVEN, history, inputs=line.inputs).mean)
    assert np.isfinite(mo.forecast(history, 2, {"dt": np.full(2, 0.5)}).mean).all()
    with pytest.raises(mo.MotesError, match="smooth inputs: expected none beside a timeline"):
        mo.smooth(1, smoother, UNEVEN, history, line, line.inputs)


def test_equal_stamps_are_steps_that_take_no_time():
    twice = mo.times(np.repeat(STAMPS, 2), np.repeat(YS, 2, axis=0))
    found = mo.run(0, mo.KalmanFilter(), UNEVEN, twice)
    sharper = mo.StateSpaceModel(EVEN.initial, EVEN.dynamics, mo.LinearGaussian(EVEN.sensor.A, EVEN.sensor.Q / 2), EVEN.names)
    np.testing.assert_allclose(np.asarray(found.mean)[1::2], mo.run(0, mo.KalmanFilter(), sharper, YS).mean, rtol=1e-3, atol=1e-3)


def test_several_sensors_come_to_one_line():
    both = mo.Independent(place=EVEN.sensor, speed=mo.LinearGaussian(np.eye(2, 4, k=2), 0.5 * np.eye(2)))
    model = mo.StateSpaceModel(EVEN.initial, UNEVEN.dynamics, both, EVEN.names)
    speeds, at = XS[::3, 2:], STAMPS[::3] + np.array([0.0, 0.2, 0.2, 0.2])
    line = mo.times(place=(STAMPS, YS), speed=(at, speeds))
    assert line.seconds.size == 15 and line.inputs["dt"][0] == 0 and np.isclose(line.inputs["dt"].sum(), 5.5)
    assert np.isfinite(line.ys["speed"]).all(axis=1).sum() == 4 and np.isfinite(line.ys["place"]).all(axis=1).sum() == 12
    history = mo.run(0, mo.KalmanFilter(), model, line)
    rows = np.isin(np.round(history.times, 6), STAMPS)
    alone = np.asarray(mo.run(0, mo.KalmanFilter(), EVEN, YS).mean)
    assert np.square(np.asarray(history.mean)[rows] - XS).mean() < np.square(alone - XS).mean()


def test_frames_among_them_say_where_they_are():
    frames = np.full((4, 5, 5), 7, np.uint8)
    line = mo.times(place=(STAMPS, YS), camera=(STAMPS[::3] + 0.1, frames))
    camera = mo.Custom(log_prob=lambda frame, x, u, t: -1e-3 * jnp.sum(frame.astype(jnp.float32)) * x[0] ** 2)
    model = mo.StateSpaceModel(EVEN.initial, UNEVEN.dynamics, mo.Independent(place=EVEN.sensor, camera=camera), EVEN.names)
    history = mo.run(0, mo.ParticleFilter(n=300), model, line)
    seen = np.isin(np.round(history.times, 6), np.round(STAMPS[::3] + 0.1, 6))
    plain = mo.StateSpaceModel(EVEN.initial, UNEVEN.dynamics, mo.Independent(place=EVEN.sensor), EVEN.names)
    first = mo.run(0, mo.ParticleFilter(n=300), plain, mo.times(place=(STAMPS, YS)))
    assert seen.sum() == 4 and not np.allclose(history.mean[2], first.mean[1])


def test_times_are_saved_and_go_on(tmp_path):
    line = mo.times(STAMPS[:6], YS[:6])
    history = mo.run(0, mo.KalmanFilter(), UNEVEN, line)
    history.save(tmp_path / "run.npz")
    loaded = mo.History.load(tmp_path / "run.npz")
    assert np.array_equal(loaded.times, STAMPS[:6]) and history.to_xarray().time.values.tolist() == STAMPS[:6].tolist()


@pytest.mark.parametrize(("make", "words"), [
    (lambda: mo.times(STAMPS[:3], YS), "times ys: expected a row for each of 3 stamps, got 12"),
    (lambda: mo.times([0.0, np.nan, 2.0], YS[:3]), "times stamps: expected a time in every row, got none .*row 2"),
    (lambda: mo.times(STAMPS, YS, inputs={"w": [1.0, 2.0]}), "times inputs 'w': expected a row for each of 12 stamps, got 2"),
    (lambda: mo.times([0.0, 2.0, 1.0, np.nan], YS[:4]), "times stamps: expected times that never decrease, got 1.0 after 2.0 in row 3"),
    (lambda: mo.times([0.0, 2.0, 1.0], YS[:3]), "times stamps: expected times that never decrease, got 1.0 after 2.0 in row 3"),
    (lambda: mo.times(), "times: expected stamps and measurements, or both for each sensor by name, got none"),
    (lambda: mo.times(STAMPS, YS, radar=(STAMPS, YS)), "times: expected stamps and measurements, .*, got both"),
    (lambda: mo.times(radar=YS), "times radar: expected a pair"),
    (lambda: mo.times(STAMPS, YS, inputs={"dt": STAMPS}), "times inputs: expected other names than 'dt'"),
    (lambda: mo.run(0, mo.KalmanFilter(), UNEVEN, mo.times(STAMPS, YS), {"dt": STAMPS}), "run inputs: expected none beside a timeline"),
])  # fmt: skip
def test_what_cannot_be_is_refused(make, words):
    with pytest.raises(mo.MotesError, match=words):
        make()
