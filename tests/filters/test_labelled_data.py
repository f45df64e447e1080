"""Tables of pandas, polars and xarray go in with their times and names, and come out again; missing rows are told, and can be filled."""

import datetime as dt
import json
import subprocess
import sys
import warnings
import zipfile

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
import pytest

import motes as mo
from data import refused
from motes.io.calendars import calendar
from motes.io.tabular import unlabelled
from motes.models.state_space import numbers_of

STEADY, BOTH = mo.LinearGaussian([[1.0]], [[1.0]]), mo.LinearGaussian(np.eye(2), np.eye(2))
LEVEL = mo.StateSpaceModel(mo.Gaussian([0.0], [[10.0]]), STEADY, STEADY, ("level",))
PAIR = mo.StateSpaceModel(mo.Gaussian([0.0, 0.0], np.eye(2)), BOTH, BOTH, ("a", "b"))
DAYS = pd.date_range("2024-03-01", periods=6, freq="D", name="day")
VALUES = np.array([1.0, np.nan, 3.0, 2.0, 1.0, 0.0])
PLAIN = np.stack([VALUES, VALUES[::-1]], axis=1)


def forms():
    """One column and two of them, each in every library, by name."""
    pl, xr = pytest.importorskip("polars"), pytest.importorskip("xarray")
    nothing = [None if np.isnan(value) else value for value in VALUES]
    frame = {"day": DAYS.date.tolist(), "p": VALUES, "q": VALUES[::-1]}
    along = {"day": DAYS}
    return {
        "pandas series": (pd.Series(VALUES, DAYS, name="p"), LEVEL), "pandas frame": (pd.DataFrame(PLAIN, DAYS, ["p", "q"]), PAIR),
        "pandas NA": (pd.Series(nothing, DAYS, "Float64", "p"), LEVEL),
        "pandas column of dates": (pd.DataFrame({"day": DAYS, "p": VALUES, "q": VALUES[::-1]}), PAIR),
        "polars series": (pl.Series("p", nothing), LEVEL), "polars frame": (pl.DataFrame(frame), PAIR),
        "polars lazy": (pl.DataFrame(frame).lazy(), PAIR), "xarray array": (xr.DataArray(VALUES, along, ("day",), "p"), LEVEL),
        "xarray turned": (xr.DataArray(PLAIN.T, {"of": ["p", "q"]} | along, ("of", "day")), PAIR),
        "xarray dataset": (xr.Dataset({"p": ("day", VALUES), "q": ("day", VALUES[::-1])}, along), PAIR),
    }  # fmt: skip


def test_every_form_gives_what_the_array_gives():
    plain = {model.names: mo.run(0, mo.KalmanFilter(), model, PLAIN[:, : model.size]) for model in (LEVEL, PAIR)}
    for name, (ys, model) in forms().items():
        history = mo.run(0, mo.KalmanFilter(), model, ys)
        np.testing.assert_array_equal(history.mean, plain[model.names].mean, err_msg=name)
        assert history.labels.columns == ("p", "q")[: model.size], name
        if name != "polars series":
            assert history.to_pandas().index.equals(DAYS) and history.to_pandas().index.name == "day", name
            np.testing.assert_allclose(history.times, (DAYS - pd.Timestamp("1970")) / pd.Timedelta("1s"))


def test_nothing_is_imported_that_was_not_given():
    code = ("import sys, numpy as np, motes as mo\nmodel = mo.textbook.constant_velocity()\n"
            "mo.run(0, mo.KalmanFilter(), model, np.zeros((3, 2)).tolist())\n"
            "print([name for name in ('pandas', 'xarray', 'polars', 'IPython') if name in sys.modules])")  # fmt: skip
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout == "[]\n"


