"""Every way to the parameters reaches the exact posterior, has uniform ranks, and says what it cannot use."""


import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

import motes as mo
from motes.core import random
from motes.core.checks import CollapseError, MotesError
from tiers import NIGHT, each

mcmc, parameters = mo.mcmc, mo.parameters
STEPS = 12
PRIOR = mo.Gaussian(jnp.array([0.0, -0.5]), jnp.array([[1.0, 0.2], [0.2, 0.25]]))


def model(theta):
    """Level and log standard deviation of an autoregression, seen with noise."""
    return mo.StateSpaceModel(mo.Gaussian(jnp.zeros(1), jnp.eye(1)),
                              mo.AdditiveGaussian(lambda x, u, t: 0.8 * x + theta[0], jnp.exp(2 * theta[1]) * jnp.eye(1)),
                              mo.AdditiveGaussian(lambda x, u, t: x, 0.5 * jnp.eye(1)))  # fmt: skip


YS = jnp.asarray(mo.simulate(3, model(jnp.array([0.5, -0.7])), STEPS)[1]).at[4].set(jnp.nan)
BY_PARTICLES = parameters.Posterior(PRIOR, model, mo.ParticleFilter(n=60), YS)
PATHS = parameters.PathPosterior(PRIOR, model, YS)
GIBBS = mcmc.Cycle([parameters.ParticleGibbs(15), mcmc.Repeat(mcmc.Block("theta", mcmc.RandomWalkMetropolis(jnp.array([0.2, 0.4]))), 4)])


@pytest.fixture(scope="module")
def exact():
    """Mean and covariance of the parameters, and the evidence, on a grid with the Kalman filter."""
    posterior = parameters.Posterior(PRIOR, model, mo.KalmanFilter(), YS)
    level, log_sd = (np.linspace(-1.0, 2.0, 121), np.linspace(-3.2, 1.8, 121))
    points = jnp.asarray(np.stack(np.meshgrid(level, log_sd, indexing="ij"), axis=-1).reshape(-1, 2), jnp.float32)
    log_p = np.asarray(jax.jit(jax.vmap(posterior))(points), np.float64)
    weights = np.exp(log_p - log_p.max())
    evidence = np.log(weights.sum() * (level[1] - level[0]) * (log_sd[1] - log_sd[0])) + log_p.max()
    weights /= weights.sum()
    mean = weights @ np.asarray(points)
    off = np.asarray(points) - mean
    return mean, (off * weights[:, None]).T @ off, evidence


def close(draws, exact, allowed=0.0):
    """Compare means and mean squares (chain, draw, 2) with the exact ones, to 4.9 standard errors and what is allowed on top."""
    mean, cov, _ = exact
    for k in range(2):
        for power, truth in ((1, mean[k]), (2, cov[k, k] + mean[k] ** 2)):
            values = np.asarray(draws)[..., k].astype(float) ** power
            assert abs(values.mean() - truth) < 4.9 * mcmc.standard_error(values) + allowed * np.sqrt(cov[k, k])


@pytest.mark.night
def test_particle_marginal_metropolis_hastings(exact):
    kernel = mcmc.Adaptive(mcmc.PseudoMarginal(mcmc.RandomWalkMetropolis()), steps=500)
    chains = mo.sample(0, kernel, BY_PARTICLES, BY_PARTICLES.starts, draws=1_500, chains=8, burn_in=500)
    close(chains.positions, exact)


CORRELATED = mcmc.PseudoMarginal(mcmc.RandomWalkMetropolis(jnp.array([0.2, 0.6])), renewed=0.1)


@pytest.mark.night
def test_correlated_chains(exact):
    posterior = parameters.Posterior(PRIOR, model, mo.ParticleFilter(n=20, scheme=mo.resampling.Sorted()), YS)
    chains = mo.sample(0, CORRELATED, posterior, posterior.starts, draws=2_000, chains=8, burn_in=500)
    close(chains.positions, exact)


