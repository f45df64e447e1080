"""Scans as a user gives them: padded, empty, missing, late, and refused in one line where they do not fit."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import motes as mo
from motes.models.canonical import canonical

pytestmark = pytest.mark.jax

REGION = mo.Uniform([-30.0, -30.0], [30.0, 30.0])
FILTER = mo.MarginalizedParticleFilter(n=300)


def place(x, u, t):
    return x[:2]


def model(clutter=(2.0, REGION), detection=0.9, plots=14, sensor=None):
    base = mo.textbook.constant_velocity()
    one = mo.AdditiveGaussian(place, 0.5 * np.eye(2)) if sensor is None else sensor
    return mo.StateSpaceModel(base.initial, base.dynamics, mo.Cluttered(one, detection, clutter=clutter, plots=plots), base.names)


MODEL = model()
ONE, THREE = np.array([[0.3, 0.1]]), np.array([[0.5, -0.2], [3.0, -9.0], [5.0, 5.0]])
SCANS = [np.array([[0.1, 0.2], [9.0, 9.0]]), np.zeros((0, 2)), ONE, None, THREE]


def test_structure_finds_what_plots_look_at():
    assert mo.structure(MODEL).linear == (2, 3)
    assert mo.structure(model(detection=lambda x, u, t: 0.5 + 0.4 * jnp.tanh(x[2]))).linear == (3,)
    assert mo.structure(model(clutter=0.01, sensor=mo.AdditiveNoise(place, mo.StudentT([0.5, 0.5], 4.0)))).linear == (2, 3)
    together = mo.Independent(one=MODEL.sensor, other=MODEL.sensor)
    assert mo.structure(mo.StateSpaceModel(MODEL.initial, MODEL.dynamics, together, MODEL.names)).linear == (2, 3)


def test_a_list_and_plots_of_it_are_the_same_and_none_tells_nothing():
    ys = mo.plots(SCANS)
    assert ys.value.shape == (5, 3, 2)
    assert ys.there.tolist() == [True, True, True, False, True]
    history = mo.run(0, FILTER, MODEL, ys)
    np.testing.assert_array_equal(history.mean, mo.run(0, FILTER, MODEL, SCANS).mean)
    assert history.info.log_evidence[3] == 0
    np.testing.assert_allclose(history.info.log_evidence[1], -2.0 + np.log(0.1), rtol=1e-5)


def test_streams_late_scans_and_cut_runs_give_the_bits_of_a_run(tmp_path):
    history = mo.run(0, FILTER, MODEL, SCANS)
    stream = mo.stream(0, FILTER, MODEL, lag=3)
    for t, scan in enumerate(SCANS):
        if t:
            stream.predict()
        if t != 2:
            stream.update(scan)
    stream.insert(SCANS[2], 2)
    np.testing.assert_array_equal(stream.mean, history.mean[-1])
    mo.run(0, FILTER, MODEL, SCANS[:3]).save(tmp_path / "half.npz")
    rest = mo.run(0, FILTER, MODEL, SCANS[3:], after=mo.History.load(tmp_path / "half.npz"))
    np.testing.assert_array_equal(rest.mean[-1], history.mean[-1])


def test_lists_of_whole_numbers_and_empty_ones_are_scans():
    scans = [[], [[1, 2], [3, 4]], [[5, 6]]]
    history = mo.run(0, FILTER, MODEL, [np.array(scan, float).reshape(-1, 2) for scan in scans])
    np.testing.assert_array_equal(mo.run(0, FILTER, MODEL, scans).mean, history.mean)
    stream = mo.stream(0, FILTER, MODEL)
    for t, scan in enumerate(scans):
        if t:
            stream.predict()
        stream.update(scan)
    np.testing.assert_array_equal(stream.mean, history.mean[-1])
    whole = np.arange(12).reshape(2, 3, 2)
    np.testing.assert_array_equal(mo.run(0, FILTER, MODEL, whole).mean, mo.run(0, FILTER, MODEL, whole.astype(float)).mean)
    np.testing.assert_array_equal(mo.run(0, FILTER, MODEL, [[], []]).mean, mo.run(0, FILTER, MODEL, [np.zeros((0, 2))] * 2).mean)


def test_one_number_is_no_empty_scan_and_an_empty_array_is():
    with pytest.raises(mo.MotesError, match="plots scan 0: expected shape"):
        mo.run(0, FILTER, MODEL, [np.array(5.0), np.zeros((0, 2))])
    empty = [mo.run(0, FILTER, MODEL, [blank, SCANS[1]]).mean for blank in ([], np.array([]), np.zeros((0, 2)))]
    np.testing.assert_array_equal(empty[0], empty[2])
    np.testing.assert_array_equal(empty[1], empty[2])


def test_a_first_step_without_a_scan():
    stream = mo.stream(0, FILTER, MODEL)
    stream.update(None)
    stream.predict()
    stream.update(SCANS[1])
    np.testing.assert_allclose(stream.mean, mo.run(0, FILTER, MODEL, [None, SCANS[1]]).mean[-1], rtol=1e-4)
    silent = mo.StateSpaceModel(MODEL.initial, MODEL.dynamics, mo.Custom(log_prob=lambda y, x, u, t: x[0]), MODEL.names)
    with pytest.raises(mo.MotesError, match="what Custom measures, NaN where it measured nothing, got None. Give NaN in its form"):
        mo.stream(0, FILTER, silent).update(None)


def test_tracks_in_clutter_are_smoothed_by_the_dynamics_alone():
    history = mo.run(0, mo.ExtendedKalmanFilter(), MODEL, SCANS)
    plain = mo.replace(MODEL, sensor=MODEL.sensor.sensor)
    found, wanted = (mo.smooth(0, mo.smoothers.RauchTungStriebelSmoother(), model, history) for model in (MODEL, plain))
    np.testing.assert_array_equal(found.mean, wanted.mean)
    assert np.trace(found.cov[0]) < np.trace(history.cov[0])


@pytest.mark.night
def test_simulated_scans_run_as_they_come_and_studies_take_them():
    xs, ys = mo.simulate(3, MODEL, 20)
    assert ys.value.shape == (20, 14, 2)
    history = mo.run(1, mo.ParticleFilter(n=1_000), MODEL, ys)
    assert float(jnp.abs(history.mean - xs)[:, :2].max()) < 4
    study = mo.study(mo.Experiment(MODEL, {"pda": mo.KalmanFilter(), "particles": FILTER}, steps=10, runs=4))
    assert "pda" in str(study)


def test_models_built_anew_use_the_code_that_is_there():
    found = [model(detection=lambda x, u, t: 0.5 + 0.4 * jnp.tanh(x[2] ** 2)) for _ in range(2)]
    y = jax.tree.map(lambda leaf: leaf[0], found[0].sensor.packed(SCANS))
    assert canonical(found[0], None, y) == canonical(found[1], None, y)
    assert canonical(found[0], None, y) != canonical(model(detection=lambda x, u, t: 0.4 + 0.5 * jnp.tanh(x[2] ** 2)), None, y)


@pytest.mark.night
def test_modes_with_scans_run_by_particles_and_by_gaussians():
    quiet, agile = (mo.StateSpaceModel(MODEL.initial, mo.LinearGaussian(MODEL.dynamics.A, scale * np.eye(4)), MODEL.sensor, MODEL.names)
                    for scale in (0.01, 1.0))  # fmt: skip
    jumping = mo.JumpMarkovModel([0.5, 0.5], [[0.9, 0.1], [0.1, 0.9]], (quiet, agile))
    xs, ys = mo.simulate(3, jumping, 15)
    means = [mo.run(0, mo.ParticleFilter(n=4_000), jumping.as_state_space(), ys).mean[:, :4]]
    means += [mo.run(0, filter, jumping, ys).mean for filter in (mo.InteractingMultipleModel(), mo.JumpMarkovFilter(n=8))]
    for mean in means:
        assert float(jnp.abs(mean - xs[:, :4])[:, :2].max()) < 4


@pytest.mark.parametrize(("ys", "words"), [
    ([np.zeros((15, 2))], "ys: expected scans of at most 14 plots, got 15 in scan 0. Say plots= that many."),
    ([None, None], r"plots scans: expected plots with one number of components, got none. Write np.zeros\(\(0, z\)\)"),
    ([np.zeros((1, 2)), np.zeros((1, 3))], "plots scans: expected plots with one number of components, got 2 and 3"),
    ([np.zeros(2)], r"plots scan 0: expected shape \(plots, z\), got shape \(2,\). One plot is"),
    ([np.array([[np.inf, 0.0]])], "plots scan 0: expected finite numbers"),
    ([], "plots scans: expected a list with an array"),
    (np.zeros((3, 2)), "ys: expected scans, as mo.plots makes them"),
    (np.full((1, 3, 2), np.nan), "NaN alone in row 0. mo.plots tells an empty scan"),
    ({"radar": np.zeros((3, 1, 2))}, "ys: expected scans, as mo.plots makes them of a list of arrays .plots, z., got a dict"),
])  # fmt: skip
def test_scans_that_do_not_fit_are_refused(ys, words):
    with pytest.raises(mo.MotesError, match=words):
        mo.run(0, FILTER, MODEL, ys)


def test_a_component_that_is_missing_needs_a_law_that_can_leave_it_out():
    scan = [np.array([[np.nan, 1.0], [0.0, 0.0]])]
    with pytest.raises(mo.MotesError, match="ys: expected whole plots .*NaN in plot 0 of scan 0. Leave the plot out"):
        mo.run(0, FILTER, model(clutter=0.01), scan)
    assert np.isfinite(mo.run(0, FILTER, MODEL, scan).log_likelihood)


def test_two_plots_where_no_false_ones_can_be_are_a_collapse():
    with pytest.raises(mo.CollapseError, match="step 0"):
        mo.run(0, FILTER, MODEL, [np.array([[31.0, 0.0], [-31.0, 0.0]])])


@pytest.mark.parametrize(("arguments", "words"), [
    ({"detection": 0.0}, "Cluttered detection: expected a number above 0 and at most 1"),
    ({"clutter": 0.0}, "Cluttered clutter: expected a number above 0"),
    ({"clutter": REGION}, "Cluttered clutter: expected a density of false plots above 0, or a pair"),
    ({"clutter": (20.0, REGION)}, "Cluttered plots: expected at least 4[0-9], since scans of 20 false plots"),
    ({"plots": 0}, "Cluttered plots: expected a whole number of at least 1"),
    ({"sensor": mo.Independent(a=mo.Custom(log_prob=place))}, "Cluttered sensor: expected a sensor of one plot, a vector, got Together"),
    ({"sensor": mo.AdditiveGaussian(place, np.zeros((2, 2)))}, "Cluttered sensor Q: expected a positive definite covariance"),
    ({"sensor": 3}, "Cluttered sensor: expected a sensor such as AdditiveGaussian, got int"),
])  # fmt: skip
def test_sensors_that_cannot_be_are_refused(arguments, words):
    with pytest.raises(mo.MotesError, match=words):
        model(**arguments)


@pytest.mark.parametrize(("arguments", "words"), [
    ({"detection": lambda x, u, t: x[:2]}, r"Cluttered detection\(x, u, t\): expected shape \(\)"),
    ({"clutter": (2.0, mo.Uniform([0.0], [1.0]))}, "Cluttered clutter law"),
])  # fmt: skip
def test_functions_that_do_not_fit_are_refused(arguments, words):
    with pytest.raises(mo.MotesError, match=words):
        mo.run(0, FILTER, model(**arguments), SCANS)


@pytest.mark.parametrize(("filter", "words"), [
    (mo.EnsembleKalmanFilter(n=20), "EnsembleKalmanFilter sensor: expected a mean function and a noise covariance, got Cluttered"),
    (mo.SquareRootKalmanFilter(), "SquareRootKalmanFilter model: expected a linear-Gaussian model"),
    (mo.KalmanParticleKernelFilter(n=20), "got Cluttered. Use a ParticleFilter"),
    (mo.ParticleFilter(n=20, proposal=mo.ExtendedKalmanProposal()), "ParticleFilter"),
], ids=lambda value: type(value).__name__)  # fmt: skip
def test_filters_that_cannot_take_scans_say_so(filter, words):
    with pytest.raises(mo.MotesError, match=words):
        mo.run(0, filter, MODEL, SCANS)


def test_a_density_says_not_where_plots_are_drawn():
    with pytest.raises(mo.MotesError, match="Cluttered clutter: expected a pair .*it is simulated here"):
        mo.simulate(0, model(clutter=0.01), 3)


def test_native_kernels_weigh_scans_of_few_plots_and_say_where_they_do_not():
    few, many = (model(clutter=(rate, REGION), plots=plots) for rate, plots in ((0.1, 6), (30.0, 70)))
    filter = mo.ParticleFilter(n=2_000)
    with mo.engine("native"):
        told = [dict(mo.explain(filter, one, y=ONE).stages) for one in (few, many)]
    assert any("native" in text for text in told[0].values())
    ys = mo.simulate(2, few, 6)[1]
    first = []
    for name in ("jax", "native"):
        with mo.engine(name):
            first.append(mo.run(0, filter, few, ys).info.log_evidence[0])
    np.testing.assert_allclose(first[0], first[1], rtol=1e-4)
