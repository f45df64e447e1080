"""Scans of several targets against enumeration of all associations, what is drawn, and targets that cross."""

from itertools import permutations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.special import logsumexp
from scipy.stats import norm

import motes as mo
from motes.diagnostics.sets import followers
from motes.laws import association
from tiers import each

pytestmark = pytest.mark.jax

LEVEL = 1e-6
NAMES = ("a", "v_a", "b", "v_b", "c", "v_c")
VARIANCE = 0.3


def seen(x, u, t):
    return 0.3 + 0.6 / (1 + jnp.exp(-x[1]))


def one(detection=seen, clutter=None, plots=16):
    clutter = (1.5, mo.Uniform([-4.0], [4.0])) if clutter is None else clutter
    return mo.Cluttered(mo.AdditiveGaussian(lambda x, u, t: x[:1], [[VARIANCE]]), detection, clutter=clutter, plots=plots)


def several(count, **changes):
    sensor = mo.laws.SeveralTargets(one(**changes), tuple(NAMES[2 * i : 2 * i + 2] for i in range(count)))
    return sensor.of_states(NAMES[: 2 * count])


def enumerated(X, plots, count, detection, log_intensity, rate):
    """Sum over all ways to give plots, or none, to each target."""
    found = []
    for x in X.T:
        own = [x[2 * i : 2 * i + 2] for i in range(count)]
        p = [float(detection(each, None, 0)) if callable(detection) else detection for each in own]
        terms = []
        for chosen in set(permutations([*range(len(plots)), *[-1] * count], count)):
            term = sum(log_intensity(z) for j, z in enumerate(plots) if j not in chosen) - rate
            for i, j in enumerate(chosen):
                term += np.log(p[i]) + norm.logpdf(plots[j], own[i][0], np.sqrt(VARIANCE)) if j >= 0 else np.log1p(-p[i])
            terms.append(term)
        found.append(logsumexp(terms))
    return np.array(found)


@pytest.mark.parametrize("count", [1, 2, 3])
@pytest.mark.parametrize("plots", [[], [0.3], [0.2, 0.9, -0.4], [0.1, 0.4, 0.4, 2.0, -3.0]], ids=len)
def test_the_likelihood_is_the_sum_over_all_associations(double, count, plots):
    X = np.random.default_rng(0).normal(size=(2 * count, 6))
    sensor = several(count)
    y = jax.tree.map(lambda leaf: leaf[0], sensor.packed(mo.plots([np.reshape(plots, (-1, 1))])))
    found = jax.jit(sensor.log_prob)(y, jnp.asarray(X), None, 0)
    np.testing.assert_allclose(found, enumerated(X, plots, count, seen, lambda z: np.log(1.5 / 8), 1.5), rtol=1e-10, atol=1e-10)


def test_far_and_impossible_plots_are_counted_right(double):
    """Many plots, most of them far away; those outside of the region of false ones must be a target's."""
    X, rng = 0.3 * np.random.default_rng(1).normal(size=(4, 5)), np.random.default_rng(2)
    plots = np.concatenate([[0.1, -0.2, 0.4], rng.uniform(20, 900, 27)])
    sensor = several(2, clutter=0.02, plots=30)
    y = jax.tree.map(lambda leaf: leaf[0], sensor.packed(mo.plots([plots[:, None]])))
    found = jax.jit(sensor.log_prob)(y, jnp.asarray(X), None, 0)
    np.testing.assert_allclose(found, enumerated(X, plots, 2, seen, lambda z: np.log(0.02), 0.0), rtol=1e-10, atol=1e-9)
    sensor, inside = several(2), np.log(1.5 / 8)
    for plots in ([0.2, 4.2, 4.4], [4.2, 4.4, 4.6]):
        y = jax.tree.map(lambda leaf: leaf[0], sensor.packed(mo.plots([np.reshape(plots, (-1, 1))])))
        found = np.asarray(jax.jit(sensor.log_prob)(y, jnp.asarray(X), None, 0))
        with np.errstate(divide="ignore"):
            wanted = enumerated(X, plots, 2, seen, lambda z: inside if abs(z) < 4 else -np.inf, 1.5)
        np.testing.assert_allclose(found, wanted, rtol=1e-10)