@pytest.mark.night
def test_renewed_numbers_keep_most_of_the_likelihood():
    longer = mo.simulate(4, model(jnp.array([0.5, -0.7])), 100)[1]
    theta = jnp.array([0.4, -0.6])

    def pairs(scheme):
        posterior = parameters.Posterior(PRIOR, model, mo.ParticleFilter(n=100, scheme=scheme), longer)

        def one(key):
            keys = CORRELATED._renewed(key, posterior, None)
            again = CORRELATED._renewed(random.child(key, 3), posterior, jax.random.key_data(keys))
            return jnp.stack([posterior.estimate(keys, theta), posterior.estimate(again, theta)])

        return np.asarray(jax.jit(jax.vmap(one))(jax.vmap(lambda k: random.step_key(random.as_key(2), k))(jnp.arange(300)))).T

    shared = np.corrcoef(pairs(mo.resampling.Sorted()))[0, 1]
    assert shared > 0.7 and shared > np.corrcoef(pairs(mo.resampling.Systematic()))[0, 1] + 0.1


def test_every_step_is_renewed_equally_often():
    old = jnp.zeros((STEPS, 2), jnp.uint32)
    keys = jax.vmap(lambda k: random.step_key(random.as_key(1), k))(jnp.arange(5_000))
    kernel = mcmc.PseudoMarginal(mcmc.RandomWalkMetropolis(), renewed=0.3)
    changed = jax.vmap(lambda key: jnp.any(jax.random.key_data(kernel._renewed(key, BY_PARTICLES, old)) != 0, axis=1))(keys)
    counts = np.asarray(changed).sum(axis=0)
    assert np.abs(counts / 5_000 - 4 / 15).max() < 4.9 * np.sqrt(4 / 15 * 11 / 15 / 5_000)


@pytest.mark.night
@pytest.mark.parametrize("paths", [parameters.ParticleGibbs(15), parameters.RaoBlackwellizedParticleGibbs(1)],
                         ids=lambda paths: type(paths).__name__)  # fmt: skip
def test_particle_gibbs(exact, paths):
    chains = mo.sample(0, mcmc.Cycle([paths, GIBBS.kernels[1]]), PATHS, PATHS.start, draws=2_000, chains=8, burn_in=200)
    close(chains.positions["theta"], exact)
    assert chains.acceptance[type(paths).__name__] > 0.8


@pytest.mark.night
@pytest.mark.parametrize(
    "scheme",
    [
        mo.resampling.Systematic(),
        pytest.param(mo.resampling.Multinomial(), marks=pytest.mark.night),
        pytest.param(mo.resampling.Killing(), marks=pytest.mark.night),
    ],
    ids=lambda scheme: type(scheme).__name__,
)
def test_paths_given_parameters_have_the_smoothers_law(scheme):
    theta = jnp.array([0.4, -0.6])
    fixed = parameters.PathPosterior(mo.Gaussian(theta, 1e-12 * jnp.eye(2)), lambda _: model(theta), YS)
    chains = mo.sample(1, parameters.ParticleGibbs(8, scheme), fixed, fixed.start, draws=2_000, chains=8, burn_in=100)
    history = mo.run(0, mo.KalmanFilter(), model(theta), YS)
    smoothed = mo.smooth(0, mo.smoothers.RauchTungStriebelSmoother(), model(theta), history)
    paths = np.asarray(chains.positions["path"])[..., 0].astype(float)
    for t in range(STEPS):
        for power, truth in ((1, smoothed.mean[t, 0]), (2, smoothed.cov[t, 0, 0] + smoothed.mean[t, 0] ** 2)):
            values = paths[..., t] ** power
            assert abs(values.mean() - float(truth)) < 5.3 * mcmc.standard_error(values)


def pair(theta):
    """Two states of which both, one or none may be marginalized; correlated, with a jump in the cross terms."""
    return mo.StateSpaceModel(mo.Gaussian(jnp.array([0.5, 0.0]), jnp.array([[1.0, 0.4], [0.4, 0.6]])),
                              mo.LinearGaussian(jnp.array([[0.8, 0.5], [-0.1, 0.9]]), jnp.array([[0.3, 0.1], [0.1, 0.2]])),
                              mo.LinearGaussian(jnp.array([[1.0, 0.3]]), jnp.array([[0.4]])), ("a", "b"))  # fmt: skip


