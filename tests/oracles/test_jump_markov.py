"""Filters for jump-Markov systems against enumeration of all paths of modes, forward recursions and grids."""

from itertools import product

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.special import logsumexp
from scipy.stats import norm

import motes as mo
from motes.core.record import replace
from motes.laws.mode_mixture import ModeMixture
from motes.resampling import reduction
from tiers import each

pytestmark = pytest.mark.jax

CHAIN = np.array([[0.85, 0.1, 0.05], [0.3, 0.6, 0.1], [0.0, 0.55, 0.45]])
START = np.array([0.5, 0.2, 0.3])
A = [np.array([[0.9, 0.3], [-0.1, 0.7]]), np.array([[1.1, -0.2], [0.4, 0.5]]), np.array([[0.3, 0.0], [0.0, -0.8]])]
Q = [np.array([[0.3, 0.1], [0.1, 0.2]]), np.diag([0.05, 0.4]), np.diag([1.5, 0.1])]
H = [np.array([[1.0, 0.2], [0.3, -1.0]]), np.array([[1.0, 0.0], [0.0, 1.0]]), np.array([[0.5, 0.5], [1.0, -0.4]])]
R = [np.diag([0.5, 0.8]), np.array([[0.4, 0.1], [0.1, 0.3]]), np.diag([1.0, 0.6])]
MEAN, COV = [np.array([1.0, -0.5]), np.array([0.0, 0.5]), np.array([-1.0, 1.0])], [np.eye(2), 2 * np.eye(2), np.diag([0.5, 1.0])]


def by_mode(modes=3):
    """Linear-Gaussian models that differ in all their parts."""
    parts = zip(MEAN, COV, A, Q, H, R, strict=True)
    return [mo.StateSpaceModel(mo.Gaussian(m, P), mo.LinearGaussian(a, q), mo.LinearGaussian(h, r), ("a", "b"))
            for m, P, a, q, h, r in list(parts)[:modes]]  # fmt: skip


def chained():
    return mo.JumpMarkovModel(START, CHAIN, by_mode())


def measured(steps):
    ys = np.array(mo.simulate(3, chained(), steps)[1])
    ys[1, 0], ys[2] = np.nan, np.nan
    return ys


def alike():
    """The same system as one model whose functions take the mode; the initial law is that of the first mode in all."""
    a, q, h, r = (jnp.asarray(np.stack(parts)) for parts in (A, Q, H, R))
    dynamics = mo.LinearGaussian(lambda x, u, t, mode: a[mode], lambda x, u, t, mode: q[mode])
    sensor = mo.AdditiveGaussian(lambda x, u, t, mode: h[mode] @ x, lambda x, u, t, mode: r[mode])
    return mo.JumpMarkovModel(START, CHAIN, model=mo.StateSpaceModel(mo.Gaussian(MEAN[0], COV[0]), dynamics, sensor, ("a", "b")), modes=3)


def enumerated(ys, chain=lambda t: CHAIN, of=-1, starts=(MEAN, COV)):
    """Log likelihood, mean at the last step and mode probabilities at one, by a Kalman filter for every path of modes."""
    totals, means, last = [], [], []
    for path in product(range(3), repeat=len(ys)):
        m, P, total = starts[0][path[0]], starts[1][path[0]], np.log(START[path[0]])
        for t, (mode, y) in enumerate(zip(path, ys, strict=True)):
            if t:
                with np.errstate(divide="ignore"):
                    total += np.log(chain(t)[path[t - 1], mode])
                m, P = A[mode] @ m, A[mode] @ P @ A[mode].T + Q[mode]
            seen = ~np.isnan(y)
            if seen.any():
                h, r = H[mode][seen], R[mode][np.ix_(seen, seen)]
                S = h @ P @ h.T + r
                off = y[seen] - h @ m
                total -= 0.5 * (off @ np.linalg.solve(S, off) + np.linalg.slogdet(2 * np.pi * S)[1])
                gain = P @ h.T @ np.linalg.inv(S)
                m, P = m + gain @ off, P - gain @ h @ P
        totals.append(total), means.append(m), last.append(path[of])
    evidence = logsumexp(totals)
    weights = np.exp(np.array(totals) - evidence)
    return evidence, weights @ np.array(means), np.bincount(last, weights, 3)