def test_one_target_is_the_sensor_of_one_and_derivatives_are_numbers(double):
    X, y = jnp.asarray(np.random.default_rng(0).normal(size=(2, 7))), mo.plots([np.array([[0.3], [1.2], [-2.0]])])
    single, same = one(), several(1)
    y = jax.tree.map(lambda leaf: leaf[0], single.packed(y))
    found, wanted = (jax.jit(sensor.log_prob)(y, X, None, 0) for sensor in (same, single))
    np.testing.assert_allclose(found, wanted, rtol=1e-12)
    empty = jax.tree.map(lambda leaf: leaf[0], single.packed(mo.plots([np.zeros((0, 1))])))
    for scan in (y, empty):
        slope = jax.jit(jax.grad(lambda X, scan=scan: jnp.sum(same.log_prob(scan, X, None, 0))))(X)
        wanted = jax.jit(jax.grad(lambda X, scan=scan: jnp.sum(single.log_prob(scan, X, None, 0))))(X)
        np.testing.assert_allclose(slope, wanted, rtol=1e-9, atol=1e-12)


def test_drawn_scans_have_the_density_that_they_are_weighed_by(double):
    """Drawn at one state, the likelihood ratio of any other has the mean one."""
    draws, sensor = 100_000, several(2)
    at, other = jnp.array([0.5, 0.3, -0.5, -1.0]), jnp.array([0.7, 0.5, -0.4, -0.8])
    scans = jax.jit(sensor.sample)(jax.random.key(3), jnp.tile(at[:, None], (1, draws)), None, 0)
    counts = np.asarray((~jnp.isnan(scans.value[:, 0])).sum(axis=0))
    p = [float(seen(at[i : i + 2], None, 0)) for i in (0, 2)]
    spread = np.sqrt((1.5 + sum(q * (1 - q) for q in p)) / draws)
    assert abs(counts.mean() - 1.5 - sum(p)) / spread < norm.isf(LEVEL / 2)
    both = jnp.stack([at, other], axis=1)
    logs = np.asarray(jax.jit(jax.vmap(lambda rows: sensor.log_prob(rows, both, None, 0), in_axes=-1))(scans.value))
    ratios = np.exp(logs[:, 1] - logs[:, 0])
    assert abs(ratios.mean() - 1) / (ratios.std() / np.sqrt(draws)) < norm.isf(LEVEL / 2)


def exact_moments(m, P, places, plots, p, log_intensity):
    """Log evidence, mean and covariance of the mixture over all associations of targets whose places are among the states."""
    terms, means, covs = [], [], []
    for chosen in set(permutations([*range(len(plots)), *[-1] * len(places)], len(places))):
        given = [(place, plots[j]) for place, j in zip(places, chosen, strict=True) if j >= 0]
        H = np.eye(len(m))[[place for place, _ in given]]
        S, off = H @ P @ H.T + VARIANCE * np.eye(len(given)), np.array([z for _, z in given]) - H @ m
        gain = P @ H.T @ np.linalg.inv(S)
        term = (len(plots) - len(given)) * log_intensity - 1.5 + len(given) * np.log(p) + (len(places) - len(given)) * np.log1p(-p)
        terms.append(term - 0.5 * (off @ np.linalg.solve(S, off) + np.linalg.slogdet(2 * np.pi * S)[1]))
        means.append(m + gain @ off)
        covs.append(P - gain @ H @ P)
    whole, means = logsumexp(terms), np.array(means)
    shares = np.exp(np.array(terms) - whole)
    mean = shares @ means
    return whole, mean, np.einsum("k,kij->ij", shares, np.array(covs)) + np.einsum("k,ki,kj->ij", shares, means - mean, means - mean)


OF_GAUSSIANS = (mo.KalmanFilter(), mo.UnscentedKalmanFilter(), mo.InteractingMultipleModel())


