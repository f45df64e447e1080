"""Sets of plots against enumeration of all associations: likelihoods, data association, unbiasedness, calibration."""

from itertools import product

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.special import logsumexp
from scipy.stats import binom, chi2, multivariate_normal, norm

import motes as mo
from tiers import NIGHT, each

pytestmark = pytest.mark.jax

LEVEL = 1e-6
"""Chance with which each statistical test fails although all is right."""
NAMES = ("east", "north", "v_east", "v_north")
RADAR_COV = np.diag([9.0, 4e-4])


def radar(x, u, t):
    return jnp.stack([jnp.hypot(x[0], x[1]), jnp.arctan2(x[1], x[0])])


def heard(x, u, t):
    """A target that crosses the line of sight is not heard."""
    return 0.05 + 0.9 / (1 + jnp.exp(-jnp.abs((x[0] * x[2] + x[1] * x[3]) / jnp.hypot(x[0], x[1]))))


def sensor_of(detection, clutter, plots):
    """A radar in the precision of the test."""
    return mo.Cluttered(mo.AdditiveGaussian(radar, RADAR_COV, angles=(1,)), detection, clutter=clutter, plots=plots)


def uneven():
    """Four false plots a scan, around two places."""
    covs = np.stack([np.diag([900.0, 1.0])] * 2, axis=-1)
    return 4.0, mo.Mixture.of(np.array([0.3, 0.7]), np.array([[100.0, 60.0], [3.0, -1.0]]), covs)


def states(n, seed=0):
    """Particles on both sides of the cut of the azimuth."""
    rng = np.random.default_rng(seed)
    return np.array([-100.0, 0.0, 3.0, 1.0])[:, None] + np.array([4.0, 3.0, 2.0, 2.0])[:, None] * rng.normal(size=(4, n))


def scan(count, seed, near=3):
    """Plots of which some are near the particles."""
    rng = np.random.default_rng(seed)
    far = np.stack([rng.uniform(20, 200, count), rng.uniform(-np.pi, np.pi, count)], axis=1)
    near = min(near, count)
    far[:near] = np.array([100.0, np.pi - 0.01]) + rng.normal(size=(near, 2)) * [4.0, 0.03]
    far[:, 1] = (far[:, 1] + np.pi) % (2 * np.pi) - np.pi
    return rng.permutation(far)


def enumerated(X, plots, detection, rate, intensity):
    """Log density of a scan for each particle: a sum over all associations of the target with the plots, or with none."""
    found = []
    for x in X.T:
        p = float(detection(x, None, 0)) if callable(detection) else detection
        own = []
        for z in plots:
            off = np.array([z[0] - np.hypot(x[0], x[1]), (z[1] - np.arctan2(x[1], x[0]) + np.pi) % (2 * np.pi) - np.pi])
            own.append(np.log(p) + multivariate_normal(np.zeros(2), RADAR_COV).logpdf(off))
        each = [np.log1p(-p) + sum(intensity(z) for z in plots)]
        for j in range(len(plots)):
            each.append(own[j] + sum(intensity(z) for i, z in enumerate(plots) if i != j))
        found.append(logsumexp(each) - rate)
    return np.array(found)


CASES = {"doppler": (heard, uneven), "density": (0.7, lambda: 0.02), "certain": (1.0, uneven)}


@pytest.mark.parametrize("count", each([0, 1, 4, 8, 45], {"8", "45"}))
@pytest.mark.parametrize(("detection", "clutter"), CASES.values(), ids=CASES)
def test_the_likelihood_of_a_set_is_the_sum_over_all_associations(double, count, detection, clutter):
    clutter = clutter()
    sensor, X = sensor_of(detection, clutter, 50), states(25)
    plots = scan(count, 3) if count else np.zeros((0, 2))
    if isinstance(clutter, tuple):
        rate, law = clutter
        mixture = [multivariate_normal([100.0, 3.0], np.diag([900.0, 1.0])), multivariate_normal([60.0, -1.0], np.diag([900.0, 1.0]))]
        intensity = lambda z: np.log(rate * (0.3 * mixture[0].pdf(z) + 0.7 * mixture[1].pdf(z)))  # noqa: E731
    else:
        rate, intensity = 0.0, lambda z: np.log(clutter)
    y = jax.tree.map(lambda leaf: leaf[0], sensor.packed(mo.plots([plots])))
    with np.errstate(divide="ignore"):
        wanted = enumerated(X, plots, detection, rate, intensity)
    np.testing.assert_allclose(jax.jit(sensor.log_prob)(y, jnp.asarray(X), None, 0), wanted, rtol=1e-10, atol=1e-10)