def check_exact(history, ys, chain=lambda t: CHAIN):
    for t in range(len(ys)):
        evidence, mean, modes = enumerated(ys[: t + 1], chain)
        assert np.allclose(history.mode_probabilities[t], modes, rtol=0, atol=1e-6)
        assert np.allclose(history.mean[t], mean, rtol=0, atol=1e-6)
    assert abs(float(history.log_likelihood) - evidence) < 1e-6


@pytest.mark.night
def test_every_path_of_modes_is_summed_while_particles_last(double):
    """Mode probabilities, means and log likelihood equal enumeration, with components and whole rows missing.

    Transitions depend on inputs and time; the 3^4 paths of four steps are as many as particles.
    """
    def chain(u, t):
        return jnp.stack([u["row"], jnp.where(t == 2, jnp.array([0.1, 0.1, 0.8]), CHAIN[1]), jnp.asarray(CHAIN[2])])

    rows = np.array([[0.0, 0.0, 1.0], [0.2, 0.2, 0.6], [0.9, 0.0, 0.1], [0.4, 0.3, 0.3], [0.1, 0.9, 0.0]])
    model, ys = mo.JumpMarkovModel(START, chain, by_mode()), measured(5)
    history = mo.run(0, mo.JumpMarkovFilter(n=81), model, ys, {"row": rows}, keep=mo.keep.modes)
    check_exact(history, ys, lambda t: np.asarray(chain({"row": jnp.asarray(rows[t])}, t)))


@pytest.mark.night
def test_fewer_particles_than_paths_leave_the_likelihood_unbiased(double):
    """Mean ratio to the exact likelihood over 1000 seeds is one (level 1e-6), and the law is near the exact one."""
    ys = measured(6)
    filter, keys = mo.JumpMarkovFilter(n=5), jax.random.split(jax.random.key(2), 1000)
    run = jax.jit(jax.vmap(lambda key: (lambda h: (h.log_likelihood, h.mode_probabilities[-1]))(
        mo.run(key, filter, chained(), jnp.asarray(ys), keep=mo.keep.modes))))  # fmt: skip
    totals, modes = map(np.asarray, run(keys))
    exact, _, probabilities = enumerated(ys)
    ratio = np.exp(totals - exact)
    assert 0.01 < ratio.std() < 0.5
    assert abs(ratio.mean() - 1) < 4.9 * ratio.std() / np.sqrt(len(ratio))
    assert np.allclose((ratio[:, None] * modes).mean(axis=0), probabilities, atol=0.01)


def pseudo_bayes(ys):
    """Log likelihood, means and mode probabilities of the generalized pseudo-Bayes filter of order two, one Gaussian for each mode."""
    held, total, found = [(START[j], MEAN[j], COV[j], j) for j in range(3)], 0.0, []
    for t, y in enumerate(ys):
        if t:
            held = [(w * CHAIN[i, j], A[j] @ m, A[j] @ P @ A[j].T + Q[j], j) for w, m, P, i in held for j in range(3)]
        seen, after = ~np.isnan(y), []
        for w, m, P, j in held:
            h, off = H[j][seen], (y - H[j] @ m)[seen]
            S = h @ P @ h.T + R[j][np.ix_(seen, seen)]
            gain = P @ h.T @ np.linalg.inv(S)
            density = np.exp(-0.5 * off @ np.linalg.solve(S, off)) / np.sqrt(np.linalg.det(2 * np.pi * S))
            after.append((w * density, m + gain @ off, P - gain @ h @ P, j))
        evidence = sum(w for w, *_ in after)
        total += np.log(evidence)
        held = []
        for j in range(3):
            own = [(w / evidence, m, P) for w, m, P, mode in after if mode == j]
            weight = sum(w for w, *_ in own)
            middle = sum(w * m for w, m, _ in own) / weight
            held.append((weight, middle, sum(w * (P + np.outer(m - middle, m - middle)) for w, m, P in own) / weight, j))
        found.append((sum(w * m for w, m, *_ in held), [w for w, *_ in held]))
    return total, np.array([m for m, _ in found]), np.array([w for _, w in found])