@pytest.mark.parametrize("filter", each({type(one).__name__: one for one in OF_GAUSSIANS}, {"InteractingMultipleModel"}))
def test_gaussian_filters_keep_the_moments_of_all_associations(double, filter):
    """Joint data association of independent linear targets: evidence and each target's mean and covariance are exact."""
    sensor = mo.laws.SeveralTargets(one(detection=0.8, plots=40), (("a", "v_a"), ("c", "b")))
    own, m = np.array([[1.0, 0.3], [0.3, 0.5]]), np.array([0.2, 1.0, 0.5, -0.3, 0.9])
    P = np.block([[own, np.zeros((2, 3))], [np.zeros((2, 2)), 2 * own, np.zeros((2, 1))], [np.zeros((1, 4)), np.eye(1)]])
    dynamics = mo.AdditiveGaussian(lambda x, u, t: x, 0.1 * np.eye(5))
    # the second target's states stand in another order in the model than in its sensor
    model = mo.StateSpaceModel(mo.Gaussian(m, P), dynamics, sensor, ("a", "v_a", "b", "c", "rest"))
    many = [0.1, 0.4, 0.45, 2.0, -3.0, 1.0, -1.0, 3.5, 0.0, -0.2, *[3.9] * 10]
    for plots in ([], [0.3], [0.2, 0.9, -0.4], many):
        history = mo.run(0, filter, model, mo.plots([np.reshape(plots, (-1, 1))]))
        evidence, mean, cov = exact_moments(m, P, (0, 3), plots, 0.8, np.log(1.5 / 8))
        np.testing.assert_allclose(history.log_likelihood, evidence, rtol=1e-9)
        np.testing.assert_allclose(history.mean[0], mean, rtol=1e-9, atol=1e-9)
        for states in ([0, 1], [2, 3], [4]):
            np.testing.assert_allclose(history.cov[0][np.ix_(states, states)], cov[np.ix_(states, states)], rtol=1e-8, atol=1e-9)


@pytest.mark.night
def test_what_is_correlated_with_a_target_moves_with_it(double):
    """One target whose sensor's bias is a state besides: the same as the filter of the whole."""
    P = np.array([[1.0, 0.3, 0.4], [0.3, 0.5, 0.2], [0.4, 0.2, 2.0]])
    start, move = mo.Gaussian(np.zeros(3), P), mo.AdditiveGaussian(lambda x, u, t: 0.9 * x, 0.1 * np.eye(3))
    names, scans = ("a", "v_a", "rest"), mo.plots([np.array([[0.3], [1.2]]), np.zeros((0, 1)), np.array([[-0.2]])])
    alone, among = (mo.StateSpaceModel(start, move, sensor, names)
                    for sensor in (one(0.8), mo.laws.SeveralTargets(one(0.8), (("a", "v_a"),))))  # fmt: skip
    wanted, found = (mo.run(0, mo.KalmanFilter(), model, scans) for model in (alone, among))
    np.testing.assert_allclose(found.mean, wanted.mean, rtol=1e-10, atol=1e-12)
    np.testing.assert_allclose(found.cov, wanted.cov, rtol=1e-10, atol=1e-12)
    np.testing.assert_allclose(found.log_likelihood, wanted.log_likelihood, rtol=1e-10)


@pytest.mark.parametrize("plots", each(
    {"none": [], "few": [0.2, 0.9, -0.4], "many": [0.1, 0.4, 0.45, 2.0, -3.0, *range(900, 920)]}, {"none", "many"}))  # fmt: skip
def test_clouds_of_targets_are_weighed_by_all_associations(double, plots):
    """As all pairs of particles together would be, brought down to each target: five particles each, all 25 pairs."""
    sensor, rng = several(2, clutter=0.02, plots=30), np.random.default_rng(3)
    X, weights = rng.normal(size=(4, 5)), rng.dirichlet(np.ones(5), size=2)
    clouds = mo.laws.TargetClouds.of(jnp.asarray(X), sensor.indices)
    clouds = mo.replace(clouds, clouds=mo.replace(clouds.clouds, log_weights=jnp.log(weights)))
    model = mo.StateSpaceModel(mo.Gaussian(np.zeros(4), np.eye(4)), mo.AdditiveGaussian(lambda x, u, t: x, np.eye(4)), sensor, NAMES[:4])
    y = jax.tree.map(lambda leaf: leaf[0], model.sensor.packed(mo.plots([np.reshape(plots, (-1, 1))])))
    after, info = mo.JPDAParticleFilter(n=5).correct(jax.random.key(0), model, clouds, y, None, 0)
    first, second = np.repeat(np.arange(5), 5), np.tile(np.arange(5), 5)
    joint = enumerated(np.concatenate([X[:2, first], X[2:, second]]), plots, 2, seen, lambda z: np.log(0.02), 0.0)
    joint += np.log(weights[0][first] * weights[1][second])
    whole = logsumexp(joint)
    joint = np.exp(joint - whole).reshape(5, 5)
    np.testing.assert_allclose(info.log_evidence, whole, rtol=1e-9)
    np.testing.assert_allclose(after.clouds.weights[0], joint.sum(axis=1), rtol=1e-8, atol=1e-12)
    np.testing.assert_allclose(after.clouds.weights[1], joint.sum(axis=0), rtol=1e-8, atol=1e-12)