def test_plots_that_no_particle_can_tell_from_clutter_are_left_out(double):
    sensor, X, plots = sensor_of(heard, 0.02, 45), jnp.asarray(states(25)), scan(45, 3)
    shared = sensor.shared(jnp.asarray(plots))
    floor = jnp.min(jnp.log1p(-sensor.detected(X, None, 0)))
    means, cov = sensor.sensor.means(X, None, 0), jnp.asarray(RADAR_COV)
    wanted = np.asarray(sensor.wanted(jnp.asarray(plots), shared.gains, floor, means, cov))
    near = (np.abs(plots[:, 0] - 100) < 15) & (np.abs(np.abs(plots[:, 1]) - np.pi) < 0.1)
    assert 3 <= wanted.sum() < 12
    assert wanted[near].all()


def test_plots_where_no_false_ones_can_be_are_the_targets(double):
    """One outside the region can only be the target's; of two at least one is impossible."""
    sensor = sensor_of(0.8, (2.0, mo.Uniform([0.0, -4.0], [99.0, 4.0])), 13)
    X, inside, outside = jnp.asarray(states(9)), [50.0, 0.0], [[100.0, 3.12], [104.0, -3.1]]

    def of(*plots):
        y = jax.tree.map(lambda leaf: leaf[0], sensor.packed(mo.plots([np.array(plots)])))
        return np.asarray(jax.jit(sensor.log_prob)(y, X, None, 0))

    own = np.asarray(sensor.sensor.log_prob(jnp.array(outside[0]), X, None, 0))
    np.testing.assert_allclose(of(inside, outside[0]), np.log(0.8) + own + np.log(2.0 / (99 * 8)) - 2.0, rtol=1e-12)
    assert np.isneginf(of(inside, *outside)).all()


def test_plots_without_a_component_count_with_what_they_have(double):
    """Where the law of false plots can leave a component out; two plots at one place are two."""
    sensor = sensor_of(0.8, (2.0, mo.Uniform([0.0, -4.0], [200.0, 4.0])), 13)
    X, plots = jnp.asarray(states(9)), np.array([[np.nan, 3.12], [98.0, 3.1], [98.0, 3.1]])
    y = jax.tree.map(lambda leaf: leaf[0], sensor.packed(mo.plots([plots])))
    seen = [np.asarray(each) for each in jax.jit(jax.vmap(lambda z: sensor.sensor.log_prob(z, X, None, 0)))(jnp.array(plots))]
    clutter = np.log(2.0) - np.log([8.0, 1600.0, 1600.0])
    wanted = logsumexp([np.full(9, np.log(0.2)), *(np.log(0.8) + s - c for s, c in zip(seen, clutter, strict=True))], axis=0)
    np.testing.assert_allclose(jax.jit(sensor.log_prob)(y, X, None, 0), wanted + clutter.sum() - 2.0, rtol=1e-12)


def test_single_precision_and_derivatives_are_sound():
    """Also of scans without a plot, whose sum over plots is zero."""
    X = jnp.asarray(states(9))
    for plots in (np.zeros((0, 2)), scan(30, 5)):
        def total(p, plots=plots):
            sensor = sensor_of(lambda x, u, t: p * heard(x, u, t), 0.02, 30)
            y = jax.tree.map(lambda leaf: leaf[0], sensor.packed(mo.plots([plots])))
            return jnp.sum(sensor.log_prob(jax.tree.map(jnp.asarray, y), X, None, 0))

        found, slope = jax.jit(lambda: ((total(0.81) - total(0.79)) / 0.02, jax.grad(total)(0.8)))()
        np.testing.assert_allclose(found, slope, rtol=2e-2)