@pytest.mark.parametrize("index, gone, words", [
    (pd.date_range("2024-01-31", periods=14, freq="ME"), [3, 4], "2 of 14 months are missing (2024-04-30, 2024-05-31)"),
    (pd.date_range("2023-10-15", periods=20, freq="D", tz="Europe/Berlin"), [14], "1 of 20 days is missing (2023-10-29)"),
    (pd.date_range("2024-03-01", periods=12, freq="B"), [7], "1 of 12 weekdays is missing (2024-03-12)"),
    (pd.date_range("2024-03-01", periods=12, freq="15min"), [7], "1 of 12 steps of 15 minutes is missing (2024-03-01T01:45:00)"),
    (pd.period_range("1990Q1", periods=12, freq="Q"), [2, 5, 6], "3 of 12 steps of 3 months are missing (1990-07-01"),
    (pd.RangeIndex(1871, 1891), [9], "1 of 20 steps is missing (1880)"),
    (pd.Index(np.arange(20) * 0.1), [3], "1 of 20 steps of 0.1 is missing (0.3"),
])  # fmt: skip
def test_missing_rows_are_told_and_filled(index, gone, words):
    whole = pd.Series(np.arange(float(len(index))), index, name="v")
    kept = whole.drop(index[gone])
    with pytest.warns(mo.MotesWarning) as told:
        mo.run(0, mo.KalmanFilter(on_collapse="predict"), LEVEL, kept)
    assert words in str(told[0].message) and "mo.io.filled(ys)" in str(told[0].message) and told[0].filename == __file__
    filled = mo.io.filled(kept)
    assert np.isnan(filled.values[gone]).all() and np.array_equal(np.delete(filled.values, gone, axis=0)[:, 0], kept)
    found = filled.labels.pandas_index()
    assert np.allclose(found, index) if index.dtype.kind == "f" else found.equals(index)
    with warnings.catch_warnings():
        warnings.simplefilter("error", mo.MotesWarning)
        history = mo.run(0, mo.KalmanFilter(on_collapse="predict"), LEVEL, mo.io.filled(kept * 0))
    assert history.labels.columns == ("v",)


@pytest.mark.parametrize("freq, zone", [("D", "Europe/Berlin"), ("D", None), ("ME", None), ("MS", "Asia/Tokyo"), ("QS", None), ("YE", None),
                                        ("BME", None), ("BQS", None), ("B", None), ("h", "Europe/Berlin"),
                                        ("2W", None), ("90s", None)])  # fmt: skip
def test_regular_indices_go_on_as_pandas_goes_on(freq, zone):
    index = pd.date_range("2023-10-20", periods=14, freq=freq, tz=zone)
    labels = unlabelled("ys", pd.Series(0.0, index[:8]))[1]
    again = mo.replace(labels, index=labels.continued(6)).pandas_index()
    assert again.equals(index[8:])


def test_irregular_indices_are_not_told_of():
    rng = np.random.default_rng(0)
    for index in (np.cumsum(rng.exponential(size=30)), np.datetime64("2024-01-01") + np.cumsum(rng.integers(1, 90, 30)), np.arange(1)):
        assert calendar(index) is None


def test_what_has_no_use_as_times_is_left_out():
    for index in (list("abcdef"), [5, 3, 1, 2, 4, 0], pd.CategoricalIndex(list("abcdef")), pd.RangeIndex(6)):
        history = mo.run(0, mo.KalmanFilter(), LEVEL, pd.Series(VALUES, index))
        assert history.labels is None and history.to_pandas().index.name == "step"


def test_what_cannot_be_is_refused_in_one_line():
    frame = pd.DataFrame(PLAIN, DAYS, ["p", "q"])
    steps = {
        "ys index: expected times that never decrease": frame[::-1],
        "ys index: expected one level, got 2 of them": frame.stack(),
        "'n/a' at index [0, 1]": frame.assign(q="n/a"),
        "as the sensor measures, got 3 components": frame.assign(r=1.0),
        "ys index: expected a time in every row, got none after": pd.DataFrame(PLAIN, DAYS.insert(3, pd.NaT)[:6], ["p", "q"]),
    }
    for words, ys in steps.items():
        with pytest.raises(mo.MotesError) as error:
            mo.run(0, mo.KalmanFilter(), PAIR, ys)
        refused(error, words)
    driven = mo.StateSpaceModel(mo.Gaussian([0.0], [[1.0]]), mo.AdditiveGaussian(lambda x, u, t: x + u["v"], [[1.0]]),
                                mo.LinearGaussian([[1.0]], [[1.0]]))  # fmt: skip
    with pytest.raises(mo.MotesError) as error:
        mo.run(0, mo.KalmanFilter(), driven, frame["p"], {"v": pd.Series(1.0, DAYS + pd.Timedelta("1D"))})
    refused(error, "inputs: expected the times of ys", "2024-03-01", "2024-03-02", "reindex")
    given = {"v": pd.Series(1.0, DAYS)}
    wanted = mo.run(0, mo.KalmanFilter(), driven, VALUES[:, None], {"v": np.ones(6)}).mean
    assert np.array_equal(mo.run(0, mo.KalmanFilter(), driven, frame["p"], given).mean, wanted)
    with pytest.raises(mo.MotesError, match="filled ys: expected a table or series with an index"):
        mo.io.filled(PLAIN)