def test_messages_between_targets_and_plots(double):
    """Exact where no targets share two plots (a chain), near the exact sum elsewhere; one target, impossible and certain plots."""
    rng = np.random.default_rng(0)
    chain = np.full((4, 5), association.NEVER)
    for i in range(4):
        chain[i, i : i + 2] = 3 * rng.normal(size=2)
    others = [2 * rng.normal(size=(5, 7)) for _ in range(20)]
    for place, hits in enumerate([chain, chain[:1], 40 + chain, *others]):
        false = np.zeros(hits.shape[1])
        if place == 0:
            false[2] = association.NEVER  # must be a target's
        misses = np.log(rng.uniform(0.05, 0.6, len(hits)))
        given = tuple(map(jnp.asarray, (hits, misses, false)))
        (wanted, exact), (total, found) = jax.jit(association._summed)(*given), jax.jit(association._by_messages)(*given)
        near = 1e-9 if place < 3 else 0.1
        np.testing.assert_allclose(found, exact, rtol=0, atol=near)
        np.testing.assert_allclose(total, wanted, rtol=0, atol=2 * near)
        np.testing.assert_allclose(np.sum(found, axis=1), 1.0, rtol=1e-9)


@pytest.mark.night
def test_many_targets_and_what_is_refused_of_them():
    """Seven targets, more than are summed over, which pass each other in a line: none lost by either filter with a law for each."""
    count, steps = 7, 30
    names = tuple(f"{what}{i}" for i in range(count) for what in ("x", "v"))
    A, Q = np.array([[1.0, 1.0], [0.0, 1.0]]), 0.01 * np.array([[1 / 3, 1 / 2], [1 / 2, 1.0]])
    start = np.array([[6.0 * i, -0.3 * (-1) ** i] for i in range(count)]).ravel()
    sensor = mo.Cluttered(mo.AdditiveGaussian(lambda x, u, t: x[:1], [[0.1]]), 0.9, clutter=(3.0, mo.Uniform([-20.0], [80.0])), plots=40)
    targets = tuple(names[2 * i : 2 * i + 2] for i in range(count))
    initial, dynamics = mo.Gaussian(start, 0.1 * np.eye(2 * count)), mo.LinearGaussian(np.kron(np.eye(count), A), np.kron(np.eye(count), Q))
    model = mo.StateSpaceModel(initial, dynamics, mo.laws.SeveralTargets(sensor, targets), names)
    xs, ys = mo.simulate(2, model, steps)
    for filter in (mo.KalmanFilter(), mo.JPDAParticleFilter(n=500)):
        history = mo.run(1, filter, model, ys)
        error = np.asarray(history.mean - xs)[:, ::2]
        assert np.abs(error[-1]).max() < 2 and np.sqrt(np.mean(error**2)) < 0.45
        assert np.isfinite(history.log_likelihood)
    with pytest.raises(mo.MotesError, match="SeveralTargets targets: expected at most 6, .*, got 7"):
        mo.run(1, mo.ParticleFilter(n=500), model, ys)
    together = mo.LinearGaussian(np.kron(np.eye(count), A) + 0.1 * np.eye(2 * count, k=2), np.kron(np.eye(count), Q))
    with pytest.raises(mo.MotesError, match="JPDAParticleFilter dynamics: expected independent targets, got x0 that depends on x1"):
        mo.run(1, mo.JPDAParticleFilter(n=500), mo.replace(model, dynamics=together), ys)
    fewer = mo.replace(model, sensor=mo.laws.SeveralTargets(sensor, targets[:-1]).of_states(names))
    with pytest.raises(mo.MotesError, match="JPDAParticleFilter model: expected a target for each state, got none for x6"):
        mo.run(1, mo.JPDAParticleFilter(n=500), fewer, ys)


