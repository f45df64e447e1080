"""Pictures: what is drawn, not how pretty it is."""

import io

import jax.numpy as jnp
import numpy as np
import pytest

import motes as mo
from data import refused
from motes.applications.terrain.pictures import Tracks, error_figure, map_figure
from motes.models.terrain import TerrainMap
from motes.planning.plan import COLUMNS


@pytest.fixture(scope="module")
def history():
    law = mo.Gaussian(jnp.zeros(2), jnp.eye(2))
    model = mo.StateSpaceModel(law, mo.LinearGaussian(jnp.eye(2), jnp.eye(2)), mo.LinearGaussian(jnp.eye(2), jnp.eye(2)), ("px", "py"))
    _, ys = mo.simulate(0, model, 12)
    return mo.run(1, mo.ParticleFilter(n=30), model, ys)


def png(figure):
    picture = io.BytesIO()
    figure.savefig(picture, format="png", dpi=40)
    return picture.getvalue()


def test_history(history):
    figure = mo.plot(history, truth=np.zeros((12, 2)))
    assert [axes.get_title() for axes in figure.axes] == ["px", "py", "effective sample size"]
    band, mean = figure.axes[0].collections[0].get_paths()[0].vertices, figure.axes[0].lines[0].get_ydata()
    np.testing.assert_allclose(mean, history.mean[:, 0])
    np.testing.assert_allclose(band[:, 1].max(), np.max(history.mean[:, 0] + 2 * np.sqrt(history.cov[:, 0, 0])), rtol=1e-5)
    assert png(figure)[:4] == b"\x89PNG"
    assert len(mo.plot(history).axes[0].lines) == 1


def test_a_wide_prior_leaves_something_to_be_seen():
    model = mo.models.local_level(1.0, 0.1)
    xs, ys = mo.simulate(0, mo.StateSpaceModel(mo.Gaussian([5.0], [[1.0]]), model.dynamics, model.sensor, model.names), 30)
    low, high = mo.plot(mo.run(0, mo.SquareRootKalmanFilter(), model, ys), truth=xs).axes[0].get_ylim()
    assert low < xs.min() and high > xs.max() and high - low < 3 * np.ptp(ys)


def test_a_forecast_without_times_ahead_numbers_all_steps():
    pandas = pytest.importorskip("pandas")
    step = mo.LinearGaussian([[1.0]], [[1.0]])
    model = mo.StateSpaceModel(mo.Gaussian([0.0], [[1.0]]), step, step)
    days = np.array(["2024-01-01", "2024-01-02", "2024-02-11", "2024-03-05", "2024-03-07", "2024-05-30"], "datetime64[D]")
    ys = pandas.Series(np.arange(6.0), days)
    figure = mo.plot(mo.forecast(mo.run(0, mo.KalmanFilter(), model, ys), 3), truth=ys)
    assert figure.axes[0].get_xlim() == (0, 8) and figure.axes[-1].get_xlabel() == "step"


def test_plan():
    rows = (("marginalized x", 900, 1.0, None, 1.5, 0.1, None, 0, 16), ("plain $x$", 1200, 1.0, None, 2.5, 0.2, None, 0, 8))
    figure = mo.plot(mo.planning.Plan(mo.ParticleFilter(n=900), 1e-3, mo.io.Table(COLUMNS, rows)))
    assert [text.get_text() for text in figure.axes[0].get_yticklabels()] == ["marginalized x", "plain $x$"]
    assert [list(line.get_xdata()) for line in figure.axes[0].lines] == [[1.5], [2.5]]
    assert png(figure)[:4] == b"\x89PNG"


def test_wrong_results_are_refused(history):
    with pytest.raises(mo.MotesError) as error:
        mo.plot(3)
    refused(error, "plot result", "int")
    with pytest.raises(mo.MotesError) as error:
        mo.plot(history, truth=np.zeros((3, 2)))
    refused(error, "plot truth", "(12, 2)")
    with pytest.raises(mo.MotesError) as error:
        mo.plot(mo.bounds.Bound(jnp.ones((3, 1, 1)), ("px",), "some bound"), truth=np.zeros((3, 1)))
    refused(error, "plot truth", "Bound")


