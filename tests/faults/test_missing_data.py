"""Missing data in every usual form count as not measured, in every call that takes measurements; inputs that are not known are refused.

Calls are told apart from what they compute: each is stopped where the measurements, checked, go to the compiled loop.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
import pytest

import motes as mo
from contract.discovery import examples
from motes.core import checks
from motes.costs import measure
from motes.filters import parallel, stream
from motes.filters import run as running
from motes.smoothers import smooth as smoothing
from motes.testing.models import linear

STEPS = 6
PLAIN = np.arange(2.0 * STEPS).reshape(STEPS, 2)
GAP = np.zeros((STEPS, 2), bool)
GAP[[1, 4, 4], [0, 0, 1]] = True
WANTED = np.where(GAP, np.nan, PLAIN)


def table(**columns):
    return pd.DataFrame({name: pd.array(values, dtype=kind) for name, (values, kind) in columns.items()})


def some(column):
    return [None if gap else value for gap, value in zip(GAP[:, column], PLAIN[:, column], strict=True)]


FORMS = {
    "NaN": WANTED,
    "an array of JAX": jnp.asarray(WANTED),
    "masked": np.ma.array(np.where(GAP, 0.0, PLAIN), mask=GAP),
    "masked, single precision": np.ma.array(np.where(GAP, 0.0, PLAIN), mask=GAP, dtype=np.float32),
    "masked whole numbers": np.ma.array(np.where(GAP, -9999, PLAIN).astype(int), mask=GAP),
    "infinite under the mask": np.ma.array(np.where(GAP, np.inf, PLAIN), mask=GAP),
    "words under the mask": np.ma.array(np.where(GAP, "void", PLAIN.astype(object)), mask=GAP),
    "a list of masked rows": [np.ma.array(row, mask=gap) for row, gap in zip(PLAIN, GAP, strict=True)],
    "a list with masked entries": [[np.ma.masked if g else v for g, v in zip(*row, strict=True)] for row in zip(GAP, PLAIN, strict=True)],
    "None": np.where(GAP, None, PLAIN),
    "lists with None": [list(row) for row in np.where(GAP, None, PLAIN)],
    "pandas": pd.DataFrame(WANTED),
    "pandas NA": table(a=(some(0), "Int64"), b=(some(1), "Float64")),
    "pandas on arrow": table(a=(some(0), "double[pyarrow]"), b=(some(1), "int64[pyarrow]")),
    "pandas NaT": pd.DataFrame(np.where(GAP, pd.NaT, PLAIN)),
}
MODEL = linear()


class Seen(Exception):
    """Carries what would have been computed with."""


def stopped(call):
    with pytest.raises(Seen) as found:
        call()
    return found.value.args[0]


@pytest.fixture
def at_the_loop(monkeypatch):
    """Stop every call where it hands its measurements on."""

    def see(place):
        def seen(*args):
            raise Seen(np.array(args[place]))

        return seen

    monkeypatch.setattr(running, "_run", see(3))
    monkeypatch.setattr(parallel, "_run", see(1))
    monkeypatch.setattr(smoothing, "_smooth", see(4))
    monkeypatch.setattr(stream, "start", lambda *args: args)
    monkeypatch.setattr(stream, "take_in", see(3))


def calls(ys, history):
    filter, prior = mo.KalmanFilter(), mo.Gaussian([0.0], [[1.0]])

    def begun(y):
        mo.stream(0, filter, MODEL).update(y)

    first = ys.iloc[4] if isinstance(ys, pd.DataFrame) else ys[4]
    return {
        "run": (lambda: mo.run(0, filter, MODEL, ys), WANTED),
        "run_in_chunks": (lambda: next(mo.filters.run_in_chunks(0, filter, MODEL, ys, chunk=5)), WANTED[:5]),
        "run_in_parallel": (lambda: mo.filters.run_in_parallel(MODEL, ys), WANTED),
        "smooth": (lambda: mo.smooth(0, mo.smoothers.RauchTungStriebelSmoother(), MODEL, history, ys), WANTED),
        "stream": (lambda: begun(first), WANTED[4]),
        "seconds_per_step": (lambda: measure.seconds_per_step(filter, MODEL, ys), WANTED),
        "Posterior": (lambda: mo.parameters.Posterior(prior, lambda theta: MODEL, filter, ys)(jnp.zeros(1)), WANTED),
    }


@pytest.fixture(scope="module")
def history():
    return mo.run(0, mo.KalmanFilter(), MODEL, WANTED)


@pytest.mark.parametrize("form", FORMS)
def test_missing_in_every_form(form, at_the_loop, history):
    for name, (call, wanted) in calls(FORMS[form], history).items():
        np.testing.assert_array_equal(stopped(call), wanted, err_msg=name)


def test_masks_reach_every_filter(at_the_loop):
    for name, filter in examples().items():
        np.testing.assert_array_equal(stopped(lambda f=filter: mo.run(0, f, MODEL, FORMS["masked"])), WANTED, err_msg=name)


def test_a_dropped_mask_is_found(at_the_loop, history, monkeypatch):
    """The twin: masks forgotten again."""
    monkeypatch.setattr(checks, "_unmasked", lambda value: np.ma.getdata(value))
    for call, wanted in calls(FORMS["masked"], history).values():
        assert not np.array_equal(stopped(call), wanted, equal_nan=True)


def test_the_stream_goes_on_with_them():
    whole = mo.run(0, mo.KalmanFilter(), MODEL, WANTED)
    for form in ("masked", "None", "pandas NA"):
        ys = FORMS[form].to_numpy() if isinstance(FORMS[form], pd.DataFrame) else FORMS[form]
        alone = mo.stream(0, mo.KalmanFilter(), MODEL)
        for step, y in enumerate(ys):
            if step:
                alone.predict()
            alone.update(y)
        assert np.array_equal(alone.mean, whole.mean[-1])


WRONG = {
    "times": (pd.DataFrame({"a": pd.to_datetime(["2020"] * 6), "b": 1.0}), "ys: expected real numbers, shape (t, y), got Timestamp"),
    "words": (pd.DataFrame({"a": ["n/a"] * 6, "b": 1.0}), "got 'n/a' at index [0, 0]"),
    "spans": (np.full((6, 2), np.timedelta64(3, "s")), "got dtype timedelta64[s]"),
    "complex": (WANTED.astype(complex), "got dtype complex128"),
    "ragged": ([[1.0, 2.0], [3.0]], "got rows of 2, 1 numbers. Give NaN where nothing was measured"),
    "beyond single precision": (np.where(GAP, 1e39, PLAIN), "got 1e+39 at index [1, 0]"),
}


@pytest.mark.parametrize("name", WRONG)
def test_what_is_no_number_is_refused(name):
    ys, message = WRONG[name]
    with pytest.raises(mo.MotesError) as error:
        mo.run(0, mo.KalmanFilter(), MODEL, ys)
    assert message in str(error.value)


def driven():
    return mo.StateSpaceModel(
        mo.Gaussian([0.0], [[1.0]]), mo.AdditiveGaussian(lambda x, u, t: x + u["v"], [[0.1]]), mo.LinearGaussian([[1.0]], [[0.5]])
    )


UNKNOWN = {
    "NaN": np.where(np.arange(STEPS) == 4, np.nan, 1.0),
    "of JAX": jnp.where(jnp.arange(STEPS) == 4, jnp.nan, 1.0),
    "infinite": np.where(np.arange(STEPS) == 4, -np.inf, 1.0),
    "too large": np.where(np.arange(STEPS) == 4, 1e39, 1.0),
    "masked": np.ma.array(np.ones(STEPS), mask=np.arange(STEPS) == 4),
    "pandas": pd.Series(pd.array([1, 1, 1, 1, None, 1], dtype="Int64")),
}


@pytest.mark.parametrize("form", UNKNOWN)
def test_unknown_inputs_are_refused_with_their_row(form):
    inputs, model, ys = {"v": UNKNOWN[form]}, driven(), np.ones((STEPS, 1))
    prior = mo.Gaussian([0.0], [[1.0]])
    attempts = [lambda f=filter: mo.run(0, f, model, ys, inputs) for filter in examples().values()] + [
        lambda: mo.simulate(0, model, STEPS, inputs),
        lambda: next(mo.filters.run_in_chunks(0, mo.KalmanFilter(), model, ys, inputs)),
        lambda: mo.filters.run_in_parallel(model, ys, inputs),
        lambda: mo.bounds.kalman_at_truth(model, np.zeros((STEPS, 1)), inputs),
        lambda: mo.bounds.posterior_cramer_rao(0, model, STEPS, inputs=inputs),
        lambda: mo.parameters.Posterior(prior, lambda theta: model, mo.KalmanFilter(), ys, inputs),
        lambda: mo.Experiment(model, {"kf": mo.KalmanFilter()}, STEPS, 2, inputs=inputs),
        lambda: mo.planning.Pilot(inputs=inputs),
    ]
    for attempt in attempts:
        with pytest.raises(mo.MotesError, match=r"nputs\['v'\]: expected finite numbers, got (nan|-inf|1e\+39) in row 4\. Only"):
            attempt()


def test_a_stream_refuses_an_unknown_input_and_stays():
    alone = mo.stream(0, mo.KalmanFilter(), driven(), {"v": 1.0})
    alone.update(1.0)
    with pytest.raises(mo.MotesError, match=r"predict u\['v'\]: expected finite numbers, got nan"):
        alone.predict({"v": np.nan})
    alone.predict({"v": 2.0})
    alone.update(None)
    assert alone.t == 1 and np.isfinite(alone.mean).all()


def test_known_inputs_of_every_form_run():
    ys = np.ones((STEPS, 1))
    forms = (np.ones(STEPS), jnp.ones(STEPS), pd.Series(np.ones(STEPS)), np.ma.array(np.ones(STEPS)), np.ones(STEPS, object))
    means = [np.asarray(mo.run(0, mo.KalmanFilter(), driven(), ys, {"v": form}).mean) for form in forms]
    for mean in means[1:]:
        np.testing.assert_array_equal(mean, means[0])
    assert np.isfinite(jax.jit(lambda u: mo.run(0, mo.KalmanFilter(), driven(), ys, {"v": u}).mean)(np.ones(STEPS))).all()