PAIR_YS = jnp.asarray(mo.simulate(5, pair(None), STEPS)[1]).at[6].set(jnp.nan)


@pytest.mark.night
@pytest.mark.parametrize("n, linear", [
    (4, ("b",)), pytest.param(6, ("a",), marks=pytest.mark.night), pytest.param(1, None, marks=pytest.mark.night),
], ids=["b", "a", "both"])
def test_half_marginalized_paths_have_the_smoothers_law(n, linear):
    kernel = parameters.RaoBlackwellizedParticleGibbs(n, linear)
    fixed = parameters.PathPosterior(mo.Gaussian(jnp.zeros(1), 1e-12 * jnp.eye(1)), pair, PAIR_YS)
    chains = mo.sample(1, kernel, fixed, fixed.start, draws=4_000, chains=8, burn_in=100)
    smoothed = mo.smooth(0, mo.smoothers.RauchTungStriebelSmoother(), pair(None), mo.run(0, mo.KalmanFilter(), pair(None), PAIR_YS))
    paths = np.asarray(chains.positions["path"]).astype(float)
    second = np.asarray(smoothed.cov) + np.asarray(smoothed.mean)[:, :, None] * np.asarray(smoothed.mean)[:, None]
    for t in range(STEPS):
        a, b = paths[..., t, 0], paths[..., t, 1]
        for values, truth in ((a, smoothed.mean[t, 0]), (b, smoothed.mean[t, 1]), (a * a, second[t, 0, 0]),
                              (a * b, second[t, 0, 1]), (b * b, second[t, 1, 1])):  # fmt: skip
            assert abs(values.mean() - float(truth)) < 5.5 * mcmc.standard_error(values)


def skewed(theta):
    """Process and measurement noise go together."""
    return mo.StateSpaceModel(mo.Gaussian(jnp.zeros(1), jnp.eye(1)), mo.LinearGaussian(0.9 * jnp.eye(1), jnp.eye(1)),
                              mo.LinearGaussian(jnp.eye(1), jnp.eye(1)), noise_cross_cov=0.9 * jnp.eye(1))  # fmt: skip


@pytest.mark.night
@pytest.mark.parametrize("kernel", [parameters.ParticleGibbs(10), parameters.RaoBlackwellizedParticleGibbs(1)],
                         ids=["plain", "marginalized"])  # fmt: skip
def test_noises_that_go_together_reach_the_path(kernel):
    fixed = parameters.PathPosterior(mo.Gaussian(jnp.zeros(1), jnp.eye(1)), skewed, YS)
    chains = mo.sample(1, kernel, fixed, fixed.start, draws=2_000, chains=8, burn_in=100)
    smoothed = mo.smooth(0, mo.smoothers.RauchTungStriebelSmoother(), skewed(None), mo.run(0, mo.KalmanFilter(), skewed(None), YS), YS)
    paths = np.asarray(chains.positions["path"])[..., 0].astype(float)
    for t in range(STEPS):
        assert abs(paths[..., t].mean() - float(smoothed.mean[t, 0])) < 5.3 * mcmc.standard_error(paths[..., t])
    for refused in (lambda: parameters.liu_west(0, fixed, 10), lambda: parameters.iterated_filtering(0, fixed, 10, 0.1)):
        with pytest.raises(MotesError, match="parameters model: expected measurement noise that is independent"):
            refused()


@pytest.mark.night
def test_a_row_without_measurement_tells_a_custom_sensor_nothing():
    known = model(jnp.zeros(2))
    custom = mo.Custom(log_prob=lambda y, x, u, t: -((y[0] - x[0]) ** 2) - 0.5 * jnp.log(jnp.pi), sample=lambda key, x, u, t: x)
    blind = parameters.PathPosterior(PRIOR, lambda theta: mo.StateSpaceModel(known.initial, known.dynamics, custom), YS)
    position = PATHS.start(random.as_key(3))
    seen = parameters.PathPosterior(PRIOR, lambda theta: mo.StateSpaceModel(known.initial, known.dynamics, known.sensor), YS)
    np.testing.assert_allclose(blind(position), seen(position), rtol=1e-4)
    chains = mo.sample(0, parameters.ParticleGibbs(8), blind, blind.start, draws=20)
    assert np.isfinite(np.asarray(chains.log_density)).all()


