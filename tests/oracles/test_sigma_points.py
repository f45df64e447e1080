"""Sigma-point filters: exact moments of polynomials, the Kalman answer on linear models, dense quadrature on a quadratic sensor."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import least_squares

import motes as mo
from motes.core.record import record
from motes.gaussian.sigma_points import Points, regressed, regressed_on
from oracles.test_linear_gaussian import four_states
from tiers import but_one_in, each

pytestmark = pytest.mark.jax

FILTERS = {
    "unscented": mo.UnscentedKalmanFilter(),
    "unscented, narrow": mo.UnscentedKalmanFilter(alpha=0.1, beta=2.0, kappa=1.0),
    "cubature": mo.CubatureKalmanFilter(),
    "Gauss-Hermite": mo.GaussHermiteFilter(),
    "Gauss-Hermite, even": mo.GaussHermiteFilter(degree=2),
    "extended, iterated": mo.ExtendedKalmanFilter(iterations=3),
}


@pytest.mark.parametrize("filter", FILTERS.values(), ids=FILTERS)
def test_equals_the_kalman_filter_on_linear_models(filter, double):
    _, model = four_states()
    ys = np.array(mo.simulate(3, model, 15)[1])
    ys[4], ys[7, 1] = np.nan, np.nan
    exact, history = (mo.run(0, f, model, ys) for f in (mo.KalmanFilter(), filter))
    assert np.abs(history.mean - exact.mean).max() < 1e-10
    assert np.abs(history.cov - exact.cov).max() < 1e-10
    assert abs(float(history.log_likelihood - exact.log_likelihood)) < 1e-10


def test_float32_with_a_sharp_sensor_stays_with_float64():
    """A variance of 1e4 seen through a noise of 1e-2: a covariance made of differences of large numbers would be lost."""
    sensor = mo.LinearGaussian([[1.0, 0.5]], [[1e-2]])
    model = mo.StateSpaceModel(mo.Gaussian([1e3, -1e3], [[1e4, 5e3], [5e3, 9e3]]), mo.LinearGaussian(np.eye(2), 0.01 * np.eye(2)), sensor)
    ys, seen = np.array([[480.0], [481.0], [479.5]]), np.array([1.0, 0.5])
    with jax.enable_x64(True):
        exact = mo.run(0, mo.KalmanFilter(), model, ys)
    for filter in FILTERS.values():
        history = mo.run(0, filter, model, ys)
        assert np.allclose(np.asarray(history.mean) @ seen, np.asarray(exact.mean) @ seen, atol=5e-3)
        least = np.linalg.eigvalsh(np.asarray(history.cov, np.float64))[:, 0]
        assert np.allclose(least, np.linalg.eigvalsh(np.asarray(exact.cov))[:, 0], rtol=0.1)


def standard_moment(powers):
    """E[z_1^a z_2^b ...] of the standard normal law: product of (a - 1)!! where all are even."""
    return float(np.prod([0 if a % 2 else np.prod(np.arange(a - 1, 0, -2)) for a in powers]))


RULES = {
    "unscented": (mo.gaussian.Unscented(0.7, 2.0, 0.5), 3),
    "cubature": (mo.gaussian.Cubature(), 3),
    "hermite 2": (mo.gaussian.GaussHermite(2), 3),
    "hermite 3": (mo.gaussian.GaussHermite(3), 5),
    "hermite 4": (mo.gaussian.GaussHermite(4), 7),
}


@pytest.mark.parametrize(("rule", "degree"), RULES.values(), ids=RULES)
def test_polynomials_are_exact_to_the_degree_of_the_rule(rule, degree):
    """Every monomial up to the degree, and not every one of the next degree that is even."""

    points = rule.points(3)

    def found(p):
        g = np.prod(points.nodes ** np.array(p)[:, None], axis=0)
        at_center = float(sum(p) == 0)
        return at_center + float((g - at_center) @ points.weights)

    def worst(degrees):
        return max(abs(found(p) - standard_moment(p)) for p in np.ndindex(9, 9, 9) if sum(p) in degrees)

    assert worst(range(degree + 1)) < 1e-10
    assert worst([degree + 1]) > 0.1


def quadratic(noise):
    """Two correlated states seen through a quadratic form and a product, with noise that grows with the state where asked."""
    R = (lambda x, u, t: jnp.array([[0.2 + 0.1 * x[0] ** 2, 0.02], [0.02, 0.3]])) if noise else [[0.2, 0.02], [0.02, 0.3]]
    return mo.StateSpaceModel(
        mo.Gaussian([0.7, -0.4], [[0.5, 0.2], [0.2, 0.3]]),
        mo.AdditiveGaussian(lambda x, u, t: jnp.stack([x[0] + 0.1 * x[1] ** 2, 0.8 * x[1]]), 0.1 * np.eye(2)),
        mo.AdditiveGaussian(lambda x, u, t: jnp.stack([x[0] ** 2 + 0.5 * x[1], x[0] * x[1]]), R),
    )


def dense_moments(model, order=40):
    """Joint moments of state and measurement by quadrature with 40 points per axis, in NumPy."""
    points, weights = np.polynomial.hermite_e.hermegauss(order)
    z = np.stack([a.ravel() for a in np.meshgrid(points, points)])
    w = np.outer(weights, weights).ravel() / weights.sum() ** 2
    X = np.asarray(model.initial.mean())[:, None] + np.linalg.cholesky(np.asarray(model.initial.cov())) @ z
    Y = np.stack([X[0] ** 2 + 0.5 * X[1], X[0] * X[1]])
    R = np.array([[0.2 + (0.1 * X[0] ** 2 if callable(model.sensor.Q) else 0 * X[0]), 0.02 + 0 * X[0]], [0.02 + 0 * X[0], 0.3 + 0 * X[0]]])
    joint = np.vstack([X, Y])
    mean = joint @ w
    cov = ((joint - mean[:, None]) * w) @ (joint - mean[:, None]).T
    cov[2:, 2:] += R @ w
    return mean, cov


@pytest.mark.parametrize("noise", [False, True], ids=["steady noise", "noise of the state"])
def test_gauss_hermite_has_the_exact_joint_moments_of_a_quadratic_sensor(noise, double):
    model, y = quadratic(noise), np.array([1.3, -0.2])
    mean, cov = dense_moments(model)
    gain = cov[:2, 2:] @ np.linalg.inv(cov[2:, 2:])
    history = mo.run(0, mo.GaussHermiteFilter(degree=3), model, y[None])
    assert np.abs(history.mean[0] - (mean[:2] + gain @ (y - mean[2:]))).max() < 1e-10
    assert np.abs(history.cov[0] - (cov[:2, :2] - gain @ cov[2:, :2])).max() < 1e-10
    residual = y - mean[2:]
    density = -0.5 * (residual @ np.linalg.solve(cov[2:, 2:], residual) + np.linalg.slogdet(2 * np.pi * cov[2:, 2:])[1])
    assert abs(float(history.log_likelihood) - density) < 1e-10


@pytest.mark.parametrize("name", ["unscented", "unscented, narrow", "cubature"])
def test_third_degree_rules_predict_a_quadratic_sensor_without_bias(name, double):
    """Mean of the measurement and its covariance with the state are exact; an extended Kalman filter misses the mean."""
    model = quadratic(False)
    mean, cov = dense_moments(model)
    found = FILTERS[name].rule.linearized(model.sensor, model.initial, None, 0)
    assert np.abs(found.prediction - mean[2:]).max() < 1e-9
    assert np.abs(found.slope @ model.initial.cov() - cov[2:, :2]).max() < 1e-9
    assert np.abs(model.sensor.mean(model.initial.mean(), None, 0) - mean[2:]).max() > 0.2


def test_angles_are_averaged_across_the_cut(double):
    """A bearing of about pi, half of the sigma points on either side of the cut."""
    model = mo.StateSpaceModel(
        mo.Gaussian([-5.0, 0.05], [[0.3, 0.05], [0.05, 0.4]]),
        mo.LinearGaussian(np.eye(2), 0.01 * np.eye(2)),
        mo.AdditiveGaussian(lambda x, u, t: jnp.arctan2(x[1], x[0])[None], [[0.01]], angles=(0,)),
    )
    turned = mo.StateSpaceModel(
        mo.Gaussian([5.0, -0.05], model.initial.cov()), model.dynamics, mo.AdditiveGaussian(model.sensor.f, [[0.01]], angles=(0,))
    )
    for filter in FILTERS.values():
        here, there = mo.run(0, filter, model, [[3.1]]), mo.run(0, filter, turned, [[3.1 - np.pi]])
        assert np.abs(here.mean + there.mean).max() < 1e-9
        assert np.abs(here.cov - there.cov).max() < 1e-9


@pytest.mark.night
def test_iterated_filter_finds_the_most_probable_state(double):
    """The maximum of prior times likelihood, by an independent least-squares solver; one measurement component is missing."""
    mean, cov, R = np.array([2.0, 1.0]), np.array([[0.8, 0.3], [0.3, 0.6]]), np.diag([0.02, 0.01, 0.05])

    def h(x):
        return jnp.stack([jnp.hypot(x[0], x[1]), jnp.exp(0.3 * x[0]), x[0] * x[1]])

    sensor = mo.AdditiveGaussian(lambda x, u, t: h(x), R)
    model = mo.StateSpaceModel(mo.Gaussian(mean, cov), mo.LinearGaussian(np.eye(2), np.eye(2)), sensor)
    y = np.array([3.4, np.nan, 3.9])
    root = np.linalg.inv(np.linalg.cholesky(cov))
    best = least_squares(lambda x: np.concatenate([root @ (x - mean), ((np.asarray(h(x)) - y) / np.sqrt(np.diag(R)))[[0, 2]]]), mean).x
    once, often = (np.asarray(mo.run(0, mo.ExtendedKalmanFilter(iterations=i), model, y[None]).mean[0]) for i in (1, 15))
    assert np.abs(often - best).max() < 1e-6
    assert np.abs(once - best).max() > 0.01


def test_the_kalman_filters_are_gaussian_filters_with_one_rule_each():
    """Each short name stands for its rule, and a rule of whoever writes one is taken as it is."""
    rules = {
        mo.KalmanFilter(): mo.gaussian.Linear(),
        mo.ExtendedKalmanFilter(iterations=3): mo.gaussian.Taylor(3),
        mo.UnscentedKalmanFilter(0.5, 1.0, 0.2): mo.gaussian.Unscented(0.5, 1.0, 0.2),
        mo.CubatureKalmanFilter(): mo.gaussian.Cubature(),
        mo.GaussHermiteFilter(degree=4): mo.gaussian.GaussHermite(4),
    }
    assert all(filter.rule == rule for filter, rule in rules.items())

    @record
    class Wide(mo.gaussian.Cubature):
        """Points farther out than those of the cubature rule: another covariance of curved functions."""

        def points(self, size):
            nodes, weights, offset = mo.gaussian.Cubature.points(self, size)
            return Points(np.sqrt(2) * nodes, weights / 2, offset)

    model, ys = quadratic(True), np.array([[1.3, -0.2], [0.4, np.nan], [0.1, 0.3]])
    short, same, other = (mo.run(0, filter, model, ys) for filter in (
        mo.CubatureKalmanFilter(), mo.GaussianFilter(mo.gaussian.Cubature()), mo.GaussianFilter(Wide())))  # fmt: skip
    assert np.array_equal(short.mean, same.mean) and np.array_equal(short.cov, same.cov)
    assert np.abs(np.asarray(short.cov) - np.asarray(other.cov)).max() > 1e-3
    with pytest.raises(mo.MotesError, match="GaussianFilter model: expected a linear-Gaussian model"):
        mo.run(0, mo.GaussianFilter(mo.gaussian.Linear()), model, ys)


def test_regression_on_all_states_is_an_unscented_rule(double):
    """The batched regression of kernels and proposals against the rule that its docstring names."""
    model = quadratic(False)
    factor = jnp.linalg.cholesky(model.initial.cov())
    found = regressed_on(model.sensor, (0, 1), model.initial.mean()[:, None], factor[..., None], None, 0)
    wanted, _ = regressed(model.sensor, mo.gaussian.Unscented(1.0, 0.0, 1.0).points(2), model.initial, factor, None, 0)
    for one, other in zip(found, wanted, strict=True):
        assert np.abs(one[..., 0] - other).max() < 1e-12


BANKS = {
    "interacting, iterated slopes": mo.InteractingMultipleModel(rule=mo.gaussian.Taylor(3)),
    "jump-Markov, sigma points": mo.JumpMarkovFilter(n=2, rule=mo.gaussian.Cubature()),
}


@pytest.mark.parametrize("bank", each(BANKS, but_one_in(BANKS, 2)))
def test_a_bank_of_one_mode_is_the_gaussian_filter_of_its_rule(bank, double):
    """Banks correct one component after the other, a single Gaussian all at once: two ways to one answer, a missing component included."""
    model, ys = quadratic(True), np.array([[1.3, -0.2], [0.4, np.nan], [0.1, 0.3]])
    one, many = (mo.run(0, filter, model, ys) for filter in (mo.GaussianFilter(bank.rule), bank))
    for field in ("mean", "cov"):
        assert np.abs(np.asarray(getattr(one, field)) - np.asarray(getattr(many, field))).max() < 1e-10
    assert np.abs(np.asarray(one.info.log_evidence) - np.asarray(many.info.log_evidence)).max() < 1e-10
    if bank.rule == mo.gaussian.Cubature():  # by iterated slopes a single Gaussian tells the distance at the last of them
        assert np.abs(np.asarray(one.info.nis) - np.asarray(many.info.nis)).max() < 1e-8


@pytest.mark.night
def test_smoothers_of_one_gaussian_and_of_mixtures_agree_by_every_rule(double):
    """Backward simulation of 20 000 paths about the Rauch-Tung-Striebel means (5 standard errors), whose rules differ by far more."""
    model, ys = quadratic(False), np.array([[1.3, -0.2], [0.4, 0.5], [0.1, 0.3]])
    history = mo.run(0, mo.InteractingMultipleModel(rule=mo.gaussian.Cubature()), model, ys, keep=mo.keep.laws)
    one = mo.run(0, mo.CubatureKalmanFilter(), model, ys)
    exact = [
        mo.smooth(0, mo.smoothers.RauchTungStriebelSmoother(rule), model, one) for rule in (mo.gaussian.Cubature(), mo.gaussian.Taylor())
    ]
    found = mo.smooth(0, mo.smoothers.MixtureSmoother(n=20_000, rule=mo.gaussian.Cubature()), model, history)
    error = 5 * np.sqrt(np.diagonal(np.asarray(exact[0].cov), axis1=1, axis2=2) / 20_000)
    assert (np.abs(np.asarray(found.mean) - np.asarray(exact[0].mean))[:-1] < error[:-1]).all()
    assert (np.abs(np.asarray(exact[1].mean) - np.asarray(exact[0].mean))[:-1] > error[:-1]).any()