# a linear case: two states, one measured; all hypotheses are Gaussian
A, Q, H, R = np.array([[1.0, 1.0], [0.0, 1.0]]), np.diag([0.1, 0.2]), np.array([[1.0, 0.0]]), np.array([[0.4]])
START = np.diag([2.0, 0.5])
DETECTION, RATE, WIDTH = 0.7, 1.2, 16.0


def linear(detection=DETECTION, rate=RATE, plots=12):
    sensor = mo.AdditiveGaussian(lambda x, u, t: x[:1], R)
    scans = mo.Cluttered(sensor, detection, clutter=(rate, mo.Uniform([-WIDTH / 2], [WIDTH / 2])), plots=plots)
    return mo.StateSpaceModel(mo.Gaussian(np.zeros(2), START), mo.LinearGaussian(A, Q), scans)


SCANS = [np.array([[0.4], [3.0]]), np.zeros((0, 1)), np.array([[1.1], [-2.0]]), np.array([[1.0], [1.9], [5.0]]), np.array([[2.2]])]


def hypotheses(scans):
    """Log likelihood, and mean and covariance at the end, by a Kalman filter for every history of associations."""
    totals, means, covs = [], [], []
    for history in product(*(range(-1, len(scan)) for scan in scans)):
        m, P, total = np.zeros(2), START, 0.0
        for t, (own, scan) in enumerate(zip(history, scans, strict=True)):
            if t:
                m, P = A @ m, A @ P @ A.T + Q
            total += -RATE + (len(scan) - (own >= 0)) * np.log(RATE / WIDTH)
            if own < 0:
                total += np.log(1 - DETECTION)
                continue
            S = (H @ P @ H.T + R)[0, 0]
            off = scan[own, 0] - m[0]
            total += np.log(DETECTION) + norm.logpdf(off, scale=np.sqrt(S))
            K = P @ H.T / S
            m, P = m + K[:, 0] * off, P - K @ H @ P
        totals.append(total)
        means.append(m)
        covs.append(P)
    log_likelihood = logsumexp(totals)
    weights, means = np.exp(np.array(totals) - log_likelihood), np.array(means)
    mean = weights @ means
    off = means - mean
    return log_likelihood, mean, np.einsum("h,hij->ij", weights, np.array(covs)) + (weights * off.T) @ off


@pytest.mark.parametrize("filter", [mo.KalmanFilter(), mo.ExtendedKalmanFilter(), mo.CubatureKalmanFilter(), mo.InteractingMultipleModel(),
                                    mo.JumpMarkovFilter(n=2)], ids=lambda filter: type(filter).__name__)  # fmt: skip
def test_data_association_keeps_mean_and_covariance_of_all_hypotheses(double, filter):
    """Of a single scan, which is where its Gaussian is that of the sum; the prior is the model's own."""
    for scan in SCANS[0], SCANS[1], SCANS[3]:
        wanted = hypotheses([scan])
        history = mo.run(0, filter, linear(), mo.plots([scan]))
        np.testing.assert_allclose(history.log_likelihood, wanted[0], rtol=1e-10)
        np.testing.assert_allclose(history.mean[-1], wanted[1], rtol=1e-9, atol=1e-10)
        np.testing.assert_allclose(history.cov[-1], wanted[2], rtol=1e-9, atol=1e-10)


@pytest.mark.parametrize("filter", [mo.ParticleFilter(n=200), mo.MarginalizedParticleFilter(n=60)], ids=lambda one: type(one).__name__)
def test_likelihoods_are_unbiased(double, filter):
    exact = hypotheses(SCANS)[0]
    model, ys = linear(), mo.plots(SCANS)
    found = jax.vmap(lambda key: mo.run(key, filter, model, ys).log_likelihood)(jax.random.split(jax.random.key(5), 1500))
    ratios = np.exp(np.asarray(found) - exact)
    z = (ratios.mean() - 1) / (ratios.std() / np.sqrt(ratios.size))
    assert ratios.std() / np.sqrt(ratios.size) < 0.025  # what it could see
    assert abs(z) < norm.isf(LEVEL / 2)


