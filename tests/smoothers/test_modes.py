"""Modes and states of jump-Markov systems given all measurements, against all paths of modes, each smoothed exactly."""

from functools import cache
from itertools import product

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

import motes as mo
from tiers import each

STEPS = 6
START = np.array([0.6, 0.4])
A = np.array([[[0.9, 0.3], [-0.1, 0.7]], [[0.3, 0.0], [0.0, -0.8]]])
H, R = np.array([[[1.0, 0.4]], [[1.0, -0.3]]]), np.array([0.5, 1.0])
NOISES = np.array([[[0.3, 0.1], [0.1, 0.2]], np.diag([1.5, 0.1])])
SINGULAR = np.array([np.outer([0.5, 0.4], [0.5, 0.4]), np.diag([1.5, 0.0])])
SHARES = {"stay": np.array([0.5, 0.9, 0.7, 0.6, 0.8, 0.3])}
"""Inputs: the probability of staying in the first mode."""


def chain(u, t):
    """Transition probabilities depend on an input and on the step."""
    stay = u["stay"]
    return jnp.stack([jnp.stack([stay, 1 - stay]), jnp.where(t == 4, jnp.array([0.1, 0.9]), jnp.array([0.3, 0.7]))])


CHAINS = [np.asarray(chain({"stay": SHARES["stay"][t]}, t)) for t in range(STEPS)]


def system(Q=NOISES):
    parts = [mo.StateSpaceModel(mo.Gaussian([1.0, -0.5], np.eye(2)), mo.LinearGaussian(a, q), mo.LinearGaussian(h, [[r]]), ("a", "b"))
             for a, q, h, r in zip(A, Q, H, R, strict=True)]  # fmt: skip
    return mo.JumpMarkovModel(START, chain, parts)


YS = np.array([[0.6], [2.1], [np.nan], [-1.9], [0.8], [-0.2]])


def of_path(path, Q):
    """Log of the probability of modes and measurements, smoothed means `(t, x)` and covariances `(t, x, x)`, by one joint Gaussian."""
    mean, cov = np.zeros((STEPS, 2)), np.zeros((STEPS, 2, STEPS, 2))
    mean[0], cov[0, :, 0] = [1.0, -0.5], np.eye(2)
    total = np.log(START[path[0]])
    for t in range(1, STEPS):
        a = A[path[t]]
        total += np.log(CHAINS[t][path[t - 1], path[t]])
        mean[t], cov[t] = a @ mean[t - 1], np.einsum("ij,jtk->itk", a, cov[t - 1])
        cov[:, :, t] = np.moveaxis(cov[t], 0, 2)
        cov[t, :, t] = a @ cov[t - 1, :, t - 1] @ a.T + Q[path[t]]
    seen = [t for t in range(STEPS) if not np.isnan(YS[t, 0])]
    C = np.zeros((len(seen), STEPS, 2))
    for k, t in enumerate(seen):
        C[k, t] = H[path[t], 0]
    C, P = C.reshape(len(seen), -1), cov.reshape(2 * STEPS, 2 * STEPS)
    S = C @ P @ C.T + np.diag(R[np.array(path)[seen]])
    off = YS[seen, 0] - C @ mean.ravel()
    gain = np.linalg.solve(S, C @ P).T
    total += stats.multivariate_normal.logpdf(off, cov=S)
    after = (P - gain @ C @ P).reshape(STEPS, 2, STEPS, 2)
    return total, mean + (gain @ off).reshape(STEPS, 2), np.stack([after[t, :, t] for t in range(STEPS)])


@cache
def enumerated(singular=False):
    """Smoothed probabilities of the modes `(t, m)`, means `(t, x)` and second moments `(t, x, x)`."""
    Q = SINGULAR if singular else NOISES
    paths = list(product(range(2), repeat=STEPS))
    totals, means, covs = (np.array(each) for each in zip(*(of_path(path, Q) for path in paths), strict=True))
    weights = np.exp(totals - totals.max())
    weights /= weights.sum()
    modes = np.stack([np.bincount(step, weights, 2) for step in np.array(paths).T])
    second = covs + means[..., :, None] * means[..., None, :]
    return modes, np.tensordot(weights, means, 1), np.tensordot(weights, second, 1)


def errors(smoother, filter, model, wanted, seeds=16):
    """Errors of probabilities of the second mode, of means and of second moments, `(seed, t, 6)`, of runs with other keys."""
    def one(key):
        history = mo.run(key, filter, model, jnp.asarray(YS), SHARES, keep=mo.keep.laws)
        found = mo.smooth(jax.random.fold_in(key, 7), smoother, model, history, inputs=SHARES)
        second = found.cov + found.mean[:, :, None] * found.mean[:, None]
        return found.mode_probabilities, found.mean[:, :2], second[:, :2, :2], found.paths

    *moments, paths = jax.jit(jax.vmap(one))(jax.random.split(jax.random.key(5), seeds))
    off = [np.asarray(found, float) - exact for found, exact in zip(moments, wanted, strict=True)]
    both = [off[0][..., 1:], off[1], off[2].reshape(seeds, STEPS, 4)[..., [0, 1, 3]]]
    return np.concatenate(both, axis=-1), np.asarray(paths)