def test_what_cannot_be_is_refused():
    for arguments, words in (
        ((3, (("a",),)), "SeveralTargets one: expected a Cluttered sensor"),
        ((one(), (("a", "v_a"), ("b",))), "SeveralTargets targets: expected 1 to 100 targets of the same number of states"),
        ((one(), (("a", "v_a"), ("a", "v_b"))), "SeveralTargets targets: expected states of their own, got 'a' for two"),
        ((one(plots=11), (("a", "v_a"), ("b", "v_b"))), "SeveralTargets plots: expected at least 12 for 2 targets, got 11"),
    ):
        with pytest.raises(mo.MotesError, match=words):
            mo.laws.SeveralTargets(*arguments)
    with pytest.raises(mo.MotesError, match="SeveralTargets targets: expected among the states a, v_a, got 'z'"):
        mo.laws.SeveralTargets(one(), (("z", "v_a"),)).of_states(("a", "v_a"))


# two targets that cross -----------------------------------------------------------------------------------------------

PLANE = ("east_1", "north_1", "v_east_1", "v_north_1", "east_2", "north_2", "v_east_2", "v_north_2")


def crossing():
    """Both models of two targets whose paths cross at a small angle: with the plots of each, and with scans."""
    def f(x, u, t):
        return jnp.concatenate([x[:2] + x[2:4], x[2:4], x[4:6] + x[6:], x[6:]])

    white = np.kron(0.05 * np.array([[1 / 3, 1 / 2], [1 / 2, 1.0]]), np.eye(2))
    start = mo.Gaussian(np.array([-400.0, 80, 10, -2, -400, -80, 10, 2]), np.diag([100.0, 100.0, 1.0, 1.0] * 2))
    place = mo.AdditiveGaussian(lambda x, u, t: x[:2], 100.0 * np.eye(2))
    region = mo.Uniform(np.full(2, -600.0), np.full(2, 600.0))
    scans = mo.laws.SeveralTargets(mo.Cluttered(place, 0.9, clutter=(10.0, region), plots=40), (PLANE[:4], PLANE[4:]))
    own = mo.AdditiveGaussian(lambda x, u, t: jnp.concatenate([x[:2], x[4:6]]), 100.0 * np.eye(4))
    dynamics = mo.AdditiveGaussian(f, np.kron(np.eye(2), white))
    return mo.StateSpaceModel(start, dynamics, own, PLANE), mo.StateSpaceModel(start, dynamics, scans, PLANE)


def places(states):
    return np.stack([states[..., :2], states[..., 4:6]], axis=-2)


def test_velocities_of_all_targets_go_to_the_kalman_part():
    assert mo.structure(crossing()[1]).linear == (2, 3, 6, 7)


@pytest.mark.night
@pytest.mark.parametrize("filter", [mo.MarginalizedParticleFilter(n=1_000), mo.JPDAParticleFilter(n=1_000), mo.KalmanFilter()],
                         ids=lambda filter: type(filter).__name__)  # fmt: skip
def test_targets_that_cross_are_kept_apart(filter):
    """50 runs of 80 scans, 10 false plots each, detection 0.9: none lost, at most 2 exchanged; the genie knows which plot is whose."""
    plain, scanned = crossing()

    def one_run(key):
        keys = jax.random.split(key, 4)
        xs, ys = mo.simulate(keys[0], scanned, 80)
        tracked = mo.run(keys[1], filter, scanned, ys, keep=mo.keep.means).mean
        true, own = mo.simulate(keys[2], plain, 80)
        own = jnp.where(jnp.repeat(jax.random.uniform(keys[3], (80, 2)) < 0.9, 2, axis=1), own, jnp.nan)
        return tracked, xs, mo.run(keys[1], mo.KalmanFilter(), plain, own, keep=mo.keep.means).mean, true

    found = jax.jit(lambda keys: jax.lax.map(one_run, keys))(jax.random.split(jax.random.key(5), 50))
    tracked, xs, genie, true = (places(np.asarray(each)) for each in found)
    error = np.linalg.norm(tracked - xs, axis=-1)
    assert error[:, -10:].mean(axis=1).max() < 60  # of each target, by its own track
    assert sum(mo.diagnostics.swaps(one, other, 60.0) for one, other in zip(tracked, xs, strict=True)) <= 4
    best = np.sqrt(np.mean(np.sum((genie - true) ** 2, axis=-1)))
    assert np.sqrt(np.mean(error**2)) <= 1.35 * best


