"""Linear-Gaussian models, where everything is known exactly."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.stats import multivariate_normal, norm

import motes as mo

SEED_LEVEL = 1e-6


def four_states():
    """Position and velocity along two coupled axes; asymmetric, correlated noises; both axes measured with unequal accuracy."""
    A = np.array([[1, 0, 0.5, 0], [0, 1, 0, 0.5], [0, 0.1, 0.9, 0], [-0.05, 0, 0.1, 0.8]])
    Q = np.diag([0.02, 0.03, 0.2, 0.1]) + 0.01
    H = np.array([[1.0, 0.2, 0, 0], [0, 1.0, 0.1, 0]])
    R = np.array([[0.3, 0.05], [0.05, 0.1]])
    P0 = np.diag([1.0, 2.0, 0.5, 0.7]) + 0.2
    return (np.array([1.0, -1.0, 0.3, 0.0]), P0, A, Q, H, R), mo.StateSpaceModel(
        mo.Gaussian(jnp.array([1.0, -1.0, 0.3, 0.0]), jnp.array(P0)),
        mo.LinearGaussian(jnp.array(A), jnp.array(Q)),
        mo.LinearGaussian(jnp.array(H), jnp.array(R)),
        ("px", "py", "vx", "vy"),
    )


def joint_normal(parts, ys):
    """Filtered means and covariances and the log likelihood from one big normal law of all states and measurements."""
    m0, P0, A, Q, H, R = parts
    steps, x = len(ys), len(m0)
    # x_t = A^t x_0 + sum_j A^(t-j) w_j as one linear map of (x_0, w_1, ..., w_T)
    maps = [np.hstack([np.eye(x), np.zeros((x, x * (steps - 1)))])]
    for t in range(1, steps):
        now = A @ maps[-1]
        now[:, x * t : x * (t + 1)] = np.eye(x)
        maps.append(now)
    source = np.zeros((x * steps, x * steps))
    source[:x, :x] = P0
    for t in range(1, steps):
        source[x * t : x * (t + 1), x * t : x * (t + 1)] = Q
    start = np.concatenate([m0, np.zeros(x * (steps - 1))])
    states = np.vstack(maps)
    state_mean, state_cov = states @ start, states @ source @ states.T
    C = np.kron(np.eye(steps), H)
    y_mean, y_cov = C @ state_mean, C @ state_cov @ C.T + np.kron(np.eye(steps), R)
    cross = state_cov @ C.T
    flat, means, covs = ys.ravel(), [], []
    for t in range(steps):
        rows = np.flatnonzero(~np.isnan(flat[: (t + 1) * len(R)]))
        here = slice(x * t, x * (t + 1))
        gain = np.linalg.solve(y_cov[np.ix_(rows, rows)], cross[here][:, rows].T).T
        means.append(state_mean[here] + gain @ (flat[rows] - y_mean[rows]))
        covs.append(state_cov[here, here] - gain @ cross[here][:, rows].T)
    rows = np.flatnonzero(~np.isnan(flat))
    total = multivariate_normal(y_mean[rows], y_cov[np.ix_(rows, rows)]).logpdf(flat[rows])
    return np.array(means), np.array(covs), total


@pytest.fixture
def case(double):
    parts, model = four_states()
    ys = np.array(mo.simulate(3, model, 15)[1])
    ys[4] = np.nan
    ys[7, 1] = np.nan
    return parts, model, ys


@pytest.mark.parametrize(
    "filter", [mo.KalmanFilter(), mo.ExtendedKalmanFilter(), mo.MarginalizedParticleFilter(n=3)], ids=lambda f: type(f).__name__
)
def test_equals_the_joint_normal_density(case, filter):
    parts, model, ys = case
    means, covs, total = joint_normal(parts, ys)
    history = mo.run(0, filter, model, ys)
    assert np.abs(history.mean - means).max() < 1e-9
    assert np.abs(history.cov - covs).max() < 1e-9
    assert abs(float(history.log_likelihood) - total) < 1e-9


def test_linear_functions_need_not_be_matrices(case):
    parts, model, ys = case
    A, H = jnp.array(parts[2]), jnp.array(parts[4])
    written = mo.StateSpaceModel(
        model.initial,
        mo.AdditiveGaussian(lambda x, u, t: jnp.stack([A[i] @ x for i in range(4)]), model.dynamics.Q),
        mo.AdditiveGaussian(lambda x, u, t: H @ x, model.sensor.Q),
    )
    assert np.abs(mo.run(0, mo.KalmanFilter(), written, ys).mean - mo.run(0, mo.KalmanFilter(), model, ys).mean).max() < 1e-12


PARTITIONS = [(), ("vx",), ("px", "py"), ("vx", "vy"), ("py", "vx", "vy"), ("px", "py", "vx", "vy")]


@pytest.mark.night
def test_every_partition_agrees_and_marginalizing_lowers_the_variance(case):
    """Means within Monte Carlo error (level 1e-6 over all tests of means); variance of the log likelihood falls with each move."""
    parts, model, ys = case
    exact = mo.run(0, mo.KalmanFilter(), model, ys)
    keys = jax.random.split(jax.random.key(11), 200)
    variances = {}
    for linear in PARTITIONS:
        filter = mo.MarginalizedParticleFilter(n=400, linear=linear)
        runs = jax.jit(jax.vmap(lambda key, filter=filter: _summary(mo.run(key, filter, model, jnp.asarray(ys)))))(keys)
        means, totals = (np.asarray(part) for part in runs)
        tests = means[0].size * len(PARTITIONS)
        critical = norm.isf(SEED_LEVEL / 2 / tests)
        standard_error = means.std(axis=0, ddof=1) / np.sqrt(len(means)) + 1e-9
        # a self-normalized estimate has a bias of order 1/n: about one standard deviation of the estimate over sqrt(n)
        bias = 2 * means.std(axis=0, ddof=1) / np.sqrt(400)
        assert np.all(np.abs(means.mean(axis=0) - np.asarray(exact.mean)) < critical * standard_error + bias)
        variances[linear] = totals.var(ddof=1)
        ratio = np.exp(totals - float(exact.log_likelihood))
        assert abs(ratio.mean() - 1) < 5 * ratio.std(ddof=1) / np.sqrt(len(ratio)) + 1e-9
    assert variances[()] > variances[("vx", "vy")] > variances[("py", "vx", "vy")] > variances[("px", "py", "vx", "vy")]
    assert variances[()] > variances[("vx",)] > variances[("vx", "vy")]
    assert variances[("px", "py", "vx", "vy")] < 1e-15


def _summary(history):
    return history.mean, history.log_likelihood


@pytest.mark.night
def test_likelihood_is_unbiased_for_each_scheme_and_policy(double):
    """S3: E[Zhat] / Z = 1 within 4 standard errors over 1000 runs, for every scheme and policy."""
    model = mo.StateSpaceModel(mo.Gaussian([0.3], [[1.0]]), mo.LinearGaussian([[0.8]], [[0.5]]), mo.LinearGaussian([[1.0]], [[0.3]]))
    ys = mo.simulate(1, model, 8)[1]
    exact = float(mo.run(0, mo.KalmanFilter(), model, ys).log_likelihood)
    keys = jax.random.split(jax.random.key(4), 1000)
    for scheme in (mo.resampling.Systematic(), mo.resampling.Stratified(), mo.resampling.Multinomial(), mo.resampling.Residual()):
        for policy in (mo.resampling.Always(), mo.resampling.ESS(0.5), mo.resampling.Never(), mo.resampling.Entropy(0.3)):
            filter = mo.ParticleFilter(n=60, scheme=scheme, policy=policy)
            totals = jax.jit(jax.vmap(lambda key, filter=filter: mo.run(key, filter, model, ys).log_likelihood))(keys)
            ratio = np.exp(np.asarray(totals) - exact)
            assert abs(ratio.mean() - 1) < 4 * ratio.std(ddof=1) / np.sqrt(1000), (scheme, policy)


def test_correlated_process_and_measurement_noise(double):
    """The decorrelated model's Kalman filter equals conditioning on the joint law of both noises."""
    rng = np.random.default_rng(0)
    A, H = np.array([[0.9, 0.2], [0.0, 0.8]]), np.array([[1.0, 0.5]])
    joint = np.array([[0.5, 0.1, 0.25], [0.1, 0.3, -0.1], [0.25, -0.1, 0.4]])
    Q, S, R = joint[:2, :2], joint[:2, 2:], joint[2:, 2:]
    model = mo.StateSpaceModel(
        mo.Gaussian([1.0, 0.0], np.diag([1.0, 2.0])), mo.LinearGaussian(A, Q), mo.LinearGaussian(H, R), noise_cross_cov=S
    )
    ys = rng.normal(size=(9, 1)) * 2
    ys[3] = np.nan
    mean, P, total = np.array([1.0, 0.0]), np.diag([1.0, 2.0]), 0.0
    for t, y in enumerate(ys):
        seen = not np.isnan(y[0])
        if seen:
            M = H @ P @ H.T + R
            total += norm(0, np.sqrt(M[0, 0])).logpdf(y - H @ mean)[0]
            cross, gain = A @ P @ H.T + S, P @ H.T / M
            ahead = A @ mean + (cross / M) @ (y - H @ mean)
            P_ahead = A @ P @ A.T + Q - cross @ cross.T / M
            mean, P = mean + gain @ (y - H @ mean), P - gain @ M @ gain.T
        else:
            ahead, P_ahead = A @ mean, A @ P @ A.T + Q
        if t < len(ys) - 1:
            mean, P = ahead, P_ahead
    for filter in (mo.KalmanFilter(), mo.MarginalizedParticleFilter(n=2)):
        history = mo.run(0, filter, model, ys)
        assert np.abs(history.mean[-1] - mean).max() < 1e-10
        assert np.abs(history.cov[-1] - P).max() < 1e-10
        assert abs(float(history.log_likelihood) - total) < 1e-10
    runs = jax.vmap(lambda key: mo.run(key, mo.ParticleFilter(n=2000), model, ys).log_likelihood)(jax.random.split(jax.random.key(0), 50))
    ratio = np.exp(np.asarray(runs) - total)
    assert abs(ratio.mean() - 1) < 5 * ratio.std() / np.sqrt(50)
    xs, ys = mo.simulate(0, model, 200_000)
    w = np.asarray(xs[1:] - xs[:-1] @ A.T)
    e = np.asarray(ys - xs @ H.T)[:-1]
    assert np.abs(np.cov(np.hstack([w, e]).T) - joint).max() < 0.01