def test_hypotheses_that_agree_in_their_last_modes_are_merged(double):
    """Merged by the last mode the filter is generalized pseudo-Bayes of order two, with components and a row missing."""
    ys = measured(6)
    history = mo.run(0, mo.JumpMarkovFilter(n=3, merge=1), chained(), ys, keep=mo.keep.modes)
    total, means, modes = pseudo_bayes(ys)
    assert np.allclose(history.mean, means, rtol=0, atol=1e-9) and np.allclose(history.mode_probabilities, modes, rtol=0, atol=1e-9)
    assert abs(float(history.log_likelihood) - total) < 1e-9


def test_merging_leaves_the_moments_of_a_mixture(double):
    """Mean, covariance and mode probabilities stay; what differs in a certain state or a mode, and what has no weight, stays apart."""
    rng = np.random.default_rng(0)
    roots, symbols = rng.normal(size=(3, 3, 8)), np.array([1, 1, 1, 1, -1, -1, 1, 1.0])
    roots[1] = 0
    centers, covs = rng.normal(size=(3, 8)) + 1e3, np.einsum("ikn,jkn->ijn", roots, roots)
    centers[1], centers[0, 7] = symbols, np.nan
    log_weights = np.log(np.array([0.1, 0.2, 0.1, 0.1, 0.15, 0.25, 0.1, 0.0]), where=np.arange(8) < 7, out=np.full(8, -np.inf))
    modes, earlier = np.array([0, 0, 0, 1, 0, 0, 0, 0], np.int32), np.array([[1, 1, 0, 1, 1, 1, 1, 1], [0, 1, 1, 1, 0, 1, 2, 1]], np.int32)
    law = ModeMixture(mo.Gaussian(np.nan_to_num(centers), covs), jnp.asarray(log_weights), jnp.asarray(modes), 2, jnp.asarray(earlier))
    law = replace(law, parts=replace(law.parts, center=jnp.asarray(centers)))
    merged = jax.jit(lambda law: law.merged(2, (1,)))(law)
    assert np.flatnonzero(np.isfinite(merged.log_weights)).tolist() == [1, 2, 3, 5]
    assert np.allclose(merged.weights[jnp.array([1, 2, 3, 5])], [0.4, 0.1, 0.1, 0.4])
    assert np.allclose(merged.mean(), law.mean()) and np.allclose(merged.cov(), law.cov(), rtol=0, atol=1e-8)
    assert np.allclose(merged.mode_probabilities(), law.mode_probabilities())
    assert np.array_equal(merged.earlier_modes, earlier) and set(np.asarray(merged.parts.center)[1]) == {-1.0, 1.0}


def test_interacting_models_are_near_the_exact_law(double):
    ys = measured(6)
    history = mo.run(0, mo.InteractingMultipleModel(), chained(), ys, keep=mo.keep.modes)
    evidence, mean, modes = enumerated(ys)
    assert np.allclose(history.mode_probabilities[0], enumerated(ys[:1])[2], atol=1e-12)
    error = np.abs(np.asarray(history.mode_probabilities[-1]) - modes).max()
    assert 1e-6 < error < 0.05 and abs(float(history.log_likelihood) - evidence) < 0.1
    assert np.abs(np.asarray(history.mean[-1]) - mean).max() < 0.1


def levels(values=(0.0, 1.0, 2.5), state=0.0):
    """A hidden Markov model: the state is known, and each mode measures another level."""
    none = np.zeros((1, 1))
    return [mo.StateSpaceModel(mo.Gaussian([state], none), mo.LinearGaussian([[1.0]], none),
            mo.AdditiveGaussian(lambda x, u, t, value=value: x + value, [[0.5 + value + state]])) for value in values]  # fmt: skip