def test_the_posterior_is_that_of_all_hypotheses(double):
    _, mean, cov = hypotheses(SCANS)
    history = mo.run(3, mo.MarginalizedParticleFilter(n=40_000), linear(), mo.plots(SCANS))
    np.testing.assert_allclose(history.mean[-1], mean, atol=0.05)
    np.testing.assert_allclose(history.cov[-1], cov, atol=0.1)


def test_drawn_scans_have_the_density_that_they_are_weighed_by(double):
    """Drawn at one state, the likelihood ratio of any other state has the mean one; a wrong number of plots of either kind shows."""
    sensor, draws = linear().sensor, 100_000
    at, other = jnp.array([0.5, 0.0]), jnp.array([0.9, 0.0])
    scans = jax.jit(sensor.sample)(jax.random.key(8), jnp.tile(at[:, None], (1, draws)), None, 0)
    seen = ~jnp.isnan(scans.value[:, 0])
    counts = np.asarray(seen.sum(axis=0))
    assert abs(counts.mean() - RATE - DETECTION) / np.sqrt((RATE + DETECTION * (1 - DETECTION)) / draws) < norm.isf(LEVEL / 2)
    both = jnp.stack([at, other], axis=1)
    logs = jax.jit(jax.vmap(lambda rows: sensor.log_prob(rows, both, None, 0), in_axes=-1))(scans.value)
    ratios = np.exp(np.asarray(logs[:, 1] - logs[:, 0]))
    assert abs(ratios.mean() - 1) / (ratios.std() / np.sqrt(draws)) < norm.isf(LEVEL / 2)
    # the plot of the target comes at any place
    first = np.asarray(jnp.abs(scans.value[0, 0] - 0.5) < 0.2)[counts == 3]
    last = np.asarray(jnp.abs(scans.value[2, 0] - 0.5) < 0.2)[counts == 3]
    assert abs(first.mean() - last.mean()) / np.sqrt(2 * 0.25 / first.size) < norm.isf(LEVEL / 2)


def ranks(model, runs, filter, steps=12):
    """Return what tells of an assumed model the rank of the true position among 63 draws of what a filter thinks, of many worlds."""

    def one(key, assumed):
        keys = jax.random.split(key, 3)
        xs, ys = mo.simulate(keys[0], model, steps)
        history = mo.run(keys[1], filter, assumed, ys, keep=mo.keep.nothing)
        return jnp.sum(history.state.sample(keys[2], 63)[0] < xs[-1, 0])

    many = jax.jit(lambda keys, assumed: jax.lax.map(lambda key: one(key, assumed), keys, batch_size=400))
    return lambda assumed: np.asarray(many(jax.random.split(jax.random.key(21), runs), assumed))


