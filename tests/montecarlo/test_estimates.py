"""Estimates reach what is known, their errors are honest, and what cannot be trusted says so."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

import motes as mo
from motes.core.checks import MotesError, MotesWarning
from motes.montecarlo.adaptive import StudentMixture
from tiers import each

montecarlo = mo.montecarlo
FAR = 4.9
"""Standard errors: 1e-6 two-sided."""
LAW = mo.Gaussian(jnp.array([1.0, -0.5]), jnp.array([[1.0, 0.4], [0.4, 0.5]]))
WIDE = mo.StudentT(jnp.array([2.0, 1.5]), 4.0)


def polynomial(x):
    return jnp.stack([x[0], x[0] * x[1], x[1] ** 2])


EXACT = np.array([1.0, 0.4 - 0.5, 0.5 + 0.25])


def unnormalized(x):
    return LAW.log_prob(x) + 3.0


def gain(x):
    """How far draws of the adapted proposal are from the truth, per standard error."""
    return np.abs((np.asarray(x.value) - EXACT) / np.asarray(x.error))


def by(name, key, n=6_000):
    if name == "plain":
        return montecarlo.expectation(key, polynomial, LAW, n)
    if name == "normalized":
        return montecarlo.importance_sampling(key, polynomial, LAW, WIDE, n, normalized=True)
    if name == "self-normalized":
        return montecarlo.importance_sampling(key, polynomial, unnormalized, WIDE, n)
    if name == "several laws":
        laws = [mo.Gaussian(jnp.array([0.0, 0.0]), 2 * jnp.eye(2)), mo.StudentT(jnp.array([3.0, 1.0]), 5.0)]
        return montecarlo.multiple_importance_sampling(key, polynomial, unnormalized, laws, [n // 4, 3 * n // 4])
    first = mo.Mixture.of(jnp.array([0.5, 0.5]), jnp.array([[-2.0, 3.0], [2.0, -2.0]]), jnp.repeat(4 * jnp.eye(2)[..., None], 2, axis=2))
    return montecarlo.adaptive_importance_sampling(key, polynomial, unnormalized, first, n // 5, rounds=5).estimate


@pytest.mark.parametrize("name", each(
    ["plain", "normalized", "self-normalized", "several laws", "adaptive"], {"adaptive", "several laws", "normalized"}))
def test_reaches_the_mean_with_honest_errors(name):
    runs = [by(name, seed) for seed in range(24)]
    values, errors = (np.array([np.asarray(getattr(run, part)) for run in runs]) for part in ("value", "error"))
    mean = (values.mean(axis=0) - EXACT) / (values.std(axis=0, ddof=1) / len(runs) ** 0.5)
    assert (np.abs(mean) < stats.t(23).isf(0.5e-6)).all()
    # the mean square of the errors in units of their own claims is chi-square with as many degrees as runs
    squares = (((values - EXACT) / errors) ** 2).sum(axis=0)
    assert (squares < 1.3 * stats.chi2(24).isf(1e-6)).all() and (squares > 0.7 * stats.chi2(24).ppf(1e-6)).all()
    assert all(run.trusted for run in runs)
    if name not in ("plain", "normalized"):
        evidence = np.array([(float(run.log_evidence) - 3.0) / float(run.log_evidence_error) for run in runs])
        assert np.abs(evidence).max() < 6


def test_a_box():
    found = montecarlo.integral(3, lambda x: jnp.exp(-x[0]) * x[1] ** 2, [0.0, -1.0], [2.0, 3.0], 40_000)
    exact = (1 - np.exp(-2)) * (27 + 1) / 3
    assert abs(float(found.value) - exact) < FAR * float(found.error) and float(found.error) < 0.01 * exact * 3
    assert found.value.shape == ()


@pytest.mark.night
def test_adaptation_finds_both_modes():
    modes = mo.Mixture.of(jnp.array([0.8, 0.2]), jnp.array([[-6.0, 8.0]]), jnp.array([[[0.3, 0.05]]]))
    first = mo.Mixture.of(jnp.array([0.5, 0.5]), jnp.array([[-5.0, 5.0]]), jnp.array([[[30.0, 30.0]]]))
    found = montecarlo.adaptive_importance_sampling(0, lambda x: x[0], modes.log_prob, first, 2_000, rounds=8)
    assert abs(float(found.estimate.value) - (-6 * 0.8 + 8 * 0.2)) < FAR * float(found.estimate.error)
    start = montecarlo.importance_sampling(0, lambda x: x[0], modes.log_prob, first, 16_000)
    assert float(found.estimate.error) < 0.5 * float(start.error)
    assert sorted(np.round(np.asarray(found.proposal.mixture.parts.center)[0])) == [-6.0, 8.0]


@pytest.mark.night
def test_density_of_the_adapted_law():
    law = StudentMixture(mo.Mixture.of(jnp.array([0.3, 0.7]), jnp.array([[0.0, 2.0], [1.0, -1.0]]), jnp.stack(
        [jnp.array([[1.0, 0.5], [0.5, 2.0]]), jnp.array([[0.4, 0.0], [0.0, 0.2]])], axis=-1)))  # fmt: skip
    points = np.array([[0.0, 1.0, -3.0], [0.5, -1.0, 4.0]])
    parts = [(0.3, [0, 1], [[1, 0.5], [0.5, 2]]), (0.7, [2, -1], [[0.4, 0], [0, 0.2]])]
    exact = np.log(sum(share * stats.multivariate_t(center, scale, df=5).pdf(points.T) for share, center, scale in parts))
    np.testing.assert_allclose(law.log_prob(jnp.asarray(points)), exact, rtol=2e-5)
    drawn = np.asarray(law.sample(jax.random.key(0), 100_000))
    np.testing.assert_allclose(np.cov(drawn), np.asarray(law.cov()), rtol=0.1, atol=0.05)


def test_heavy_weights_are_told():
    narrow = mo.Gaussian(jnp.zeros(2), 0.15 * jnp.eye(2))
    with pytest.warns(MotesWarning, match="importance_sampling: heavy weights"):
        found = montecarlo.importance_sampling(0, polynomial, unnormalized, narrow, 5_000)
    assert not found.trusted and float(found.pareto_k) > 0.7 and "heavy weights" in str(found)


@pytest.mark.night
def test_few_points_are_told():
    far = mo.Gaussian(jnp.array([30.0, 0.0]), jnp.eye(2))
    with pytest.warns(MotesWarning, match="few points: only"):
        montecarlo.importance_sampling(0, polynomial, far, LAW, 1_000)


def test_rejection_is_exact_and_its_evidence_right():
    found = montecarlo.rejection_sampling(0, unnormalized, WIDE, 5.5, 20_000)
    for row, (center, variance) in zip(np.asarray(found.points), ((1.0, 1.0), (-0.5, 0.5)), strict=True):
        assert stats.kstest(row, stats.norm(center, variance**0.5).cdf).pvalue > 1e-6
    assert abs(found.log_evidence - 3.0) < 0.1


@pytest.mark.night
def test_a_violated_envelope_is_told():
    with pytest.raises(MotesError, match=r"rejection_sampling log_bound: expected an envelope above the density: at least \d"):
        montecarlo.rejection_sampling(0, unnormalized, WIDE, 4.0, 5_000)
    with pytest.raises(MotesError, match="log_density: expected numbers, got NaN at"):
        montecarlo.rejection_sampling(0, lambda x: jnp.log(x[0]), WIDE, 4.0, 100)
    with pytest.raises(MotesError, match="proposal: expected one of which 100 points are accepted .* got 0 of"):
        montecarlo.rejection_sampling(0, lambda x: -1e9 + 0 * x[0], WIDE, 4.0, 100)


KERNEL = mo.mcmc.RandomWalkMetropolis()


def test_tempering_gives_evidence_and_posterior():
    # y = x + e, e ~ N(0, 0.01): the evidence is N(y; 0, 1.01), far out in the prior
    y = 3.0

    def log_likelihood(x):
        return -0.5 * ((y - x[0]) / 0.1) ** 2 - jnp.log(0.1 * jnp.sqrt(2 * jnp.pi)) - 0.5 * (x[1] - x[0]) ** 2

    prior = mo.Gaussian(jnp.zeros(2), jnp.eye(2))
    # the second factor has the evidence of N(0; x1 - x0) up to its constant
    H = np.array([[1.0, 0.0], [-1.0, 1.0]])
    S = H @ H.T + np.diag([0.01, 1.0])
    exact = stats.multivariate_normal(np.zeros(2), S).logpdf([y, 0.0]) + 0.5 * np.log(2 * np.pi)
    runs = [montecarlo.temper(seed, prior, log_likelihood, 2_000, montecarlo.Tempering(KERNEL)) for seed in range(6)]
    found = np.array([run.log_evidence for run in runs])
    assert abs(found.mean() - exact) < stats.t(5).isf(0.5e-6) * found.std(ddof=1) / 6**0.5 and found.std() < 0.3
    mean = H.T @ np.linalg.solve(np.eye(2) * 0 + np.diag([0.01, 1.0]), np.array([y, 0.0]))
    precision = np.eye(2) + H.T @ np.diag([100.0, 1.0]) @ H
    posterior = np.linalg.solve(precision, mean)
    centers = np.array([np.asarray(run.cloud.mean()) for run in runs])
    np.testing.assert_allclose(centers.mean(axis=0), posterior, atol=0.03)
    first = runs[0]
    taught, plain = (montecarlo.temper(0, prior, log_likelihood, 500, montecarlo.Tempering(kernel, moves=3)).acceptance
                     for kernel in (mo.mcmc.Repeat(mo.mcmc.Adaptive(KERNEL), 1), KERNEL))  # fmt: skip
    assert abs(taught.mean() - plain.mean()) < 0.05
    assert first.exponents[0] == 0 and first.exponents[-1] == 1 and (np.diff(first.exponents) > 0).all()
    assert (first.ess[:-1] > 0.49 * 2_000).all() and (first.ess[:-1] < 0.53 * 2_000).all() and (first.acceptance > 0.1).all()


def test_annealing_finds_the_higher_of_two_maxima():
    hills = mo.Mixture.of(jnp.array([0.6, 0.4]), jnp.array([[-4.0, 5.0]]), jnp.array([[[4.0, 0.5]]]))
    kernel = mo.mcmc.Mix([mo.mcmc.RandomWalkMetropolis(3.0), mo.mcmc.RandomWalkMetropolis(0.05)])
    found = montecarlo.anneal(0, kernel, hills.log_prob, jnp.array([-4.0]), steps=3_000)
    np.testing.assert_allclose(found.position, [5.0], atol=0.05)
    assert found.best.shape == (8,) and found.log_density == pytest.approx(float(hills.log_prob(jnp.array([5.0]))), abs=1e-3)


REFUSED = [
    (lambda: montecarlo.expectation(0, 3, LAW, 10), "function: expected a function of one point"),
    (lambda: montecarlo.expectation(0, polynomial, 3, 10), "expectation law: expected a law"),
    (lambda: montecarlo.expectation(0, polynomial, LAW, 1), "expectation n: expected at least 2 points"),
    (lambda: montecarlo.expectation(0, lambda x: jnp.eye(2), LAW, 10), "function: expected one that gives a number or a vector"),
    (lambda: montecarlo.integral(0, polynomial, [0.0], [jnp.inf], 10), "integral high: expected finite numbers"),
    (lambda: montecarlo.integral(0, polynomial, [0.0], [-1.0], 10), "integral high: expected numbers above low"),
    (lambda: montecarlo.importance_sampling(0, polynomial, 3, WIDE, 10), "log_density: expected a law or a function"),
    (lambda: montecarlo.importance_sampling(0, polynomial, lambda x: x, WIDE, 10), "log_density: expected shape"),
    (lambda: montecarlo.multiple_importance_sampling(0, polynomial, LAW, [WIDE], [1, 2]), "one number for each of the 1 prop"),
    (lambda: montecarlo.adaptive_importance_sampling(0, polynomial, LAW, WIDE, 10), "first: expected a Gaussian or a Mixture"),
    (lambda: montecarlo.adaptive_importance_sampling(0, polynomial, lambda x: -jnp.inf + 0 * x[0], LAW, 10), "reaches where"),
    (lambda: montecarlo.temper(0, LAW, lambda x: -jnp.inf + 0 * x[0], 10, montecarlo.Tempering(KERNEL)), "temper prior: expected one"),
    (lambda: montecarlo.temper(0, LAW, lambda x: 0 * x[0], 10, 3), "temper how: expected"),
    (lambda: montecarlo.temper(0, LAW, lambda x: 0 * x[0], 10, montecarlo.Tempering(KERNEL, ess=2.0)), "Tempering ess: expected a number"),
    (lambda: montecarlo.anneal(0, 3, LAW.log_prob, jnp.zeros(2)), "anneal kernel: expected a kernel"),
    (lambda: montecarlo.anneal(0, KERNEL, lambda x: jnp.log(-1.0), jnp.zeros(2)), "log_density at init: expected a finite number"),
]


@pytest.mark.parametrize("make, message", REFUSED, ids=[message[:40] for _, message in REFUSED])
def test_refusals(make, message):
    with pytest.raises(MotesError, match=message):
        make()


def test_what_no_point_hits_is_not_trusted():
    with pytest.warns(mo.MotesWarning, match="few points: only 0.0 of 1000"):
        nowhere = lambda x: jnp.where(x[0] > 1e6, 0.0, -jnp.inf)  # noqa: E731
        found = montecarlo.importance_sampling(0, lambda x: x[0], nowhere, LAW, 1_000, normalized=True)
    assert not found.trusted


def test_densities_that_are_no_numbers_are_told():
    with pytest.warns(mo.MotesWarning, match="invalid: log_density over the proposal's was NaN at"):
        montecarlo.importance_sampling(0, lambda x: x[0], lambda x: jnp.where(x[0] > 0, LAW.log_prob(x), jnp.nan), LAW, 1_000)
    for n in (1_000, 10_000):
        log_weights = jnp.where(jnp.arange(n) % 50 == 0, 0.0, -jnp.inf)
        assert mo.diagnostics.pareto_k(log_weights) == -np.inf
        heavy = jnp.where(log_weights == 0, -2.0 * jnp.log(jax.random.uniform(jax.random.key(1), (n,))), -jnp.inf)
        assert np.isnan(mo.diagnostics.pareto_k(jnp.full(n, -jnp.inf))) and (n == 1_000 or 0.8 < mo.diagnostics.pareto_k(heavy) < 3)
    with pytest.raises(mo.MotesError, match="multiple_importance_sampling n: expected one number for each of the 2"):
        montecarlo.multiple_importance_sampling(0, lambda x: x[0], LAW, [LAW, LAW], 1_000)
    with pytest.raises(mo.MotesError, match="importance_sampling n: expected at least 2"):
        montecarlo.importance_sampling(0, lambda x: x[0], LAW, LAW, 1)
