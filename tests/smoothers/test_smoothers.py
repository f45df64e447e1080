"""Every smoother is held to the exact moments of a linear-Gaussian model, found by conditioning the joint law of all states at once."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

import motes as mo
from motes.core import record
from motes.smoothers import smooth as smoothing
from tiers import each

STEPS = 9


def linear(cross_cov=None):
    """Two states, asymmetric, one measured strongly; the second noise is much smaller."""
    return mo.StateSpaceModel(
        mo.Gaussian([1.0, -0.5], [[2.0, 0.3], [0.3, 0.7]]),
        mo.LinearGaussian([[0.9, 0.6], [-0.2, 0.8]], [[0.8, 0.15], [0.15, 0.3]]),
        mo.LinearGaussian([[1.0, 0.4]], [[0.6]]),
        ("a", "b"), cross_cov,
    )  # fmt: skip


def data(model, steps=STEPS, seed=4):
    ys = np.array(mo.simulate(seed, model, steps)[1])
    ys[3] = np.nan
    return ys


def joint(model, ys):
    """Covariance of all states together and smoothed means `(t, x)`, by the normal equations of all steps (no recursion)."""
    steps, d = len(ys), 2
    A, Q, H, R = (np.asarray(m, float) for m in (model.dynamics.A, model.dynamics.Q, model.sensor.A, model.sensor.Q))
    S = np.zeros((2, 1)) if model.noise_cross_cov is None else np.asarray(model.noise_cross_cov, float)
    information, pull = np.zeros((steps * d, steps * d)), np.zeros(steps * d)
    P = np.linalg.inv(np.asarray(model.initial.cov(), float))
    information[:d, :d] += P
    pull[:d] += P @ np.asarray(model.initial.mean(), float)
    for t in range(steps):
        seen = not np.isnan(ys[t]).any()
        rows, target = [], []
        here = slice(t * d, (t + 1) * d)
        if seen:
            row = np.zeros((1, steps * d))
            row[:, here] = H
            rows.append(row)
            target.append(ys[t])
        if t + 1 < steps:
            row = np.zeros((2, steps * d))
            row[:, (t + 1) * d : (t + 2) * d] = -np.eye(2)
            row[:, here] = A
            rows.append(row)
            target.append(np.zeros(2))
        if not rows:
            continue
        noise = np.block([[R, S.T], [S, Q]]) if seen and t + 1 < steps else (R if seen else Q)
        J, W = np.vstack(rows), np.linalg.inv(noise)
        information += J.T @ W @ J
        pull += J.T @ W @ np.concatenate(target)
    cov = np.linalg.inv(information)
    return cov, (cov @ pull).reshape(steps, d)


def exact(model, ys):
    """Smoothed means `(t, x)` and covariances `(t, x, x)`."""
    cov, mean = joint(model, ys)
    return mean, np.stack([cov[2 * t : 2 * t + 2, 2 * t : 2 * t + 2] for t in range(len(ys))])


@pytest.mark.parametrize("rule", [mo.gaussian.Taylor(), mo.gaussian.Cubature()], ids=["slopes", "sigma points"])
@pytest.mark.parametrize("correlated", [False, True])
def test_rauch_tung_striebel_is_exact(rule, correlated, double):
    model = linear([[0.2], [-0.1]] if correlated else None)
    ys = data(model)
    history = mo.run(0, mo.KalmanFilter(), model, ys)
    found = mo.smooth(1, mo.smoothers.RauchTungStriebelSmoother(rule), model, history, ys)
    mean, cov = exact(model, ys)
    assert np.allclose(found.mean, mean, rtol=1e-9, atol=1e-9)
    assert np.allclose(found.cov, cov, rtol=1e-9, atol=1e-9)
    assert found.names == ("a", "b") and repr(rule) in found.label


def errors(smoother, filter, seeds):
    """Errors of smoothed first and second moments, `(seed, t, 5)`."""
    model = linear()
    ys = data(model)
    mean, cov = exact(model, ys)

    def one(key):
        history = mo.run(key, filter, model, jnp.asarray(ys), keep=mo.keep.laws)
        found = mo.smooth(jax.random.fold_in(key, 7), smoother, model, history, jnp.asarray(ys))
        second = found.cov + found.mean[:, :, None] * found.mean[:, None]
        return jnp.concatenate([found.mean, second.reshape(STEPS, 4)[:, jnp.array([0, 1, 3])]], axis=1)

    each = np.asarray(jax.lax.map(jax.jit(one), jax.random.split(jax.random.key(3), seeds)), float)
    second = (cov + mean[:, :, None] * mean[:, None]).reshape(STEPS, 4)[:, [0, 1, 3]]
    return each - np.concatenate([mean, second], axis=1)


PARTICLES = mo.ParticleFilter(n=300)
CASES = {
    "genealogy": (mo.smoothers.GenealogySmoother(), PARTICLES),
    "backward, exact": (mo.smoothers.BackwardSimulationSmoother(n=200), PARTICLES),
    "backward, rejection": (mo.smoothers.BackwardSimulationSmoother(n=200, parents=mo.smoothers.RejectedParents(trials=6)), PARTICLES),
    "backward, steps": (mo.smoothers.BackwardSimulationSmoother(n=200, parents=mo.smoothers.SteppedParents(steps=12)), PARTICLES),
    "two filters": (mo.smoothers.TwoFilterSmoother(n=300), PARTICLES),
    "Rao-Blackwellized": (mo.smoothers.RaoBlackwellizedSmoother(n=150), mo.MarginalizedParticleFilter(n=300, linear=("b",))),
    "Rao-Blackwellized, other part": (mo.smoothers.RaoBlackwellizedSmoother(n=150), mo.MarginalizedParticleFilter(n=300, linear=("a",))),
}


@pytest.mark.parametrize("case", each(CASES, {"backward, steps", "backward, rejection", "two filters", "Rao-Blackwellized, other part"}))
def test_moments_of_a_linear_model(case):
    """Level 1e-6 per case, 45 figures; a bias of 0.03 is allowed for, since a ratio of averages has one of the order 1 / n."""
    seeds = 40
    off = errors(*case, seeds)
    largest = stats.t.isf(1e-6 / 45 / 2, seeds - 1)
    assert np.all(np.abs(off.mean(0)) < largest * off.std(0, ddof=1) / np.sqrt(seeds) + 0.03)


def test_smoothing_is_what_the_moments_need():
    """Filtered moments would fail the test above."""
    model = linear()
    ys = data(model)
    assert np.abs(np.asarray(mo.run(0, mo.KalmanFilter(), model, ys).mean) - exact(model, ys)[0]).max() > 0.4


def test_a_lag_of_all_steps_is_the_genealogy_and_none_is_the_filter():
    model = linear()
    ys = data(model)
    history = mo.run(5, PARTICLES, model, ys, keep=mo.keep.laws)
    genealogy = mo.smooth(0, mo.smoothers.GenealogySmoother(), model, history)
    lagged = mo.smooth(0, mo.smoothers.GenealogySmoother(lag=STEPS), model, history)
    assert np.allclose(genealogy.mean, lagged.mean, atol=1e-5) and np.allclose(genealogy.cov, lagged.cov, atol=1e-5)
    short = mo.smooth(0, mo.smoothers.GenealogySmoother(lag=2), model, history)
    assert np.allclose(short.mean[-3:], genealogy.mean[-3:], atol=1e-5) and not np.allclose(short.mean[0], genealogy.mean[0], atol=1e-3)
    assert genealogy.paths.shape == (STEPS, 2, 300) and lagged.paths is None


@pytest.mark.night
def test_paths_are_joint_draws(double):
    """The covariance of neighbors along drawn paths is that of the exact law; 4 000 paths, level 1e-6."""
    model = linear()
    ys = data(model)
    history = mo.run(5, mo.ParticleFilter(n=4000), model, ys, keep=mo.keep.laws)
    paths = np.asarray(mo.smooth(1, mo.smoothers.BackwardSimulationSmoother(n=4000), model, history).paths)
    whole, _ = joint(model, ys)
    for t in (2, 6):
        found = np.cov(paths[t, 0], paths[t + 1, 1])[0, 1]
        wanted = whole[2 * t, 2 * t + 3]
        spread = np.sqrt(whole[2 * t, 2 * t] * whole[2 * t + 3, 2 * t + 3])
        assert abs(found - wanted) < 5 * spread * np.sqrt(2 / 4000) + 0.05


@pytest.mark.night
def test_sums_over_time():
    """PaRIS on E[sum of a_{t-1} b_t] against the joint law; level 1e-6 with 40 seeds."""
    model = linear()
    ys = data(model)
    whole, mean = joint(model, ys)
    pairs = [whole[2 * t, 2 * t + 3] + mean[t, 0] * mean[t + 1, 1] for t in range(STEPS - 1)]
    filter = mo.smoothers.PaRIS(n=300, function=lambda before, after, u, t: jnp.array([before[0] * after[1], 1.0]), size=2)
    keys = jax.random.split(jax.random.key(8), 40)
    found = np.asarray(jax.lax.map(lambda key: mo.run(key, filter, model, jnp.asarray(ys)).state.total(), keys), float)
    assert np.allclose(found[:, 1], STEPS - 1, rtol=1e-5)
    off = found[:, 0] - sum(pairs)
    assert abs(off.mean()) < stats.t.isf(1e-6 / 2, 39) * off.std(ddof=1) / np.sqrt(40) + 0.05


@pytest.mark.optimized
def test_sums_of_a_stream_are_those_of_a_run():
    model = linear()
    ys = data(model)
    filter = mo.smoothers.PaRIS(n=50, function=lambda before, after, u, t: before * after, size=2, parents=mo.smoothers.RejectedParents())
    stream = mo.stream(3, filter, model)
    for t, y in enumerate(ys):
        if t:
            stream.predict()
        stream.update(y)
    assert np.array_equal(stream.state.total(), mo.run(3, filter, model, ys).state.total())


def test_a_second_call_does_not_trace_again():
    calls = []

    def f(x, u, t):
        calls.append(1)
        return 0.9 * x

    model = record.replace(linear(), dynamics=mo.AdditiveGaussian(f, linear().dynamics.Q))
    ys = data(linear())

    def traced_and_compiled(key):
        history = mo.run(key, mo.ExtendedKalmanFilter(), model, ys)
        mo.smooth(key, mo.smoothers.RauchTungStriebelSmoother(), model, history)
        return len(calls), smoothing._smooth._cache_size()

    count, compiled = traced_and_compiled(1)
    traced_and_compiled(2)
    # a function whose list grew, as f itself lets it, is looked at once more for each call, but not compiled
    assert 0 < count <= len(calls) <= count + 2 and smoothing._smooth._cache_size() == compiled


def test_bad_input_is_named():
    model = linear()
    ys = data(model)
    clouds = mo.run(0, PARTICLES, model, ys, keep=mo.keep.laws)
    gaussians = mo.run(0, mo.KalmanFilter(), model, ys)
    sampled = record.replace(model, dynamics=mo.Custom(sample=lambda key, x, u, t: x))
    heavy = record.replace(model, dynamics=mo.AdditiveNoise(lambda x, u, t: x, mo.StudentT([1.0, 1.0], 4.0)))
    for line, call in {
        "smooth smoother: expected a smoother": lambda: mo.smooth(0, mo.KalmanFilter(), model, gaussians),
        "smooth history: expected what mo.run gave": lambda: mo.smooth(0, mo.smoothers.GenealogySmoother(), model, clouds.law),
        "RauchTungStriebelSmoother history: expected laws of the kind Gaussian, got Cloud":
            lambda: mo.smooth(0, mo.smoothers.RauchTungStriebelSmoother(), model, clouds),
        "GenealogySmoother history: expected laws of the kind Cloud, got Gaussian":
            lambda: mo.smooth(0, mo.smoothers.GenealogySmoother(), model, gaussians),
        "RaoBlackwellizedSmoother history: expected laws of the kind MarginalCloud, got Cloud":
            lambda: mo.smooth(0, mo.smoothers.RaoBlackwellizedSmoother(n=9), model, clouds),
        "history.law: expected a run that kept it":
            lambda: mo.smooth(0, mo.smoothers.GenealogySmoother(), model, mo.run(0, PARTICLES, model, ys)),
        "TwoFilterSmoother ys: expected the measurements": lambda: mo.smooth(0, mo.smoothers.TwoFilterSmoother(n=9), model, clouds),
        "smooth ys: expected shape": lambda: mo.smooth(0, mo.smoothers.TwoFilterSmoother(n=9), model, clouds, ys[1:]),
        "smooth ys: expected the measurements of the run":
            lambda: mo.smooth(0, mo.smoothers.RauchTungStriebelSmoother(), linear([[0.2], [-0.1]]), gaussians),
        "inputs: expected arrays with the time axis first":
            lambda: mo.smooth(0, mo.smoothers.RauchTungStriebelSmoother(), model, gaussians, inputs=np.ones(3)),
        "BackwardSimulationSmoother dynamics: expected a log_prob":
            lambda: mo.smooth(0, mo.smoothers.BackwardSimulationSmoother(n=9), sampled, clouds),
        "RejectedParents dynamics: expected additive Gaussian noise":
            lambda: mo.smooth(0, mo.smoothers.BackwardSimulationSmoother(n=9, parents=mo.smoothers.RejectedParents()), heavy, clouds),
        "BackwardSimulationSmoother parents: expected a rule": lambda: mo.smoothers.BackwardSimulationSmoother(n=9, parents="exact"),
        "GenealogySmoother lag: expected": lambda: mo.smoothers.GenealogySmoother(lag=0),
        "RauchTungStriebelSmoother rule: expected a rule such as mo.gaussian.Cubature":
            lambda: mo.smoothers.RauchTungStriebelSmoother("steep"),
        "TwoFilterSmoother inflation: expected a factor of at least 1": lambda: mo.smoothers.TwoFilterSmoother(n=9, inflation=0.5),
        "PaRIS function: expected a function": lambda: mo.smoothers.PaRIS(n=9, function=3, size=1),
        "PaRIS function: expected shape": lambda: mo.run(0, mo.smoothers.PaRIS(n=9, function=lambda a, b, u, t: a, size=3), model, ys),
    }.items():  # fmt: skip
        with pytest.raises(mo.MotesError, match=line):
            call()