def test_swaps_are_counted_once_and_tracks_stay_with_their_targets():
    truth = np.stack([np.array([[t, 1.0], [t, -1.0]]) for t in range(6)])
    assert mo.diagnostics.swaps(truth, truth, 3.0) == 0
    swapped = np.concatenate([truth[:3], truth[3:, ::-1]])
    assert mo.diagnostics.swaps(swapped, truth, 1.5) == 2
    assert mo.diagnostics.swaps(swapped, truth, 3.0) == 0, "within the cutoff a track stays"
    gone = truth.copy()
    gone[2:4] += 100.0
    assert mo.diagnostics.swaps(gone, truth, 1.5) == 0
    absent, short = swapped.copy(), truth.copy()
    absent[2:4], short[4:, 1] = np.nan, np.nan
    assert mo.diagnostics.swaps(absent, truth, 1.5) == 2, "what is not there follows nothing and is not forgotten"
    assert mo.diagnostics.swaps(swapped, short, 1.5) == 2
    assert followers(absent, short, 1.5).tolist() == [[0, 1], [0, 1], [-1, -1], [-1, -1], [1, -1], [1, -1]]
    with pytest.raises(mo.MotesError, match="swaps estimates: expected points"):
        mo.diagnostics.swaps(truth[0], truth[0], 1.0)


def test_states_that_two_targets_share_are_refused_however_they_are_spelled():
    base = mo.textbook.constant_velocity()
    one = mo.Cluttered(mo.AdditiveGaussian(lambda x, u, t: x[:1], [[0.1]]), 0.9, clutter=0.1, plots=4)
    for targets in ((("px", "py"), (0, 1)), ((2, -1), (0, 3))):
        with pytest.raises(mo.MotesError, match="SeveralTargets targets: expected states of their own"):
            mo.StateSpaceModel(base.initial, base.dynamics, mo.laws.SeveralTargets(one, targets), base.names)


@pytest.mark.parametrize("several", each([True, False], {"True"}))
def test_a_detection_that_reaches_one_has_derivatives(several, double):
    one = mo.Cluttered(mo.AdditiveGaussian(lambda x, u, t: x[:1], [[0.1]]), lambda x, u, t: jax.nn.sigmoid(40 * (x[0] + 1)),
                       clutter=0.1, plots=4)  # fmt: skip
    sensor = mo.laws.SeveralTargets(one, ((0,), (1,))) if several else one
    dynamics = mo.LinearGaussian(np.eye(2), 0.1 * np.eye(2))

    def evidence(place):
        model = mo.StateSpaceModel(mo.Gaussian(jnp.array([place, 3.0]), 0.2 * jnp.eye(2)), dynamics, sensor)
        return mo.run(0, mo.ExtendedKalmanFilter(), model, mo.plots([[[0.2], [3.1]], [[0.3], [2.8]]])).log_likelihood

    slope = jax.grad(evidence)(0.1)
    near = (evidence(0.1 + 1e-6) - evidence(0.1 - 1e-6)) / 2e-6
    assert np.isfinite(slope) and float(slope) == pytest.approx(float(near), rel=1e-3)


@pytest.mark.parametrize("precision", each(["float32", "float64"], {"float32"}), indirect=True)
def test_messages_of_what_is_hardly_possible_are_those_of_the_exact_sum(precision):
    far = np.full((3, 4), -5000.0)
    cases = {
        "one plot far from all, a target's for sure": (far + np.diag([4990.0] * 3 + [0])[:3], [-3.0] * 3, [0, 0, 0, association.NEVER]),
        "both want a plot that none can be without": ([[60.0, 0.0], [60.0, 0.0]], [-13.8] * 2, [0.0, 0.0]),
        "a tree": ([[200.0], [200.0]], [-2.3] * 2, [0.0]),
    }
    for name, given in cases.items():
        (wanted, exact), (total, found) = (how(*map(jnp.asarray, given)) for how in (association._summed, association._by_messages))
        assert float(total) == pytest.approx(float(wanted), abs=0.7), name
        np.testing.assert_allclose(found, exact, atol=0.01 if name != "both want a plot that none can be without" else 0.51)
    nothing = association._by_messages(jnp.full((2, 1), 1.0), jnp.full(2, association.NEVER), jnp.zeros(1))[0]
    assert float(nothing) == -np.inf