@pytest.mark.night
@pytest.mark.parametrize("around", [mcmc.Adaptive, lambda kernel: mcmc.Repeat(kernel, 2)], ids=["Adaptive", "Repeat"])
def test_correlated_chains_in_a_wrapper(around):
    posterior = parameters.Posterior(PRIOR, model, mo.ParticleFilter(n=20, scheme=mo.resampling.Sorted()), YS)
    chains = mo.sample(0, around(CORRELATED), posterior, posterior.starts, draws=100, burn_in=0)
    assert 0 < chains.acceptance["RandomWalkMetropolis"] < 1 and np.ptp(np.asarray(chains.log_density)[:, 0]) > 0
    with pytest.raises(MotesError, match="PseudoMarginal renewed: expected 1 in a Cycle or Mix"):
        mo.sample(0, mcmc.Cycle([around(CORRELATED)]), posterior, posterior.starts, draws=10)


def test_a_collapse_is_an_improbable_position_not_an_error():
    far = parameters.Posterior(PRIOR, model, mo.ParticleFilter(n=5), YS.at[3].set(1e6))
    assert float(far.estimate(random.as_key(0), jnp.zeros(2))) == -np.inf
    with pytest.raises(MotesError, match="log_density at init: expected a finite number"):
        mo.sample(0, mcmc.PseudoMarginal(mcmc.RandomWalkMetropolis()), far, jnp.zeros(2), draws=10)


@pytest.mark.night
def test_marginalized_paths_mix_better():
    """A position with a bent sensor and bent dynamics, driven by two linear states: the same law, and fewer draws for it."""
    def driven(x, u, t):
        return jnp.stack([0.5 * x[0] + 3 * jnp.sin(x[0] / 2) + x[1], 0.95 * x[1] + 0.1 * x[2], 0.9 * x[2]])

    bent = mo.StateSpaceModel(mo.Gaussian(jnp.zeros(3), jnp.eye(3)), mo.AdditiveGaussian(driven, 0.1 * jnp.eye(3)),
                              mo.AdditiveGaussian(lambda x, u, t: x[:1] ** 2 / 5 + x[:1], 0.1 * jnp.eye(1)))  # fmt: skip
    fixed = parameters.PathPosterior(mo.Gaussian(jnp.zeros(1), jnp.eye(1)), lambda _: bent, mo.simulate(2, bent, 40)[1])
    kernels = parameters.ParticleGibbs(15), parameters.RaoBlackwellizedParticleGibbs(15)
    plain, other = (np.asarray(mo.sample(0, kernel, fixed, fixed.start, draws=2_000, burn_in=200).positions["path"], float)
                    for kernel in kernels)  # fmt: skip
    for t in (0, 13, 26, 39):
        for state in range(3):
            one, two = plain[..., t, state], other[..., t, state]
            assert abs(one.mean() - two.mean()) < 4.9 * np.hypot(mcmc.standard_error(one), mcmc.standard_error(two))
    assert mcmc.bulk_ess(other[..., 13, 2]) > 3 * mcmc.bulk_ess(plain[..., 13, 2])


@pytest.mark.night
def test_smc_squared(exact):
    runs = [parameters.smc_squared(seed, BY_PARTICLES, 400) for seed in range(3)]
    mean, cov, evidence = exact
    centers = np.array([run.mean[-1] for run in runs])
    # a few hundred effective parameters each
    assert (np.abs(centers.mean(axis=0) - mean) < 0.15 * np.sqrt(np.diag(cov))).all()
    assert abs(np.mean([run.log_evidence[-1] for run in runs]) - evidence) < 0.3
    first = runs[0]
    assert first.mean.shape == (STEPS, 2) and first.cov.shape == (STEPS, 2, 2) and np.isfinite(first.acceptance).any()
    np.testing.assert_allclose(np.diag(first.cov[-1]), np.diag(cov), rtol=0.5)