def test_bound():
    covs = np.stack([np.diag([4.0, 9.0]), np.diag([1.0, 16.0])])
    figure = mo.plot(mo.bounds.Bound(jnp.asarray(covs), ("px", "py"), "some bound"))
    assert [axes.get_title() for axes in figure.axes] == ["px", "py"] and figure.get_suptitle() == "some bound"
    np.testing.assert_allclose(figure.axes[1].lines[0].get_ydata(), [3, 4])
    assert png(figure)[:4] == b"\x89PNG"


NAMES = (r"$\input$", "$x^{$")


def named_pictures():
    law = mo.Gaussian(jnp.zeros(2), jnp.eye(2))
    model = mo.StateSpaceModel(law, mo.LinearGaussian(jnp.eye(2), jnp.eye(2)), mo.LinearGaussian(jnp.eye(2), jnp.eye(2)), NAMES)
    yield mo.run(0, mo.KalmanFilter(), model, jnp.zeros((4, 2)))
    yield mo.study(mo.Experiment(model, {NAMES[1]: mo.KalmanFilter()}, steps=4, runs=2))
    yield mo.sample(0, mo.mcmc.RandomWalkMetropolis(1.0), lambda p: -0.5 * p[NAMES[1]] ** 2, {NAMES[1]: jnp.zeros(())}, draws=20, burn_in=0)
    yield mo.bounds.Bound(jnp.ones((3, 1, 1)), NAMES[1:], NAMES[1])
    yield mo.planning.Plan(mo.ParticleFilter(n=9), 1e-3, mo.io.Table(COLUMNS, ((NAMES[1], 9, 1.0, None, 1.5, 0.1, None, 0, 16),)))


@pytest.mark.filterwarnings("ignore::motes.core.checks.MotesWarning")
def test_names_are_no_mathematics(monkeypatch):
    results = list(named_pictures())
    for result in results:
        assert png(mo.plot(result))[:4] == b"\x89PNG"
    errors = error_figure(np.arange(4.0), {NAMES[1]: np.ones(4)}, np.ones(4), 150.0, NAMES[1])
    assert png(errors)[:4] == b"\x89PNG"
    monkeypatch.setattr("matplotlib.text.Text.set_parse_math", lambda text, parse: setattr(text, "_parse_math", True))
    for result in results:
        with pytest.raises(ValueError, match="ParseFatalException|ParseException|ParseSyntaxException"):
            png(mo.plot(result))


def test_no_global_state(history):
    import matplotlib.pyplot as pyplot

    mo.plot(history)
    assert pyplot.get_fignums() == []


def test_terrain_pictures():
    heights = np.add.outer(np.arange(30.0), np.arange(40.0))
    heights[3, 4] = np.nan
    terrain = TerrainMap(jnp.asarray(heights), 100.0, 80.0)
    line = np.linspace(500, 1500, 20)
    covs = np.tile(np.diag([400.0, 100.0]), (20, 1, 1))
    figure = map_figure(terrain, Tracks((line, line + 100), (line, line), covs, (line, line + 5)))
    axes = figure.axes[0]
    assert axes.get_aspect() == 1 and axes.get_xlabel() == "east, km"
    labels = {drawn.get_label(): drawn for drawn in axes.lines}
    np.testing.assert_allclose(labels["inertial"].get_xdata(), (line + 100) / 1e3)
    ellipse = axes.patches[0]
    # the longer axis, 80 m, points north
    assert sorted((ellipse.width, ellipse.height)) == pytest.approx([0.04, 0.08])
    turned = ellipse.angle if ellipse.width > ellipse.height else ellipse.angle + 90
    assert abs(np.sin(np.radians(turned))) == pytest.approx(1)
    assert png(figure)[:4] == b"\x89PNG"
    errors = error_figure(np.arange(20.0), {"one": line, "two": np.zeros(20)}, np.full(20, 30.0), 150.0)
    assert errors.axes[0].get_yscale() == "log" and png(errors)[:4] == b"\x89PNG"


def test_chains():
    chains = mo.sample(0, mo.mcmc.RandomWalkMetropolis(1.0), lambda x: -0.5 * jnp.sum(x**2), jnp.zeros(3), draws=100, chains=3, burn_in=20)
    figure = mo.plot(chains)
    assert len(figure.axes) == 6 and len(figure.axes[0].lines) == 3
    assert [axes.get_title() for axes in figure.axes[::2]] == ["x[0]", "x[1]", "x[2]"]
