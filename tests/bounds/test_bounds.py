"""Bounds against exact answers: Kalman filters, numerical integrals of scores, and filters that must not beat them."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.stats import norm

import motes as mo
from data import refused
from motes.core.record import replace
from motes.gaussian.taylor import affine
from motes.models.textbook import radar_tracking
from tiers import each

CROSSED = np.array([[1, 0.2, 0.5], [0, 0.9, 0.1], [-0.05, 0.1, 0.8]])


def linear_model(singular=False, varying=False, sensor_noise=((0.3, 0.05), (0.05, 0.1))):
    """Three coupled states, correlated noises; perhaps noise on one state alone and a certain start of one, or changing in time."""
    spread = np.diag([0.0, 0.2, 0.0]) if singular else np.diag([0.02, 0.03, 0.2]) + 0.01
    prior = np.diag([1.0, 0.5, 0.0]) if singular else np.diag([1.0, 2.0, 0.5]) + 0.2
    A, Q, P0, R, H = map(jnp.asarray, (CROSSED, spread, prior, sensor_noise, [[1.0, 0.2, 0], [0, 1.0, 0.1]]))
    if not varying:
        dynamics, sensor = mo.LinearGaussian(A, Q), mo.LinearGaussian(H, R)
    else:
        dynamics = mo.LinearGaussian(lambda x, u, t: A * (1 + 0.1 * jnp.sin(t)) + 0.01 * u, lambda x, u, t: Q * (1 + 0.2 * t))
        sensor = mo.AdditiveGaussian(lambda x, u, t: H @ x * (1 + 0.1 * t) + u, lambda x, u, t: R * (1 + jnp.cos(t) ** 2))
    return mo.StateSpaceModel(mo.Gaussian(jnp.array([1.0, -1.0, 0.3]), P0), dynamics, sensor)


def kalman_cov(model, steps):
    """The Kalman filter's covariances in plain numpy, for constant matrices."""
    parts = (model.dynamics.A, model.dynamics.Q, model.sensor.A, model.sensor.Q, model.initial.cov())
    A, Q, H, R, P = (np.asarray(part, float) for part in parts)
    found = []
    for t in range(steps):
        P = A @ P @ A.T + Q if t else P
        P = P - P @ H.T @ np.linalg.solve(H @ P @ H.T + R, H @ P)
        found.append(P)
    return np.array(found)


def errors(cov, exact):
    """Largest entry of the difference, in units of the standard deviations that it belongs to."""
    scale = np.sqrt(np.einsum("tii->ti", exact)) + 1e-30
    return np.abs((cov - exact) / scale[:, :, None] / scale[:, None, :]).max()


LINEAR = {"plain": {}, "varying": {"varying": True}, "singular and varying": {"singular": True, "varying": True}}


@pytest.mark.optimized
@pytest.mark.parametrize("kind", each(list(LINEAR), {"plain", "varying"}))
def test_equals_the_kalman_filter_on_linear_models(double, kind):
    model = linear_model(**LINEAR[kind])
    inputs = np.linspace(-1, 2, 12) if "varying" in LINEAR[kind] else None
    exact = mo.run(0, mo.KalmanFilter(), model, np.zeros((12, 2)), inputs).cov
    assert np.abs(mo.bounds.posterior_cramer_rao(0, model, 12, trajectories=5, inputs=inputs).cov - exact).max() < 1e-10
    xs, _ = mo.simulate(1, model, 12, inputs)
    assert np.abs(mo.bounds.kalman_at_truth(model, xs, inputs).cov - exact).max() < 1e-10


def test_float32_keeps_its_digits_where_noises_differ_widely():
    """Noise variances of 100 and 1e-6, as of a radar; entries of the covariance of 1 beside 1e-7."""
    settings = {"sensor_noise": ((100.0, 0.0), (0.0, 1e-6))}
    exact = kalman_cov(linear_model(**settings), 40)
    cov = mo.bounds.posterior_cramer_rao(0, linear_model(**settings), 40, trajectories=300).cov
    assert cov.dtype == jnp.float32 and errors(np.asarray(cov, np.float64), exact) < 5e-4