def test_columns_with_the_names_of_sensors_are_theirs():
    sensors = mo.Independent(one=STEADY, two=mo.LinearGaussian([[2.0]], [[1.0]]))
    model = mo.StateSpaceModel(mo.Gaussian([0.0], [[1.0]]), STEADY, sensors)
    frame = pd.DataFrame({"two": VALUES, "one": 1.0}, DAYS)
    wanted = mo.run(0, mo.KalmanFilter(), model, {"one": np.ones((6, 1)), "two": VALUES[:, None]})
    assert np.array_equal(mo.run(0, mo.KalmanFilter(), model, frame).mean, wanted.mean)
    apart = mo.run(0, mo.KalmanFilter(), model, {"two": frame["two"], "one": frame["one"]})
    assert np.array_equal(apart.mean, wanted.mean) and apart.to_pandas().index.equals(DAYS)


def test_stamps_of_a_timeline_are_kept():
    stamps = pd.to_datetime(["2024-01-01 10:00", "2024-01-01 10:07", "2024-01-02 09:00"]).tz_localize("America/New_York")
    ys = pd.Series([1.0, 2.0, 3.0], stamps, name="v")
    for line in (mo.times(stamps, np.array([[1.0], [2.0], [3.0]])), mo.times(ys=ys)):
        history = mo.run(0, mo.KalmanFilter(), LEVEL, line)
        assert history.to_pandas().index.equals(stamps) and np.allclose(line.inputs["dt"], [0, 420, 82_380])
    assert mo.run(0, mo.KalmanFilter(), LEVEL, mo.times([0.0, 1.5], np.array([[1.0], [2.0]]))).to_pandas().index.tolist() == [0.0, 1.5]
    for radar in (ys, (stamps, ys)):
        assert mo.times(radar=radar, camera=(stamps[1:2], np.array([[4.0]]))).ys["radar"].tolist() == [[1.0], [2.0], [3.0]]


def test_history_as_tables_and_files(tmp_path):
    xarray = pytest.importorskip("xarray")
    history = mo.run(0, mo.ParticleFilter(n=60), LEVEL, pd.Series(VALUES, DAYS, name="v"), keep=mo.keep.laws)
    frame = history.to_pandas()
    assert list(frame.columns) == ["level", "level_sd", "ess", "log_evidence", "nis", "alarm", "collapsed"]
    np.testing.assert_array_equal(frame["level_sd"], np.sqrt(history.cov[:, 0, 0]))
    data = history.to_xarray()
    assert data.indexes["time"].equals(DAYS) and data.time.attrs["long_name"] == "day"
    assert xarray.load_dataset(history.save(tmp_path / "run.nc")).indexes["time"].equals(DAYS)
    again = mo.History.load(history.save(tmp_path / "run.npz"))
    assert again.labels == history.labels and again.to_pandas().equals(frame) and np.array_equal(again.times, history.times)
    parts = list(mo.filters.run_in_chunks(0, mo.ParticleFilter(n=60), LEVEL, pd.Series(VALUES, DAYS, name="v"), chunk=4))
    assert mo.filters.joined(parts).to_pandas().index.equals(DAYS)
    with zipfile.ZipFile(tmp_path / "run.npz") as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    header = json.loads(members["header.json"])
    for wrong in ({"unit": "M8[xx]"}, {"zone": 3}, {"columns": [1]}, None):
        labels = header["texts"]["labels"] | wrong if wrong else 3
        members["header.json"] = json.dumps(header | {"texts": header["texts"] | {"labels": labels}}).encode()
        with zipfile.ZipFile(tmp_path / "bad.npz", "w") as archive:
            for name, content in members.items():
                archive.writestr(name, content)
        with pytest.raises(mo.FileError, match="labels: expected times with a unit and names of columns"):
            mo.History.load(tmp_path / "bad.npz")


def test_many_runs_as_tables():
    keys = jax.random.split(jax.random.key(0), 3)
    many = jax.vmap(lambda key: mo.run(key, mo.ParticleFilter(n=20, on_collapse="predict"), LEVEL, pd.Series(VALUES, DAYS)))(keys)
    frame, data = many.to_pandas(), many.to_xarray()
    assert frame.index.names == ["run", "day"] and frame.shape[0] == 18 and dict(data.sizes)["run"] == 3
    assert np.array_equal(frame.loc[1, "level"], many.mean[1, :, 0]) and data.indexes["time"].equals(DAYS)
    assert data["log_likelihood"].shape == (3,)
    line = mo.times([0.0, 1.5, 2.0], np.ones((3, 1)))
    many = jax.vmap(lambda key: mo.run(key, mo.ParticleFilter(n=20, on_collapse="predict"), LEVEL, line))(keys)
    assert many.to_pandas().loc[2].index.tolist() == many.to_xarray().time.values.tolist() == [0.0, 1.5, 2.0]