def unevenness(found):
    counts = np.bincount(found // 8, minlength=8)
    return float(np.sum((counts - found.size / 8) ** 2) / (found.size / 8))


def test_filtered_states_are_calibrated():
    """Ranks of the truth are even; and are not where the filter believes that every target is seen."""
    # in many runs it shows that particles are few
    filter, runs = (mo.ParticleFilter(n=3_000), 8000) if NIGHT else (mo.ParticleFilter(n=300), 400)
    found, bound = ranks(linear(), runs, filter), chi2.isf(LEVEL, 7)
    assert unevenness(found(linear())) < bound
    assert unevenness(found(linear(detection=0.98))) > bound


def test_detection_that_depends_on_the_state_is_told_by_silence():
    """Nothing but empty scans: the share of fast targets falls by what Bayes' rule says."""

    def seen(x, u, t):
        return jnp.where(jnp.abs(x[1]) > 0.7, 0.9, 0.1)

    still = mo.LinearGaussian(np.eye(2), np.zeros((2, 2)))
    sensor = mo.Cluttered(mo.AdditiveGaussian(lambda x, u, t: x[:1], R), seen, clutter=0.1, plots=3)
    model = mo.StateSpaceModel(mo.Gaussian(np.zeros(2), START), still, sensor)
    n, scans = 40_000, mo.plots([np.zeros((0, 1)), None, []])
    history = mo.run(1, mo.ParticleFilter(n=n, policy=mo.resampling.Never()), model, scans, keep=mo.keep.nothing)
    fast = 2 * norm.sf(0.7, scale=np.sqrt(0.5))
    wanted = fast * 0.1**2 / (fast * 0.1**2 + (1 - fast) * 0.9**2)
    law = history.state
    found = float(jnp.sum(jnp.where(jnp.abs(law.particles[1]) > 0.7, jnp.exp(law.log_weights), 0)))
    before = 1 - fast
    assert abs(found - wanted) < 6 * wanted * np.sqrt(binom.var(n, before) / n**2) / (fast * before)
    np.testing.assert_allclose(np.exp(history.info.log_evidence[1]), 1.0)


# one target in clutter, q = 1 m^2/s^3, 20 m, 0.01 rad; genie: a Kalman filter that knows which plot is the target's
DISTANCE, WINDOW = 2_200.0, 957.0


def single_target(detection, density):
    def f(x, u, t):
        return jnp.concatenate([x[:2] + x[2:], x[2:]])

    sensor = mo.AdditiveGaussian(radar, np.diag([400.0, 1e-4]), angles=(1,))
    region = mo.Uniform([DISTANCE - WINDOW, -0.5], [DISTANCE + WINDOW, 0.5])
    scans = mo.Cluttered(sensor, detection, clutter=(2 * WINDOW * density, region), plots=200)
    start = mo.Gaussian(np.array([DISTANCE, 0.0, 0.0, 10.0]), np.diag([400.0, 400.0, 25.0, 25.0]))
    dynamics = mo.AdditiveGaussian(f, np.kron([[1 / 3, 1 / 2], [1 / 2, 1.0]], np.eye(2)))
    return mo.StateSpaceModel(start, dynamics, sensor, NAMES), mo.StateSpaceModel(start, dynamics, scans, NAMES)


@pytest.mark.night
@pytest.mark.parametrize(("detection", "density", "runs", "lost", "share"), [(0.7, 0.07, 50, 1, 1.42), (0.9, 0.02, 100, 0, 1.1)])
def test_a_target_is_kept_among_false_plots(detection, density, runs, lost, share):
    """All plots of a scan, 134 on average in the first case; errors beside those of the genie on the same runs, 19 m there."""
    plain, scanned = single_target(detection, density)

    def error(history, xs):
        return jnp.hypot(*(history.mean - xs)[:, :2].T)

    def one(key):
        keys = jax.random.split(key, 4)
        xs, own = mo.simulate(keys[0], plain, 100)
        seen = jax.random.uniform(keys[1], (100,)) < detection
        # the steps of a run as so many particles
        scans = scanned.sensor.among_false(keys[2], own.T[None], seen[None])
        scans = mo.replace(scans, value=jnp.moveaxis(scans.value, -1, 0))
        tracked = mo.run(keys[3], mo.ParticleFilter(n=1_000), scanned, scans, keep=mo.keep.means)
        known = jnp.where(seen[:, None], own, jnp.nan)
        return error(tracked, xs), error(mo.run(keys[3], mo.ExtendedKalmanFilter(), plain, known, keep=mo.keep.means), xs)

    found, genie = (np.asarray(each) for each in jax.jit(lambda keys: jax.lax.map(one, keys))(jax.random.split(jax.random.key(7), runs)))
    assert (found[:, -10:].mean(axis=1) > 150).sum() <= lost
    median, best = (np.median(np.sqrt((each**2).mean(axis=1))) for each in (found, genie))
    assert median <= share * best, (median, best)