def bend(x, u, t):
    """Affine in truth, but tracing cannot know: the form for slopes that vary must give the same."""
    A = jnp.asarray(CROSSED, x.dtype)
    return A @ jnp.where(jnp.sum(x) > 0, x, x * 1.0)


def test_both_forms_of_the_recursion_agree(double):
    """From an uncertain start, and from one that is certain of a state."""
    model = linear_model()
    other = replace(model, dynamics=mo.AdditiveGaussian(bend, model.dynamics.Q))
    for cov in (model.initial.cov(), jnp.diag(jnp.array([1.0, 0.0, 0.5]))):
        start = mo.Gaussian(model.initial.center, cov)
        found = mo.bounds.posterior_cramer_rao(3, replace(other, initial=start), 15, trajectories=20).cov
        assert errors(found, kalman_cov(replace(model, initial=start), 15)) < 1e-10


def test_noise_that_depends_on_the_state_is_seen_where_the_slope_is_constant(double):
    """One step from a known law: J' = E[1/Q] - (a E[1/Q])^2 / (1/P + a^2 E[1/Q] + E[(Q'/Q)^2] / 2), with Q = exp(x), so Q'/Q = 1."""
    dynamics, sensor = mo.LinearGaussian([[0.7]], lambda x, u, t: jnp.exp(x)[:, None]), mo.LinearGaussian([[1.0]], [[1e6]])
    model = mo.StateSpaceModel(mo.Gaussian([0.2], [[0.25]]), dynamics, sensor)
    precision = np.exp(-0.2 + 0.25 / 2)
    exact = precision - (0.7 * precision) ** 2 / (4 + 0.49 * precision + 0.5)
    found = mo.bounds.posterior_cramer_rao(0, model, 2, 400_000).cov[1, 0, 0]
    # the mean of exp(-x) over the draws has a relative standard deviation of 0.53 / 630
    assert abs(1 / found / exact - 1) < 4.9 * 0.53 / np.sqrt(400_000) + 1e-5


# ---- a scalar model in which everything is nonlinear, against scores integrated on grids ----

START, SPREAD = 0.7, 0.8


def scalar_model(vary=True):
    return mo.StateSpaceModel(
        mo.Gaussian([START], [[SPREAD**2]]),
        mo.AdditiveGaussian(lambda x, u, t: 0.8 * x + jnp.sin(2 * x), (lambda x, u, t: jnp.exp(jnp.sin(x))[:, None]) if vary else [[0.9]]),
        mo.AdditiveGaussian(lambda x, u, t: x**2 / 3, (lambda x, u, t: 0.2 + 0.3 * x[:, None] ** 2) if vary else [[0.4]]),
    )


def moments(part, x):
    return (0.8 * x + np.sin(2 * x), np.exp(np.sin(x))) if part == "dynamics" else (x**2 / 3, 0.2 + 0.3 * x**2)


def scores(part, x):
    """E[score score'] over the value given x, for the pair (x, value): products of central differences of the log density, integrated."""
    z = np.linspace(-9, 9, 2001)
    mean, var = moments(part, x)
    value = mean[:, None] + np.sqrt(var)[:, None] * z
    h = 1e-4

    def log_density(dx, dvalue):
        mean, var = moments(part, x + dx)
        return norm.logpdf(value + dvalue, mean[:, None], np.sqrt(var)[:, None])

    by_x = (log_density(h, 0) - log_density(-h, 0)) / (2 * h)
    by_value = (log_density(0, h) - log_density(0, -h)) / (2 * h)
    weight = norm.pdf(z) * (z[1] - z[0])
    return [(a * b) @ weight for a, b in ((by_x, by_x), (by_x, by_value), (by_value, by_value))]