def test_smoothed_laws_keep_the_times():
    history = mo.run(0, mo.KalmanFilter(), LEVEL, pd.Series(VALUES, DAYS))
    smoothed = mo.smooth(0, mo.smoothers.RauchTungStriebelSmoother(), LEVEL, history)
    assert smoothed.to_pandas().index.equals(DAYS) and list(smoothed.to_pandas()) == ["level", "level_sd"]
    history = mo.run(0, mo.KalmanFilter(), LEVEL, mo.times([0.0, 1.5], np.ones((2, 1))))
    assert mo.smooth(0, mo.smoothers.RauchTungStriebelSmoother(), LEVEL, history).to_pandas().index.tolist() == [0.0, 1.5]


def test_truths_are_found_by_name():
    history = mo.run(0, mo.KalmanFilter(), PAIR, PLAIN)
    truth = pd.DataFrame(PLAIN[:, ::-1], DAYS, ["b", "a"]).fillna(0.0)
    wanted = np.nan_to_num(PLAIN)
    assert np.array_equal(mo.diagnostics.nees(history, truth), mo.diagnostics.nees(history, wanted))
    assert np.array_equal(mo.diagnostics.coverage(history, truth), mo.diagnostics.coverage(history, wanted))


def test_tables_are_inputs_too():
    pl, xr = pytest.importorskip("polars"), pytest.importorskip("xarray")
    row = VALUES[2:]
    for one in (pd.Series(row), pl.Series(row), xr.DataArray(row), {"v": pd.Series(row)}, xr.Dataset({"v": ("time", row)})):
        assert np.array_equal(jax.tree.leaves(numbers_of("inputs", one))[0], row)
    for one in (pl.DataFrame({"v": row}).lazy(), {"v": xr.Dataset({"v": ("time", row)})}):
        assert np.array_equal(jax.tree.leaves(numbers_of("inputs", one))[0], row[:, None])


def test_inputs_of_a_forecast_are_of_the_steps_ahead():
    model = mo.models.structural(1.0, level=0.1, regressors={"price": 0.0})
    quarters = pd.period_range("1962Q1", periods=12, freq="Q")
    prices = pd.DataFrame({"price": np.cos(np.arange(12.0))}, quarters)
    history = mo.run(0, mo.KalmanFilter(), model, prices.iloc[:8] * 2, prices.iloc[:8])
    found = mo.forecast(history, 4, prices.iloc[8:])
    assert np.array_equal(found.mean, mo.forecast(history, 4, prices.iloc[8:].to_numpy()).mean)
    with pytest.raises(mo.MotesError) as error:
        mo.forecast(history, 4, prices.iloc[4:8])
    refused(error, "forecast inputs: expected the times of the steps ahead", "1964-01-01", "1963-01-01", "one step after")


def test_columns_of_inputs_are_taken_by_the_names_of_a_mixed_model():
    def particle(x_p, u, t):
        return x_p + u[:1], jnp.ones((1, 1)), 0.1 * jnp.eye(1)

    def kalman(x_p, u, t):
        return u[1:], 0.5 * jnp.eye(1), 0.1 * jnp.eye(1)

    start = mo.Gaussian([0.0], [[1.0]])
    model = mo.MixedLinearModel(start, start, particle, kalman, lambda x_p, u, t: (x_p, jnp.zeros((1, 1)), jnp.eye(1)),
                                input_names=("push", "drift"))  # fmt: skip
    inputs = pd.DataFrame({"drift": np.sin(np.arange(6.0)), "push": 3.0})
    for filter, one in ((mo.MarginalizedParticleFilter(n=20), model), (mo.ParticleFilter(n=20), model.as_state_space())):
        by_name, by_place = (mo.run(0, filter, one, VALUES[:, None], u) for u in (inputs, inputs[["push", "drift"]].to_numpy()))
        assert np.array_equal(by_name.mean, by_place.mean)


def test_posteriors_and_parallel_runs_take_them():
    series = pd.Series(VALUES, DAYS, name="p")
    posterior = mo.parameters.Posterior(mo.Gaussian([0.0], [[1.0]]), lambda theta: LEVEL, mo.KalmanFilter(), series)
    assert posterior.ys.shape == (6, 1)
    assert mo.filters.run_in_parallel(LEVEL, series).to_pandas().index.equals(DAYS)
    stream = mo.stream(0, mo.KalmanFilter(), PAIR)
    frame = pd.DataFrame(PLAIN, DAYS, ["p", "q"])
    for step in range(3):
        if step:
            stream.predict()
        stream.update(frame.iloc[step])
    np.testing.assert_array_equal(stream.mean, mo.run(0, mo.KalmanFilter(), PAIR, frame).mean[2])


def test_dates_of_python_are_dates():
    days = [dt.date(2024, 3, 1) + dt.timedelta(days=day) for day in range(6)]
    assert mo.run(0, mo.KalmanFilter(), LEVEL, pd.Series(VALUES, days)).to_pandas().index.equals(DAYS.rename(None))