def test_liu_west_comes_near(exact):
    found = parameters.liu_west(0, PATHS, 5_000)
    mean, cov, evidence = exact
    assert (np.abs(found.mean[-1, :2] - mean) < 0.3 * np.sqrt(np.diag(cov))).all()
    assert abs(found.log_likelihood - evidence) < 0.4


@pytest.mark.night
def test_iterated_filtering_climbs_to_the_maximum():
    posterior = parameters.Posterior(PRIOR, model, mo.KalmanFilter(), YS)

    def likelihood(theta):
        return posterior(theta) - PRIOR.log_prob(theta)

    found = parameters.iterated_filtering(0, PATHS, 500, 0.1, rounds=25)
    grid = jnp.stack(jnp.meshgrid(jnp.linspace(-0.5, 1.5, 41), jnp.linspace(-3.0, 1.0, 41), indexing="ij"), axis=-1).reshape(-1, 2)
    best = float(jnp.max(jax.vmap(likelihood)(grid)))
    assert float(likelihood(jnp.asarray(found.theta))) > best - 0.2
    assert found.means.shape == (25, 2) and found.spread[-1].max() < found.spread[0].max()


@pytest.mark.night
def test_the_likelihood_has_a_gradient():
    posterior = parameters.Posterior(PRIOR, model, mo.KalmanFilter(), YS)
    at = jnp.array([0.3, -0.4])
    slope = jax.grad(posterior)(at)
    for k in range(2):
        step = 1e-2 * jnp.eye(2)[k]
        np.testing.assert_allclose(slope[k], (posterior(at + step) - posterior(at - step)) / 2e-2, rtol=0.05, atol=0.02)
    chains = mo.sample(0, mcmc.Adaptive(mcmc.HMC(num_steps=5)), posterior, posterior.starts, draws=200, chains=2, burn_in=200)
    assert np.isfinite(np.asarray(chains.log_density)).all()


TIMES = 10 if NIGHT else 1
"""Times as many worlds are simulated at night."""


def ranks(kernel, make, start, theta_of, worlds=400 * TIMES, draws=15, apart=40):
    """Draw parameters and data, run a chain on each, and return the ranks of the true parameters among the chain's draws.

    Ranks are uniform only among independent draws: 6 steps apart, 4 000 worlds see that they are not.
    """

    def world(key):
        theta = PRIOR.sample(random.child(key, 2), 1)[:, 0]
        ys = mo.simulate(random.child(key, 3), model(theta), STEPS)[1]
        target = make(ys)
        state = kernel.init(random.child(key, 4), target, start(target, random.child(key, 5), theta))

        def again(state, t):
            return kernel.step(random.step_key(random.child(key, 6), t), target, state, t)[0], theta_of(state.position)

        path = jax.lax.scan(again, state, jnp.arange(apart * (draws + 2)))[1][2 * apart :: apart]
        return jnp.sum(path < theta, axis=0)

    keys = jax.vmap(lambda k: random.step_key(random.as_key(8), k))(jnp.arange(worlds))
    return np.asarray(jax.jit(jax.vmap(world))(keys))


@pytest.mark.optimized
@pytest.mark.parametrize("name", each(["PMMH", "particle Gibbs"], {"PMMH"}))
def test_ranks_of_the_truth_are_uniform(name):
    """Simulation-based calibration (Talts et al. 2018); 16 ranks from 400 worlds, by night ten times as many."""
    from motes.core.record import replace

    if name == "PMMH":
        kernel = mcmc.PseudoMarginal(mcmc.RandomWalkMetropolis(jnp.array([0.25, 0.4])))
        found = ranks(kernel, lambda ys: replace(BY_PARTICLES, ys=ys), lambda target, key, theta: theta, lambda position: position)
    else:
        found = ranks(GIBBS, lambda ys: replace(PATHS, ys=ys), lambda target, key, theta: {**target.start(key), "theta": theta},
                      lambda position: position["theta"])  # fmt: skip
    for k in range(2):
        assert stats.chisquare(np.bincount(found[:, k], minlength=16)).pvalue > 1e-6