def integrated_bound(steps):
    """The recursion with expectations over the exact law of the state, moved over a grid."""
    grid = np.linspace(-14, 14, 4001)
    step = grid[1] - grid[0]
    density = norm.pdf(grid, START, SPREAD)
    in_sensor, (D11, D12, D22) = scores("sensor", grid)[0], scores("dynamics", grid)
    J, found = 1 / SPREAD**2, []
    mean, var = moments("dynamics", grid)
    kernel = norm.pdf(grid[:, None], mean, np.sqrt(var)) * step
    for t in range(steps):
        if t:
            e11, e12, e22 = (np.sum(density * D) * step for D in (D11, D12, D22))
            J = e22 - e12**2 / (J + e11)
            density = kernel @ density
            assert abs(density.sum() * step - 1) < 1e-6
        J = J + np.sum(density * in_sensor) * step
        found.append(1 / J)
    return np.array(found)


@pytest.mark.night
def test_equals_integrated_scores(double):
    """Level 1e-6 over all steps: 12 keys, whose spread gives the standard error of their mean."""
    steps = 5
    keys = jax.random.split(jax.random.key(2), 12)
    covs = jax.vmap(lambda key: mo.bounds.posterior_cramer_rao(key, scalar_model(), steps, 20_000).cov[:, 0, 0])(keys)
    exact = integrated_bound(steps)
    standard_error = np.asarray(covs.std(axis=0, ddof=1)) / np.sqrt(len(keys))
    assert np.all(standard_error < 3e-3 * exact)
    # Student's t with 11 degrees of freedom: 11.4 standard errors for 1e-6 over 5 steps
    assert np.all(np.abs(covs.mean(axis=0) - exact) < 11.4 * standard_error)


# ---- the radar ----

def test_no_filter_beats_it_and_a_good_one_comes_close():
    """Level 1e-6 over both models: errors of a filter over tracks of their own are not below the bound by more than chance.

    Where the tracks lie close together, the filter is within 10 percent of it; on the tracks of the paper's model, which the radar sees
    from different directions, the bound is far below.
    """
    steps, runs = 20, 80
    filter = mo.MarginalizedParticleFilter(n=1000)

    def squares(key, model):
        xs, ys = mo.simulate(key, model, steps)
        off = mo.run(jax.random.fold_in(key, 1), filter, model, ys).mean - xs
        return jnp.stack([jnp.mean(jnp.sum(off[:, block] ** 2, axis=1)) for block in (slice(0, 2), slice(2, 4))])

    wide = radar_tracking()
    calm = replace(
        wide, initial=mo.Gaussian(wide.initial.center, wide.initial.covariance / 100), dynamics=replace(wide.dynamics, Q=wide.dynamics.Q /
        100)
    )
    draws = jax.jit(jax.vmap(squares, (0, None)))
    for model, furthest in ((calm, 1.1), (wide, 2.0)):
        found = np.asarray(draws(jax.random.split(jax.random.key(5), runs), model))
        bound = mo.bounds.posterior_cramer_rao(0, model, steps)
        for block, mean_squares in zip((("px", "py"), ("vx", "vy")), found.T, strict=True):
            limit, error = float(bound.overall_rmse(block)) ** 2, 5.2 * mean_squares.std(ddof=1) / np.sqrt(runs)
            assert limit - error < mean_squares.mean() < furthest**2 * limit + error


def test_kalman_at_truth_is_the_recursion_at_the_track(double):
    model = radar_tracking()
    xs, _ = mo.simulate(4, model, 8)
    A, Q, P, R = (np.asarray(part) for part in (model.dynamics.A, model.dynamics.Q, model.initial.cov(), model.sensor.Q))
    for t, (px, py) in enumerate(np.asarray(xs[:, :2])):
        P = A @ P @ A.T + Q if t else P
        r = np.hypot(px, py)
        H = np.zeros((2, 6))
        H[0, :2], H[1, :2] = [px / r, py / r], [-py / r**2, px / r**2]
        P = P - P @ H.T @ np.linalg.solve(H @ P @ H.T + R, H @ P)
    bound = mo.bounds.kalman_at_truth(model, xs)
    assert np.abs(bound.cov[-1] - P).max() < 1e-9
    assert "track" in bound.kind and bound.names == model.names
    # slope and noise of the dynamics at the state that is left, those of the sensor at the one that is reached
    track, variance = np.array([0.4, -0.9, 1.7]), SPREAD**2
    for t, x in enumerate(track):
        if t:
            before = track[t - 1]
            variance = (0.8 + 2 * np.cos(2 * before)) ** 2 * variance + moments("dynamics", before)[1]
        variance = 1 / (1 / variance + (2 * x / 3) ** 2 / moments("sensor", x)[1])
        assert float(mo.bounds.kalman_at_truth(scalar_model(), track[:, None]).cov[t, 0, 0]) == pytest.approx(variance, rel=1e-12)