@pytest.mark.parametrize("filter", each({"mixing": mo.InteractingMultipleModel(), "particles": mo.JumpMarkovFilter(n=3**7)}, {"particles"}))
def test_without_uncertain_states_the_forward_recursion_of_a_hidden_markov_model(filter, double):
    ys = np.array([0.2, 1.4, np.nan, 3.0, 0.9, -0.3, 0.1, 2.0])[:, None]
    history = mo.run(0, filter, mo.JumpMarkovModel(START, CHAIN, levels()), ys, keep=mo.keep.modes)
    forward, total = START, 0.0
    for t, (y,) in enumerate(ys):
        forward = forward @ CHAIN if t else forward
        if not np.isnan(y):
            forward = forward * [norm.pdf(y, v, np.sqrt(0.5 + v)) for v in (0.0, 1.0, 2.5)]
        total, forward = total + np.log(forward.sum()), forward / forward.sum()
        assert np.allclose(history.mode_probabilities[t], forward, rtol=0, atol=1e-6)
    assert abs(float(history.log_likelihood) - total) < 1e-6


def test_a_mode_that_cannot_be_hides_no_collapse():
    """The second mode would explain the outlier, but its probability is zero."""
    parts = [mo.StateSpaceModel(mo.Gaussian([0.0], [[1.0]]), mo.LinearGaussian([[1.0]], [[0.1]]), mo.LinearGaussian([[1.0]], [[R]]))
             for R in (0.1, 1e8)]  # fmt: skip
    with pytest.raises(mo.CollapseError, match="step 2"):
        mo.run(0, mo.InteractingMultipleModel(), mo.JumpMarkovModel([1.0, 0.0], np.eye(2), parts), np.array([[0.1], [0.2], [1e4]]))


@pytest.mark.parametrize("filter", each({"mixing": mo.InteractingMultipleModel(), "particles": mo.JumpMarkovFilter(n=8)}, {"mixing"}))
def test_one_mode_is_the_extended_kalman_filter(filter, double):
    model = mo.StateSpaceModel(
        mo.Gaussian([1.0, 0.3], [[0.4, 0.1], [0.1, 0.2]]),
        mo.AdditiveGaussian(lambda x, u, t: jnp.array([x[0] * jnp.cos(x[1]), 0.9 * x[1]]), np.diag([0.1, 0.02])),
        mo.AdditiveGaussian(lambda x, u, t: jnp.array([jnp.exp(0.5 * x[0]), x[0] * x[1]]), np.array([[0.2, 0.05], [0.05, 0.1]])),
    )
    ys = np.array(mo.simulate(1, model, 12)[1])
    ys[3, 1], ys[5] = np.nan, np.nan
    wanted, found = (mo.run(0, each, model, ys) for each in (mo.ExtendedKalmanFilter(), filter))
    assert np.allclose(found.mean, wanted.mean, atol=1e-9) and np.allclose(found.cov, wanted.cov, atol=1e-9)
    assert np.allclose(found.log_likelihood, wanted.log_likelihood, atol=1e-9)


def alternating():
    """Two modes that change places at nearly every step, and pull a state that is seen with noise to either side."""
    def part(level):
        return mo.StateSpaceModel(mo.Gaussian([0.0], [[4.0]]), mo.AdditiveGaussian(lambda x, u, t: 0.7 * x + level, [[0.3]]),
                                  mo.LinearGaussian([[1.0]], [[0.5]]))  # fmt: skip

    return mo.JumpMarkovModel([0.7, 0.3], [[0.02, 0.98], [0.98, 0.02]], [part(-1.0), part(1.5)])


@pytest.mark.parametrize("filter", each({
    "mixing": mo.InteractingMultipleModel(), "particles": mo.JumpMarkovFilter(n=30), "drawn": mo.JumpMarkovFilter(n=300, sampled=(0,)),
}, {"particles"}))
def test_an_alternating_chain_is_tracked(filter):
    """The mode moves at 98 percent of the steps, and the filter says which it is."""
    xs, ys = map(np.array, mo.simulate(4, alternating(), 300))
    assert (xs[1:, 1] != xs[:-1, 1]).mean() > 0.95
    history = mo.run(0, filter, alternating(), ys, keep=mo.keep.modes)
    probable = np.asarray(history.mode_probabilities).argmax(axis=1)
    assert (probable == xs[:, 1])[20:].mean() > 0.9
    assert (probable[1:] != probable[:-1]).mean() > 0.9


