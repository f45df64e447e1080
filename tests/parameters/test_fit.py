"""Maximum likelihood: estimates and standard errors of statsmodels and of exact grids, and what is said where there are none."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import motes as mo
from data import refused
from motes.core.record import replace
from motes.parameters import likelihood

POSITIVE = ("irregular", "level")


def level(p):
    return mo.models.local_level(p["irregular"], p["level"])


def short_level(p):
    """The same from a law that is not wide."""
    return mo.models.local_level(p["irregular"], p["level"], mo.Gaussian([0.0], [[4.0]]))


def nile():
    return mo.data.nile().values[:, 0]


YS = np.array(mo.simulate(3, short_level({"irregular": 1.0, "level": 0.3}), 60)[1])
YS[[7, 20, 21]] = np.nan
START = {"irregular": 0.5, "level": 0.5}


def agrees_with_statsmodels(found, ys, **words):
    """Parameters to 1e-3 and standard errors to 5 percent; statsmodels is told to be strict about its own stop."""
    statsmodels = pytest.importorskip("statsmodels.api", reason="statsmodels is not installed")
    reference = statsmodels.tsa.UnobservedComponents(ys, **words)
    first = reference.fit(disp=0)
    result = reference.fit(first.params, method="nm", maxiter=4_000, xtol=1e-10, ftol=1e-12, disp=0, cov_type="approx")
    free = np.array([not held for held in found.held])
    assert np.allclose(found.values[free], np.asarray(result.params)[free], rtol=1e-3)
    assert np.allclose(np.sqrt(np.diag(found.covariance))[free], np.asarray(result.bse)[free], rtol=0.05)
    assert abs(found.log_likelihood - result.llf) < 1e-5 and found.log_likelihood > result.llf - 1e-7
    assert abs(found.aic - result.aic) < 1e-4 and abs(found.bic - result.bic) < 1e-4


def test_the_nile_is_that_of_statsmodels():
    """From a start that explains nothing, in a session of float32."""
    ys = nile()
    found = mo.fit(level, ys[:, None], {"irregular": 1.0, "level": 1.0}, positive=POSITIVE, burn=1)
    assert found.converged and found.measured == 99 and found.model.dtype == jnp.float32
    agrees_with_statsmodels(found, ys, level="llevel")


@pytest.mark.night
def test_a_gap_in_the_nile_is_that_of_statsmodels(precision):
    ys = nile()
    ys[20:40] = np.nan
    found = mo.fit(level, ys[:, None], {"irregular": 1e4, "level": 1e3}, positive=POSITIVE, burn=1)
    statsmodels = pytest.importorskip("statsmodels.api", reason="statsmodels is not installed")
    reference = statsmodels.tsa.UnobservedComponents(ys, level="llevel")
    assert abs(reference.loglike(found.values) - found.log_likelihood) < 1e-8
    result = reference.fit(found.values, method="nm", maxiter=4_000, xtol=1e-10, ftol=1e-12, disp=0, cov_type="approx")
    assert np.allclose(found.values, result.params, rtol=1e-3)
    assert np.allclose(list(found.standard_errors.values()), result.bse, rtol=0.05)


@pytest.mark.night
def test_a_seasonal_series_is_that_of_statsmodels():
    def model_of(p):
        return mo.models.structural(p["irregular"], p["level"], seasonal=(4, p["seasonal"]))

    ys = np.asarray(mo.simulate(2, model_of({"irregular": 2.0, "level": 0.5, "seasonal": 0.2}), 200)[1], float)
    start = {"irregular": 1.0, "level": 1.0, "seasonal": 1.0}
    found = mo.fit(model_of, ys, start, positive=tuple(start), burn=4)
    assert found.converged
    agrees_with_statsmodels(found, ys[:, 0], level="llevel", seasonal=4)


@pytest.fixture(scope="module")
def exact():
    return mo.fit(short_level, YS, START, positive=POSITIVE)


def by_hand(irregular, level, ys=YS[:, 0]):
    """Log likelihood from the joint law of all measurements."""
    times = np.arange(ys.size)
    cov = 4.0 + level * np.minimum.outer(times, times) + irregular * np.eye(ys.size)
    seen = ~np.isnan(ys)
    cov, left = cov[np.ix_(seen, seen)], ys[seen]
    return -0.5 * (left @ np.linalg.solve(cov, left) + np.linalg.slogdet(cov)[1] + left.size * np.log(2 * np.pi))


def test_the_maximum_and_its_curvature_are_those_of_the_joint_law(exact):
    theta, step = exact.values, np.diag(1e-3 * exact.values)
    assert abs(by_hand(*theta) - exact.log_likelihood) < 1e-8
    assert all(by_hand(*(theta + side * move)) < exact.log_likelihood for move in 10 * step for side in (-1, 1))
    second = np.array([[by_hand(*(theta + a + b)) - by_hand(*(theta + a - b)) - by_hand(*(theta - a + b)) + by_hand(*(theta - a - b))
                        for a in step] for b in step]) / (4 * np.outer(np.diag(step), np.diag(step)))  # fmt: skip
    assert np.allclose(exact.covariance, np.linalg.inv(-second), rtol=1e-3)


def test_expectation_maximization_comes_to_the_same(exact):
    found = mo.fit(short_level, YS, {"irregular": 1.0, "level": 0.3}, positive=POSITIVE, by="em", rounds=1_000)
    assert found.converged and np.allclose(found.values, exact.values, rtol=1e-3)
    assert np.allclose(found.covariance, exact.covariance, rtol=1e-2)


@pytest.mark.night
def test_expectation_maximization_of_a_singular_model_with_parts_missing():
    """Two lags, of which one has no noise; two sensors, one of them silent at times; two sequences of different lengths."""

    def model_of(p):
        A = jnp.stack([jnp.stack([p["a"], p["b"]]), jnp.array([1.0, 0.0])])
        H = jnp.stack([jnp.array([1.0, 0.0]), jnp.stack([p["h"], 0.0 * p["h"]])])
        noise = jnp.diag(jnp.stack([p["q"], 0.0 * p["q"]]))
        first = mo.Gaussian(jnp.zeros(2), jnp.eye(2))
        return mo.StateSpaceModel(first, mo.LinearGaussian(A, noise), mo.LinearGaussian(H, p["r"] * jnp.eye(2)))

    truth = {"a": 1.2, "b": -0.5, "q": 1.0, "h": 2.0, "r": 0.5}
    ys = [np.array(mo.simulate(key, model_of(truth), steps)[1]) for key, steps in ((0, 100), (1, 60))]
    ys[0][5, 0], ys[1][9] = np.nan, np.nan
    start = {"a": 0.5, "b": 0.0, "q": 2.0, "h": 1.0, "r": 1.0}
    one, other = (mo.fit(model_of, ys, start, positive=("q", "r"), by=by, rounds=1_000) for by in ("likelihood", "em"))
    assert one.converged and other.converged and np.allclose(one.values, other.values, rtol=1e-3)
    far = np.abs(one.values - list(truth.values())) / np.sqrt(np.diag(one.covariance))
    assert (far < 3).all() and one.measured == 159


def test_several_sequences_of_one_length_are_summed(exact):
    found = mo.fit(short_level, [YS, YS], START, positive=POSITIVE)
    assert np.allclose(found.values, exact.values, rtol=1e-4) and abs(found.log_likelihood - 2 * exact.log_likelihood) < 1e-6
    assert np.allclose(found.covariance, exact.covariance / 2, rtol=1e-3)


def test_held_parameters_stay_and_vectors_have_names(exact):
    def of_vector(theta):
        return short_level({"irregular": theta[0], "level": theta[1]})

    held = mo.fit(short_level, YS, START, positive=POSITIVE, fixed={"level": float(exact.values[1])})
    assert held.held == (False, True) and held.standard_errors["level"] == 0 and held.aic == pytest.approx(exact.aic - 2, abs=1e-6)
    assert held.values == pytest.approx(exact.values, rel=1e-4) and "held" in str(held)
    found = mo.fit(of_vector, YS, [0.5, 0.5], names=("r", "q"), bounds={"r": (0, None), "q": (0, 100)})
    assert found.values == pytest.approx(exact.values, rel=1e-4) and list(found.parameters) == ["r", "q"]
    assert np.allclose(found.covariance, exact.covariance, rtol=1e-3)  # through other coordinates


def test_a_parameter_at_its_bound_is_said():
    """Measurements of one level: its variance is best at zero, where it is held."""
    ys = np.random.default_rng(1).normal(3.0, 1.0, (40, 1))
    found = mo.fit(level, ys, START, positive=POSITIVE, burn=1)
    assert found.parameters["level"] == 0 and found.held == (False, True) and found.converged
    assert "level at 0, its bound" in found.message
    assert found.parameters["irregular"] == pytest.approx(ys.var(), rel=0.05)


def test_what_the_data_do_not_tell_is_said():
    def model_of(p):
        return short_level({"irregular": 1.0, "level": p["a"] * p["b"]})

    found = mo.fit(model_of, YS, {"a": 1.0, "b": 0.5}, positive=("a", "b"))
    assert not found.converged and "do not tell a, b" in found.message and np.isnan(found.covariance).all() and "NO" in str(found)


def test_a_fit_prints_and_comes_back_from_its_file(exact, tmp_path):
    text = str(exact)
    for word in ("irregular", "std. error", "P>|z|", "KalmanFilter", "log likelihood", "AIC, BIC", "converged       yes"):
        assert word in text
    assert "| irregular |" in exact._repr_markdown_() and exact.summary(0.9).columns[-1] == "95 %"
    back = mo.parameters.Fit.load(exact.save(tmp_path / "fit.npz"), short_level)
    assert str(back) == text and back.parameters == exact.parameters and back.model.names == ("level",)
    assert mo.parameters.Fit.load(tmp_path / "fit.npz").model is None
    with pytest.raises(mo.FileError, match="npz"):
        exact.save(tmp_path / "fit.csv")
    for groups in ((("irregular", (3,)),), (("irregular", "x"), ("level", ()))):
        with pytest.raises(mo.FileError, match="names of parameters"):
            mo.parameters.Fit.load(replace(exact, groups=groups).save(tmp_path / "wrong.npz"))
    with pytest.raises(mo.FileError):
        mo.parameters.Fit.load(mo.run(0, mo.KalmanFilter(), exact.model, YS[:3]).save(tmp_path / "run.npz"))


@pytest.mark.parametrize(
    ("words", "said"),
    [({"init": {}}, ("init", "at least one")),
     ({"init": {"irregular": "x"}}, ("init['irregular']", "number")),
     ({"init": {"irregular": np.nan, "level": 1.0}}, ("init['irregular']", "finite")),
     ({"init": {"irregular": -1.0, "level": 1.0}}, ("init['irregular']", "above 0", "-1")),
     ({"init": {"irregular": 1.0}, "positive": ()}, ("model_of", "KeyError", "level")),
     ({"init": {"irregular": 1.0, "level": 1.0, "trend": 1.0}}, ("init", "trend", "on which nothing does")),
     ({"init": [[1.0]]}, ("init", "shape")),
     ({"init": [1.0, 2.0], "names": ("a",), "positive": ()}, ("names", "2 different names")),
     ({"names": ("a",)}, ("names", "dictionary")),
     ({"positive": ("lvl",)}, ("positive", "irregular, level", "'lvl'")),
     ({"fixed": {"irregular": 1.0, "level": 2.0}}, ("fixed", "left to estimate")),
     ({"fixed": 3}, ("fixed",)),
     ({"bounds": {"level": 3}, "positive": ()}, ("bounds['level']", "pair")),
     ({"bounds": {"level": (2, 1)}, "positive": ()}, ("bounds['level']", "pair")),
     ({"bounds": {"level": (0, 1)}}, ("bounds['level']", "positive")),
     ({"filter": 3}, ("filter", "int")),
     ({"filter": mo.ParticleFilter(n=10)}, ("filter", "StopGradient")),
     ({"by": "mle"}, ("by", "'likelihood', 'em'")),
     ({"by": "em", "burn": 1}, ("burn=0",)),
     ({"burn": 60}, ("burn", "60")),
     ({"burn": -1}, ("burn", "-1")),
     ({"rounds": 0}, ("rounds",)),
     ({"ys": YS[:, 0]}, ("ys", "shape (t, y)")),
     ({"ys": np.tile([[1.0], [-1.0]], (9, 1)), "positive": ()}, ("model_of", "level: expected a variance", "got -", "positive=")),
     ({"ys": np.full((5, 1), np.inf)}, ("ys", "inf")),
     ({"ys": [YS, YS], "inputs": np.zeros((60, 1))}, ("inputs", "a list")),
     ({"model_of": 3}, ("model_of", "int")),
     ({"model_of": lambda p: None}, ("model_of", "None")),
     ({"model_of": lambda p: p["level"]}, ("model_of", "a model")),
     ({"model_of": lambda p: float(p["level"])}, ("model_of",))],
)  # fmt: skip
def test_what_cannot_be_used_is_refused_in_one_line(words, said):
    given = {"model_of": short_level, "ys": YS, "init": START, "positive": POSITIVE} | words
    with pytest.raises(mo.MotesError) as error:
        mo.fit(given.pop("model_of"), given.pop("ys"), given.pop("init"), **given)
    refused(error, *said)


def volatility(p):
    return mo.models.stochastic_volatility(p["mu"], p["phi"], p["sigma"])


@pytest.mark.night
def test_stochastic_volatility_by_particles_is_that_of_a_grid():
    """On a grid the likelihood is exact and smooth; particles must come within their own reckoning of chance, and near in any case."""
    truth = {"mu": -0.5, "phi": 0.95, "sigma": 0.3}
    ys = np.asarray(mo.simulate(3, volatility(truth), 300)[1])
    words = {"positive": ("sigma",), "bounds": {"phi": (-1, 1)}}
    start = {"mu": 0.0, "phi": 0.8, "sigma": 0.5}
    grid = mo.fit(volatility, ys, start, filter=mo.PointMassFilter((-8.0,), (7.0,), (200,)), **words)
    fine = mo.fit(volatility, ys, start, filter=mo.PointMassFilter((-9.0,), (8.0,), (300,)), **words)
    assert grid.converged and np.allclose(grid.values, fine.values, rtol=1e-3) and np.allclose(grid.covariance, fine.covariance, rtol=1e-2)
    errors = np.sqrt(np.diag(grid.covariance))
    found = mo.fit(volatility, ys, start, **words)
    off = np.abs(found.values - grid.values)
    assert found.converged and (off < 0.3 * errors).all() and (off < 4 * found.simulation_error + 0.1 * errors).all()
    assert np.allclose(np.sqrt(np.diag(found.covariance)), errors, rtol=0.25)
    assert abs(found.log_likelihood - grid.log_likelihood) < 1.0 and "simulation error" in str(found)
    # power: a start at the wrong place that is not left would be seen
    assert (np.abs(np.array(list(start.values())) - grid.values) > errors).any()


@pytest.mark.night
def test_a_nonlinear_model_by_particles_is_that_of_a_grid():
    """A growth model with the factor of its sine unknown: dynamics and sensor are nonlinear."""

    def model_of(p):
        return mo.StateSpaceModel(
            mo.Gaussian(jnp.zeros(1), jnp.eye(1)),
            mo.AdditiveGaussian(lambda x, u, t: p["a"] * jnp.sin(x) + 0.5 * x, p["q"] * jnp.eye(1)),
            mo.AdditiveGaussian(lambda x, u, t: x + 0.1 * x**2, 0.2 * jnp.eye(1)),
        )

    ys = np.asarray(mo.simulate(1, model_of({"a": 2.0, "q": 0.5}), 150)[1])
    start = {"a": 1.0, "q": 1.0}
    grid = mo.fit(model_of, ys, start, positive=("q",), filter=mo.PointMassFilter((-9.0,), (9.0,), (400,)))
    found = mo.fit(model_of, ys, start, positive=("q",), key=1)
    errors, off = np.sqrt(np.diag(grid.covariance)), np.abs(found.values - grid.values)
    assert grid.converged and found.converged
    assert (off < 0.3 * errors).all() and (off < 4 * found.simulation_error + 0.1 * errors).all()
    assert np.allclose(np.sqrt(np.diag(found.covariance)), errors, rtol=0.15)


def test_a_second_fit_compiles_nothing(exact):
    programs = (likelihood.height, likelihood.slope, likelihood.curvature)
    compiled = [program._cache_size() for program in programs]
    found = mo.fit(short_level, YS + 0.1, {"irregular": 2.0, "level": 0.1}, positive=POSITIVE)
    assert found.converged and [program._cache_size() for program in programs] == compiled
    assert not jax.config.jax_enable_x64