# ---- what readers get ----


def test_errors_of_blocks(double):
    covs = np.stack([np.diag([4.0, 9.0, 1.0]), np.diag([16.0, 9.0, 0.0])])
    bound = mo.bounds.Bound(jnp.asarray(covs), ("px", "py", "bias"), "some bound")
    np.testing.assert_allclose(bound.rmse(("px", "py")), np.sqrt([13, 25]))
    np.testing.assert_allclose(bound.rmse("bias"), [1, 0])
    np.testing.assert_allclose(bound.rmse((-1,)), [1, 0])
    assert float(bound.overall_rmse(("px", 1))) == pytest.approx(np.sqrt(19))
    dataset = bound.to_xarray()
    assert dataset["cov"].dims == ("time", "state", "state2") and dataset.attrs["bound"] == "some bound"
    for states in ((), ("px", "px"), "speed", ("px", 7)):
        with pytest.raises(mo.MotesError) as error:
            bound.rmse(states)
        refused(error, "state")


def test_pure(double):
    """Under jit, vmap and grad: the same numbers."""
    model = scalar_model()
    keys = jax.random.split(jax.random.key(1), 2)
    together = jax.jit(jax.vmap(lambda key: mo.bounds.posterior_cramer_rao(key, model, 4, 50).cov))(keys)
    assert np.abs(together[1] - mo.bounds.posterior_cramer_rao(keys[1], model, 4, 50).cov).max() < 1e-12

    def last(scale):
        scaled = replace(scalar_model(False), sensor=mo.AdditiveGaussian(lambda x, u, t: x**2 / 3, scale * jnp.eye(1)))
        return mo.bounds.posterior_cramer_rao(1, scaled, 4, 50).cov[-1, 0, 0]

    slope = jax.grad(last)(0.4)
    assert float(slope) == pytest.approx(float(last(0.4001) - last(0.3999)) / 2e-4, rel=1e-5)


def test_mixed_linear_models(double):
    """All linear, so that the Kalman filter of the joined model is exact; the particle state stands between the others."""
    mixed = mo.MixedLinearModel(
        mo.Gaussian([0.3], [[1.0]]),
        mo.Gaussian([0.1, -0.2], np.diag([0.5, 2.0])),
        particle=lambda x, u, t: (0.9 * x, jnp.array([[1.0, 0.2]]), jnp.array([[0.3]])),
        kalman=lambda x, u, t: (jnp.stack([x[0], 0.1 * x[0]]), jnp.array([[0.9, 0.1], [0.0, 0.8]]), jnp.diag(jnp.array([0.1, 0.2]))),
        sensor=lambda x, u, t: (x, jnp.array([[1.0, 0.0]]), jnp.array([[0.5]])),
        linear=(0, 2),
    )
    A, H = np.array([[0.9, 1, 0.1], [1, 0.9, 0.2], [0, 0.1, 0.8]]), np.array([[1.0, 1, 0]])
    start = mo.Gaussian(np.zeros(3), np.diag([0.5, 1.0, 2.0]))
    written = mo.StateSpaceModel(start, mo.LinearGaussian(A, np.diag([0.1, 0.3, 0.2])), mo.LinearGaussian(H, [[0.5]]))
    assert np.abs(mo.bounds.posterior_cramer_rao(0, mixed, 8, 5).cov - kalman_cov(written, 8)).max() < 1e-12