@pytest.mark.night
def test_drawn_states_and_the_joined_model_agree_with_a_grid(double):
    """A curved sensor: the point-mass filter on state and mode is the exact answer for particles with and without a Kalman part."""
    def part(slope, level, variance):
        return mo.StateSpaceModel(mo.Gaussian([0.5], [[0.5]]), mo.AdditiveGaussian(lambda x, u, t: slope * x + level, [[variance]]),
                                  mo.AdditiveGaussian(lambda x, u, t: x + 0.3 * x**2, [[0.4]]))  # fmt: skip

    model = mo.JumpMarkovModel([0.6, 0.4], [[0.9, 0.1], [0.25, 0.75]], [part(0.8, 0.0, 0.1), part(0.5, 1.0, 0.5)])
    ys = jnp.array([[0.4], [0.1], [2.5], [jnp.nan], [3.0], [0.6]])
    exact = mo.run(0, mo.PointMassFilter((-4.0, 0.0), (6.0, 1.0), (300, 2)), model.as_state_space(), ys)
    keys = jax.random.split(jax.random.key(1), 24)
    for filter, given in ((mo.JumpMarkovFilter(n=500, sampled=(0,)), model), (mo.ParticleFilter(n=2000), model.as_state_space())):
        run = jax.jit(jax.vmap(lambda key, f=filter, m=given: (lambda h: (h.mean[:, :1], h.log_likelihood))(mo.run(key, f, m, ys))))
        means, totals = map(np.asarray, run(keys))
        error = 5.5 / np.sqrt(len(keys))
        assert np.all(np.abs(means.mean(axis=0) - exact.mean[:, :1]) < error * means.std(axis=0) + 2e-3)
        assert abs(totals.mean() + totals.var() / 2 - float(exact.log_likelihood)) < error * totals.std() + 2e-3
        assert totals.std() < 0.15


def nile():
    """A level that is nearly constant and breaks once in fifty years on average."""
    def part(variance):
        return mo.StateSpaceModel(mo.Gaussian([1000.0], [[200.0**2]]), mo.LinearGaussian([[1.0]], [[variance]]),
                                  mo.LinearGaussian([[1.0]], [[15099.0]]), ("level",))  # fmt: skip

    return mo.JumpMarkovModel([0.98, 0.02], [[0.98, 0.02]] * 2, [part(100.0), part(100.0 + 300.0**2)])


@pytest.mark.night
def test_nile_with_rare_breaks_has_the_likelihood_of_a_grid():
    """2000 particles are within 0.6 of the point-mass filter (within 0.001 in float64), and 100 have a deviation of 0.007."""
    flow = mo.data.nile().values
    breaks = mo.Mixture.of([0.98, 0.02], [[0.0, 0.0]], [[[100.0, 100.0 + 300.0**2]]])
    model = nile()
    smooth = mo.StateSpaceModel(model.models[0].initial, mo.AdditiveNoise(lambda x, u, t: x, breaks), model.models[0].sensor)
    grid = mo.run(0, mo.PointMassFilter(0.0, 2000.0, 401), smooth, flow).log_likelihood
    many = mo.run(1, mo.JumpMarkovFilter(n=2000), model, flow, keep=mo.keep.modes)
    assert abs(float(many.log_likelihood) - float(grid)) < 0.05
    keys = jax.random.split(jax.random.key(3), 20)
    few = jax.jit(jax.vmap(lambda key: mo.run(key, mo.JumpMarkovFilter(n=100), model, jnp.asarray(flow)).log_likelihood))(keys)
    assert abs(float(few.mean()) - float(grid)) < 0.1 and float(few.std()) < 0.05


@pytest.mark.parametrize("filter", each({"one model": 0, "a model for each": 1}, {"a model for each"}))
def test_modes_known_with_a_delay_equal_enumeration(filter, double):
    """Probabilities of each mode given the measurements of two more steps, with rows missing; the last steps have fewer after them."""
    ys = measured(5)
    model, starts = (chained(), (MEAN, COV)) if filter else (alike(), ([MEAN[0]] * 3, [COV[0]] * 3))
    for n, lag in ((81, 2), (81, 4)):
        history = mo.run(0, mo.JumpMarkovFilter(n=n), model, ys, keep=mo.keep.modes(lag=lag))
        for t in range(5):
            wanted = enumerated(ys[: min(t + lag, 4) + 1], of=t, starts=starts)[2]
            assert np.allclose(history.mode_probabilities_after(lag)[t], wanted, rtol=0, atol=1e-8)
        assert np.array_equal(history.mode_probabilities_after(0), history.mode_probabilities)
        assert np.isnan(history.kept["delayed_mode_probabilities"][0, 1:]).all()