def unbiased(off, allowed):
    """Whether no average error is beyond its Monte Carlo error at level 1e-6 for all of them together, and what is allowed for bias."""
    seeds, figures = off.shape[0], off[0].size
    return np.all(np.abs(off.mean(0)) < stats.t.isf(1e-6 / figures / 2, seeds - 1) * off.std(0, ddof=1) / np.sqrt(seeds) + allowed)


ALL = mo.JumpMarkovFilter(n=2**STEPS)
CASES = {
    # nothing is left to chance in the filter: trajectories are draws from the exact law
    "all paths": (mo.smoothers.MixtureSmoother(n=200), ALL, system(), False, 1e-4),
    "singular noise": (mo.smoothers.MixtureSmoother(n=200), ALL, system(SINGULAR), True, 1e-4),
    "drawn": (mo.smoothers.MixtureSmoother(n=100), mo.JumpMarkovFilter(n=100, sampled=("a",)), system(), False, 0.02),
    "joined": (mo.smoothers.BackwardSimulationSmoother(n=100), mo.ParticleFilter(n=400), system().as_state_space(), False, 0.02),
}


@pytest.mark.parametrize("name", each(list(CASES), {"singular noise", "drawn", "joined"}))
def test_modes_and_states_are_those_of_all_paths(name):
    """Missing measurements, a chain that depends on inputs and time; level 1e-6 per case, with the allowance of its line for 1 / n."""
    smoother, filter, model, singular, allowed = CASES[name]
    off, paths = errors(smoother, filter, model, enumerated(singular))
    assert unbiased(off, allowed)
    assert off.std(0).max() < 0.4 and np.isfinite(paths).all()
    # filtered means are far off, so that a smoother which gave them would fail
    filtered = np.asarray(mo.run(0, ALL, system(SINGULAR if singular else NOISES), YS, SHARES).mean)
    assert np.abs(filtered - enumerated(singular)[1]).max() > 0.3


def test_interacting_models_and_moments_kept_with_them_are_near():
    """What mixing costs the filter is all that the smoother lacks; the last law is the filter's own."""
    history = mo.run(0, mo.InteractingMultipleModel(), system(), YS, SHARES, keep=mo.keep.laws)
    found = mo.smooth(1, mo.smoothers.MixtureSmoother(n=2000), system(), history, inputs=SHARES)
    modes, mean, _ = enumerated()
    assert np.abs(found.mode_probabilities - modes).max() < 0.05 and np.abs(found.mean - mean).max() < 0.1
    assert np.allclose(found.mean[-1], history.mean[-1], atol=1e-6) and np.allclose(found.cov[-1], history.cov[-1], atol=1e-6)
    assert found.modes.shape == (STEPS, 2000) and found.paths.shape == (STEPS, 2, 2000)
    assert np.allclose([np.bincount(row, minlength=2) / 2000 for row in np.asarray(found.modes)], found.mode_probabilities, atol=0.06)


@pytest.mark.parametrize("filter", [mo.ParticleFilter(n=4_000), mo.PointMassFilter((-7.0, 0.0), (7.0, 1.0), (200, 2))],
                         ids=["particles", "grid"])  # fmt: skip
def test_clouds_of_a_joined_model_keep_modes(filter):
    """Probabilities of the modes of one state are those of the Rao-Blackwellized filter, which sums over all paths here."""
    parts = [mo.StateSpaceModel(mo.Gaussian([0.5], [[1.0]]), mo.LinearGaussian([[a]], [[q]]), mo.LinearGaussian([[1.0]], [[0.5]]))
             for a, q in ((0.9, 0.1), (-0.7, 1.5))]  # fmt: skip
    model = mo.JumpMarkovModel(START, chain, parts)
    wanted = mo.run(0, mo.JumpMarkovFilter(n=64), model, YS, SHARES, keep=mo.keep.modes).mode_probabilities
    history = mo.run(0, filter, model.as_state_space(), YS, SHARES, keep=mo.keep.modes)
    assert np.allclose(history.mode_probabilities, wanted, atol=0.05) and history.mean.shape == (STEPS, 2)
    assert np.allclose(mo.keep.modes(history.state, 2)["mode_probabilities"], history.mode_probabilities[-1], atol=1e-6)