CASES = {
    "other noise": (lambda m: {"sensor": mo.AdditiveNoise(m.sensor.f, mo.StudentT([0.1], 5.0))}, ("sensor", "AdditiveNoise")),
    "custom": (lambda m: {"dynamics": mo.Custom(sample=lambda key, x, u, t: x)}, ("dynamics", "Custom")),
    "initial law": (lambda m: {"initial": mo.Mixture.of([0.5, 0.5], [[0.0, 1.0]], [[[1.0, 1.0]]])}, ("initial", "Gaussian", "Mixture")),
    "correlated": (lambda m: {"noise_cross_cov": jnp.array([[0.1]])}, ("independent", "noise_cross_cov")),
    "singular Q": (lambda m: {"dynamics": mo.AdditiveGaussian(m.dynamics.f, [[0.0]])}, ("dynamics Q", "positive definite", "step 1")),
    "singular R": (lambda m: {"sensor": mo.AdditiveGaussian(m.sensor.f, [[0.0]])}, ("sensor Q", "positive definite", "step 0")),
    "not finite": (lambda m: {"sensor": mo.AdditiveGaussian(lambda x, u, t: x / (t - 2.0), [[1.0]])}, ("finite", "step 2")),
}


@pytest.mark.parametrize("name", CASES)
def test_models_without_a_bound_are_refused(name):
    changes, words = CASES[name]
    model = scalar_model(False)
    with pytest.raises(mo.MotesError) as error:
        mo.bounds.posterior_cramer_rao(0, replace(model, **changes(model)), 5, 20)
    refused(error, "posterior_cramer_rao", *words)


def test_other_refusals():
    model, density = scalar_model(), mo.Custom(log_prob=lambda y, x, u, t: 0.0)
    for attempt, words in (
        (lambda: mo.bounds.posterior_cramer_rao(0, model, 0), ("steps", "0")),
        (lambda: mo.bounds.posterior_cramer_rao(0, model, 3, 0), ("trajectories", "0")),
        (lambda: mo.bounds.posterior_cramer_rao(0, model, 3, inputs=np.ones(2)), ("inputs", "3 steps")),
        (lambda: mo.simulate(0, model, 3, inputs=np.ones(2)), ("inputs", "3 steps")),
        (lambda: mo.bounds.kalman_at_truth(model, np.ones(4)), ("xs", "(any, 1)")),
        (lambda: mo.bounds.kalman_at_truth(replace(model, noise_cross_cov=jnp.array([[0.1]])), np.ones((4, 1))), ("noise_cross_cov",)),
        (lambda: mo.bounds.kalman_at_truth(replace(model, sensor=density), np.ones((4, 1))), ("sensor", "Custom")),
    ):
        with pytest.raises(mo.MotesError) as error:
            attempt()
        refused(error, *words)


def test_a_step_that_would_be_refused_gives_nan_inside_jit():
    model = replace(scalar_model(False), sensor=mo.AdditiveGaussian(lambda x, u, t: x / (t - 2.0), [[1.0]]))
    cov = jax.jit(lambda key: mo.bounds.posterior_cramer_rao(key, model, 5, 20).cov)(jax.random.key(0))
    assert np.isnan(cov).ravel().tolist() == [False, False, True, True, True]


def test_a_matrix_that_depends_on_the_state_has_a_slope_of_its_own(double):
    """A(x) x has the slope of the same function written out, not A(x)."""

    def turn(x, u, t):
        return jnp.array([[jnp.cos(x[1]), 0.1 * t], [0.2 * x[0], 0.9]])

    parts = mo.LinearGaussian(turn, 0.3 * np.eye(2)), mo.AdditiveGaussian(lambda x, u, t: turn(x, u, t) @ x, 0.3 * np.eye(2))
    for given, written in zip(*(affine(part, jnp.array([0.5, -0.2]), None, 3) for part in parts), strict=True):
        assert np.abs(given - written).max() < 1e-15