def test_the_most_probable_path_of_modes_equals_enumeration(double):
    """Of a hidden Markov model with a row missing and a transition that cannot be, against all paths of seven steps."""
    ys = np.array([0.2, 1.4, np.nan, 3.0, 0.9, -0.3, 0.1])[:, None]
    model = mo.JumpMarkovModel(START, CHAIN, levels())
    history = mo.run(0, mo.InteractingMultipleModel(), model, ys, keep=mo.keep.laws)
    with np.errstate(divide="ignore"):
        chain, start = np.log(CHAIN), np.log(START)
    fits = np.array([[0.0 if np.isnan(y) else norm.logpdf(y, v, np.sqrt(0.5 + v)) for v in (0.0, 1.0, 2.5)] for (y,) in ys])
    paths = np.array(list(product(range(3), repeat=len(ys))))
    log_p = start[paths[:, 0]] + chain[paths[:, :-1], paths[:, 1:]].sum(axis=1) + fits[np.arange(len(ys)), paths].sum(axis=1)
    found = mo.smooth(1, mo.smoothers.Viterbi(), model, history)
    assert np.array_equal(found.modes[:, 0], paths[log_p.argmax()])
    with jax.enable_x64(False):
        # rounding leaves something of a variance where the state is another than zero
        model = mo.JumpMarkovModel(START, CHAIN, levels((-0.3, 0.7, 2.2), 0.3))
        history = mo.run(0, mo.InteractingMultipleModel(), model, ys.astype(np.float32), keep=mo.keep.laws)
        assert np.array_equal(mo.smooth(1, mo.smoothers.Viterbi(), model, history).modes[:, 0], paths[log_p.argmax()])
    assert found.paths.shape == (7, 1, 1)


@pytest.mark.night
def test_the_path_of_modes_asks_for_known_states_and_one_component_for_each(double):
    ys = measured(3)
    mixed = mo.run(0, mo.InteractingMultipleModel(), chained(), ys, keep=mo.keep.laws)
    with pytest.raises(mo.MotesError, match="states that are known, as in a hidden Markov model.*Use MixtureSmoother."):
        mo.smooth(1, mo.smoothers.Viterbi(), chained(), mixed)
    many = mo.run(0, mo.JumpMarkovFilter(n=2), mo.JumpMarkovModel(START, CHAIN, levels()), ys[:, :1], keep=mo.keep.laws)
    with pytest.raises(mo.MotesError, match="one component for each of 3 modes, got 6. Use MixtureSmoother, or"):
        mo.smooth(1, mo.smoothers.Viterbi(), mo.JumpMarkovModel(START, CHAIN, levels()), many)


def test_few_and_many_hypotheses_are_brought_down_alike(monkeypatch):
    """By sums over pairs and by sorting: the same ancestors and weights, with ties and without weight."""
    rng = np.random.default_rng(0)
    both = {paired: jax.jit(lambda key, log_weights, n=6: reduction.reduced(key, log_weights, n)) for paired in (0, reduction.PAIRED)}
    for trial in range(60):
        log_weights = rng.normal(size=12) * rng.choice([0.1, 1.0, 10.0, 60.0])
        log_weights = np.round(log_weights) if trial % 3 == 0 else log_weights
        log_weights[: trial % 8] = -np.inf
        found = {}
        for paired, reduced in both.items():
            monkeypatch.setattr(reduction, "PAIRED", paired)
            found[paired] = reduced(jax.random.key(trial), jnp.asarray(log_weights - logsumexp(log_weights), jnp.float32))
        one, two = found.values()
        assert np.array_equal(one.ancestors, two.ancestors) and np.allclose(one.log_weights, two.log_weights, atol=1e-4)
        assert abs(float(jnp.exp(one.log_weights).sum()) - 1) < 1e-5