@pytest.mark.optimized
@pytest.mark.night
def test_ranks_of_the_truth_among_sequential_parameters_are_uniform():
    from motes.core.record import replace

    found = []
    for world in range(40 * TIMES):
        key = random.step_key(random.as_key(12), world)
        theta = PRIOR.sample(random.child(key, 2), 1)[:, 0]
        ys = mo.simulate(random.child(key, 3), model(theta), STEPS)[1]
        small = replace(BY_PARTICLES, filter=mo.ParticleFilter(n=30), ys=ys)
        drawn = parameters.smc_squared(random.child(key, 4), small, 80).cloud.sample(random.child(key, 5), 7)
        found.append(np.asarray(jnp.sum(drawn < theta[:, None], axis=1)))
    for k in range(2):
        assert stats.chisquare(np.bincount(np.array(found)[:, k], minlength=8)).pvalue > 1e-6


class Unknown:
    """An estimated density that JAX cannot take apart."""

    def __call__(self, x):
        return -x[0] ** 2

    def estimate(self, key, x):
        return self(x)


REFUSED = [
    (lambda: mo.sample(0, mcmc.PseudoMarginal(mcmc.RandomWalkMetropolis()), Unknown(), jnp.zeros(1)), "whose class JAX knows as a tree"),
    (lambda: parameters.Posterior(3, model, mo.KalmanFilter(), YS), "Posterior prior: expected a law"),
    (lambda: parameters.Posterior(PRIOR, 3, mo.KalmanFilter(), YS), "Posterior model: expected a function of the parameters"),
    (lambda: parameters.Posterior(PRIOR, model, 3, YS), "Posterior filter: expected a filter with a likelihood"),
    (lambda: parameters.Posterior(PRIOR, model, mo.CostReferenceParticleFilter(n=10), YS), "got CostReferenceParticleFilter"),
    (lambda: parameters.Posterior(PRIOR, model, mo.KalmanFilter(), YS[:, 0]), "ys: expected shape"),
    (lambda: parameters.PathPosterior(PRIOR, model, YS[:, 0]), "ys: expected shape"),
    (lambda: parameters.ParticleGibbs(1), "ParticleGibbs n: expected at least 2"),
    (lambda: mcmc.PseudoMarginal(mcmc.NUTS()), "PseudoMarginal kernel: expected RandomWalkMetropolis"),
    (lambda: mo.sample(0, mcmc.PseudoMarginal(mcmc.RandomWalkMetropolis()), lambda x: -(x[0] ** 2), jnp.zeros(1)), "one with a method"),
    (lambda: mo.sample(0, parameters.ParticleGibbs(5), lambda p: 0 * p["theta"][0], {"theta": jnp.zeros(2)}), "a mo.parameters.Path"),
    (lambda: parameters.RaoBlackwellizedParticleGibbs(0), "RaoBlackwellizedParticleGibbs n: expected a whole number of at least 1"),
    (lambda: mo.sample(0, parameters.RaoBlackwellizedParticleGibbs(5), lambda p: 0 * p["theta"][0], {"theta": jnp.zeros(2)}),
     "RaoBlackwellizedParticleGibbs log_density: expected a mo.parameters.Path"),
    (lambda: parameters.smc_squared(0, PATHS, 10), "smc_squared posterior: expected a mo.parameters.Posterior"),
    (lambda: parameters.liu_west(0, PATHS, 10, discount=1.5), "liu_west discount: expected a number between"),
    (lambda: parameters.liu_west(0, 3, 10), "liu_west given: expected"),
    (lambda: parameters.iterated_filtering(0, PATHS, 10, -1.0), "iterated_filtering deviations: expected positive"),
]


@pytest.mark.parametrize("make, message", REFUSED, ids=[message[:40] for _, message in REFUSED])
def test_refusals(make, message):
    with pytest.raises(MotesError, match=message):
        make()


def test_collapses_are_told():
    far = YS.at[3].set(1e6)
    with pytest.raises(CollapseError, match="smc_squared prior: expected parameters that explain .* at step 3"):
        parameters.smc_squared(0, parameters.Posterior(PRIOR, model, mo.ParticleFilter(n=20, on_collapse="predict"), far), 10)
    with pytest.raises(CollapseError, match="iterated_filtering given"):
        parameters.iterated_filtering(0, parameters.PathPosterior(PRIOR, model, far), 50, 0.1)
