"""Proposals and the auxiliary filter against exact answers: the Kalman filter, a grid, and each other where they are the same law."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.stats import multivariate_normal, norm

import motes as mo
from tiers import each

pytestmark = pytest.mark.jax

LEVEL = 1e-6
A = np.array([[0.9, 0.5, 0.0], [0.0, 0.8, 0.3], [0.1, 0.0, 0.7]])
Q = np.diag([0.0, 0.4, 0.2])  # the first state has no noise of its own
H = np.array([[1.0, 0.4, 0.0], [0.0, 1.0, -0.5]])
R = np.array([[0.2, 0.03], [0.03, 0.1]])


def linear(scale=1.0):
    return mo.StateSpaceModel(
        mo.Gaussian([0.5, -0.3, 0.0], np.diag([0.5, 0.3, 0.4])), mo.LinearGaussian(A, Q), mo.LinearGaussian(H, scale * R), ("a", "b", "c")
    )


def measured(model, steps=8, gaps=True):
    ys = np.array(mo.simulate(3, model, steps)[1])
    if gaps:
        ys[3] = np.nan
        ys[5, 1] = np.nan
    return jnp.asarray(ys)


def many(filter, model, ys, runs=400, keep=mo.keep.means):
    """Log likelihoods `(runs,)` and means `(runs, t, x)` of many runs."""
    keys = jax.random.split(jax.random.key(4), runs)

    def one(key):
        history = mo.run(key, filter, model, ys, keep=keep)
        return history.log_likelihood, history.mean

    return (np.asarray(part) for part in jax.jit(jax.vmap(one))(keys))


def check_unbiased(totals, exact, tests=1):
    ratio = np.exp(totals - float(exact))
    assert abs(ratio.mean() - 1) < norm.isf(LEVEL / 2 / tests) * ratio.std(ddof=1) / np.sqrt(len(ratio))


def check_means(means, exact, n):
    """Within the critical value for all entries together, and a bias of order 1/n of self-normalized estimates."""
    error, spread = np.abs(means.mean(axis=0) - np.asarray(exact)), means.std(axis=0, ddof=1)
    assert np.all(error < norm.isf(LEVEL / 2 / error.size) * spread / np.sqrt(len(means)) + 2 * spread / np.sqrt(n) + 1e-9)


GUIDED = {
    "optimal": mo.ParticleFilter(n=100, proposal=mo.OptimalProposal()),
    "unscented": mo.ParticleFilter(n=100, proposal=mo.UnscentedProposal(), policy=mo.resampling.Always()),
    "auxiliary": mo.AuxiliaryParticleFilter(n=100, policy=mo.resampling.Always()),
    "auxiliary, now and then": mo.AuxiliaryParticleFilter(n=100, proposal=mo.OptimalProposal(), scheme=mo.resampling.Multinomial()),
    "fully adapted": mo.AuxiliaryParticleFilter(n=100, proposal=mo.OptimalProposal(), policy=mo.resampling.Always()),
}


@pytest.mark.parametrize("name", each(list(GUIDED), {"unscented", "auxiliary", "auxiliary, now and then", "optimal"}))
def test_likelihood_and_means_are_those_of_the_kalman_filter(name, double):
    """A state without noise, a row and a component missing; level 1e-6 for the likelihood and for all means together."""
    # scored by p(y | mean), second-stage weights have a variance only where R is wide beside the process noise
    model = linear(8.0 if name == "auxiliary" else 1.0)
    ys = measured(model)
    exact = mo.run(0, mo.KalmanFilter(), model, ys)
    totals, means = many(GUIDED[name], model, ys)
    check_unbiased(totals, exact.log_likelihood)
    check_means(means, exact.mean, 100)


@pytest.mark.night
def test_local_proposals_are_the_optimal_one_where_the_sensor_is_linear(double):
    """The same draws give the same history: the weights of the local ones are three densities, of the optimal one the evidence."""
    model = linear()
    ys = measured(model)
    kinds = (mo.OptimalProposal(), mo.ExtendedKalmanProposal(), mo.UnscentedProposal())
    runs = [mo.run(1, mo.ParticleFilter(n=50, proposal=proposal), model, ys, keep=mo.keep.means) for proposal in kinds]
    for other in runs[1:]:
        assert np.allclose(other.mean, runs[0].mean, atol=1e-9) and np.allclose(other.log_evidence, runs[0].log_evidence, atol=1e-9)


def test_optimal_weight_is_the_predictive_density(double):
    """By SciPy, particle by particle; and states without noise go where the dynamics send them."""
    model = linear()
    X = np.asarray(model.initial.sample(jax.random.key(1), 40))
    y = jnp.array([0.7, -1.1])
    move = jax.jit(lambda key, X: mo.OptimalProposal().proposed(key, model, X, y, None, 1))
    done = move(jax.random.key(2), jnp.asarray(X))
    wanted = [multivariate_normal(H @ A @ x, H @ Q @ H.T + R).logpdf(y) for x in X.T]
    assert np.allclose(done.log_weight, wanted, atol=1e-10)
    assert np.allclose(done.particles[0], (A @ X)[0], atol=1e-12)
    assert np.allclose(mo.OptimalProposal().score(model, jnp.asarray(X), y, None, 1), wanted, atol=1e-10)
    drawn = np.asarray(move(jax.random.key(3), jnp.asarray(np.repeat(X[:, :1], 60_000, axis=1))).particles)
    gain = Q @ H.T @ np.linalg.inv(H @ Q @ H.T + R)
    mean, cov = A @ X[:, 0] + gain @ (np.asarray(y) - H @ A @ X[:, 0]), Q - gain @ H @ Q
    assert np.all(np.abs(drawn.mean(axis=1) - mean) < 5.5 * np.sqrt(np.diag(cov) / 60_000) + 1e-9)
    assert np.allclose(np.cov(drawn), cov, atol=0.01)


def test_fully_adapted_filter_has_equal_weights_and_the_exact_evidence(double):
    model = linear()
    ys = measured(model, gaps=False)
    filter = GUIDED["fully adapted"]
    before = mo.run(2, filter, model, ys[:5])
    after = mo.run(2, filter, model, ys[5:6], after=before)
    assert np.allclose(after.state.log_weights, -np.log(100), atol=1e-9)
    each = [multivariate_normal(H @ A @ x, H @ Q @ H.T + R).pdf(ys[5]) for x in np.asarray(before.state.particles).T]
    assert np.allclose(float(after.log_evidence[0]), np.log(np.asarray(before.state.weights) @ each), atol=1e-9)


@pytest.mark.night
def test_looking_ahead_pays_where_the_sensor_is_sharp(double):
    """Variance of the log likelihood: adapted at least 30 times below the bootstrap filter, guided between them."""
    H2, tight = np.eye(2, 3, k=1), np.diag([4e-4, 1e-3])
    model = mo.StateSpaceModel(mo.Gaussian([0.5, -0.3, 0.0], 0.01 * np.eye(3)), mo.LinearGaussian(A, Q), mo.LinearGaussian(H2, tight))
    ys = measured(model, 6, gaps=False)
    adapted = mo.AuxiliaryParticleFilter(n=200, proposal=mo.OptimalProposal(), policy=mo.resampling.Always())
    guided = mo.ParticleFilter(n=200, proposal=mo.OptimalProposal(), policy=mo.resampling.Always())
    spread = [np.var(next(many(filter, model, ys, 100))) for filter in (mo.ParticleFilter(n=200), guided, adapted)]
    assert spread[0] > 30 * spread[2] and spread[0] > 5 * spread[1]


def curved(state_noise=False):
    """Bistable dynamics, a sensor that is curved, and heavy-tailed noise of one of its components."""
    noise = (lambda x, u, t: jnp.array([[0.3 + 0.1 * jnp.tanh(x[0]) ** 2]])) if state_noise else [[0.35]]
    dynamics = mo.AdditiveGaussian(lambda x, u, t: 0.6 * x + 1.2 * jnp.sin(1.5 * x), noise)
    if state_noise:
        sensor = mo.AdditiveGaussian(
            lambda x, u, t: jnp.array([3.0 + jnp.arctan(0.7 * x[0]), 0.8 * x[0]]), np.diag([0.05, 0.3]), angles=(0,)
        )
    else:
        sensor = mo.AdditiveNoise(lambda x, u, t: jnp.stack([x[0] + 0.1 * x[0] ** 3, x[0]]), mo.StudentT([0.3, 0.5], 1.5))
    return mo.StateSpaceModel(mo.Gaussian([0.2], [[0.5]]), dynamics, sensor)


NONLINEAR = {
    "extended Kalman": mo.ParticleFilter(n=300, proposal=mo.ExtendedKalmanProposal()),
    "unscented": mo.ParticleFilter(n=300, proposal=mo.UnscentedProposal()),
    "auxiliary": mo.AuxiliaryParticleFilter(n=300),
    "auxiliary unscented": mo.AuxiliaryParticleFilter(n=300, proposal=mo.UnscentedProposal()),
    "auxiliary with a law of its own": mo.AuxiliaryParticleFilter(n=300, proposal=mo.AdditiveGaussian(
        lambda x, uy, t: 0.8 * (0.6 * x + 1.2 * jnp.sin(1.5 * x)) + 0.2 * jnp.clip(jnp.nan_to_num(uy[1][1:]), -3, 3), [[0.5]])),
}  # fmt: skip


@pytest.mark.night
@pytest.mark.parametrize(("name", "state_noise"), [
    pytest.param(n, i % 2 == 1, id=n, marks=[pytest.mark.night] * ("unscented" in n or n == "auxiliary")) for i, n in enumerate(NONLINEAR)])
def test_nonlinear_models_against_the_grid(name, state_noise, double):
    """Noise without a variance (it guides nothing), noise that depends on the state, and an angle that is wrapped."""
    model = curved(state_noise)
    ys = np.array(mo.simulate(2, model, 10)[1])
    ys[4, 0] = np.nan
    ys[7] = np.nan
    exact = mo.run(0, mo.PointMassFilter(-7.0, 7.0, 700), model, ys)
    totals, means = many(NONLINEAR[name], model, jnp.asarray(ys), 200)
    check_unbiased(totals, exact.log_likelihood)
    check_means(means, exact.mean, 300)


@pytest.mark.night
def test_scores_that_are_no_numbers_leave_no_particle_out(double):
    """Noise of bounded support: p(y | mean) is zero for most particles that can still explain y."""
    model = mo.StateSpaceModel(
        mo.Gaussian([0.0], [[1.0]]), mo.LinearGaussian([[0.9]], [[1.0]]), mo.AdditiveNoise(lambda x, u, t: x, mo.Uniform([-0.2], [0.2]))
    )
    ys = mo.simulate(1, model, 6)[1]
    exact = mo.run(0, mo.PointMassFilter(-8.0, 8.0, 3200), model, ys)
    totals, _ = many(mo.AuxiliaryParticleFilter(n=400), model, ys, 300)
    ratio = np.exp(totals - float(exact.log_likelihood))
    # the grid knows an interval of 0.4 to one node in 80
    assert abs(ratio.mean() - 1) < norm.isf(LEVEL / 2) * ratio.std(ddof=1) / np.sqrt(300) + 0.05


def test_float32_holds_for_a_sharp_sensor():
    """The three densities of a local proposal cancel to the evidence, which SciPy knows, although R is 1e-5 of the process noise."""
    model, y = linear(1e-5), jnp.array([0.7, -1.1])
    X = model.initial.sample(jax.random.key(1), 500)
    wanted = multivariate_normal(np.zeros(2), H @ Q @ H.T + 1e-5 * R).logpdf((np.asarray(y)[:, None] - H @ A @ np.asarray(X)).T)
    for proposal in (mo.ExtendedKalmanProposal(), mo.UnscentedProposal()):
        done = jax.jit(lambda X, proposal=proposal: proposal.proposed(jax.random.key(2), model, X, y, None, 1))(X)
        assert done.log_weight.dtype == np.float32 and np.abs(np.asarray(done.log_weight) - wanted).max() < 0.05


@pytest.mark.night
def test_a_hopeless_measurement_is_a_collapse():
    model = linear()
    ys = np.asarray(measured(model, 4, gaps=False)).copy()
    ys[2] += 1e4
    for proposal in (mo.OptimalProposal(), mo.UnscentedProposal()):
        with pytest.raises(mo.CollapseError, match="step 2"):
            mo.run(0, mo.AuxiliaryParticleFilter(n=50, proposal=proposal), model, ys, keep=mo.keep.means)
