"""Random linear models whose noises have any rank, with steps that take no time: every smoother against the joint law of all states."""

import jax
import numpy as np
import pytest
from scipy import stats

import motes as mo
from motes.core import linalg
from tiers import NIGHT

STEPS, RUNS = 7, 8
MOTION = mo.LinearGaussian(lambda x, u, t: u["A"], lambda x, u, t: u["Q"])
SIGHT = mo.LinearGaussian(lambda x, u, t: u["C"], lambda x, u, t: u["R"])


def particles(n, sharp):
    """A particle filter, which looks ahead where the sensor has no noise in some direction."""
    return mo.ParticleFilter(n, proposal=mo.OptimalProposal()) if sharp else mo.ParticleFilter(n)


def backward(parents=None):
    return mo.smoothers.BackwardSimulationSmoother(300, **({} if parents is None else {"parents": parents}))


SMOOTHERS = {
    "Rauch-Tung-Striebel": (mo.smoothers.RauchTungStriebelSmoother(), lambda size, sharp: mo.KalmanFilter()),
    "Rauch-Tung-Striebel, square root": (mo.smoothers.RauchTungStriebelSmoother(), lambda size, sharp: mo.SquareRootKalmanFilter()),
    "Rauch-Tung-Striebel, cubature": (
        mo.smoothers.RauchTungStriebelSmoother(mo.gaussian.Cubature()),
        lambda size, sharp: mo.CubatureKalmanFilter(),
    ),
    "genealogy": (mo.smoothers.GenealogySmoother(), lambda size, sharp: particles(900, sharp)),
    "backward, exact": (backward(), lambda size, sharp: particles(600, sharp)),
    "backward, rejected": (backward(mo.smoothers.RejectedParents(4)), lambda size, sharp: particles(600, sharp)),
    "backward, stepped": (backward(mo.smoothers.SteppedParents(8)), lambda size, sharp: particles(600, sharp)),
    "Rao-Blackwellized": (
        mo.smoothers.RaoBlackwellizedSmoother(300),
        lambda size, sharp: mo.MarginalizedParticleFilter(600, linear=tuple(range(size - 1, size))),
    ),
    "two filters": (mo.smoothers.TwoFilterSmoother(400), lambda size, sharp: particles(600, sharp)),
}
EXACT = [name for name in SMOOTHERS if name.startswith("Rauch")]


def drawn(seed):
    """One model: its law of the first state, and what its functions read at each step."""
    rng = np.random.default_rng(seed)
    size = int(rng.integers(1, 5))
    seen = int(rng.integers(1, min(size, 2) + 1))
    turned = rng.normal(size=(size, size))
    A = 0.95 * turned / np.abs(np.linalg.eigvals(turned)).max() if seed % 3 else np.eye(size) + 0.3 * np.diag(np.ones(size - 1), 1)
    noise = rng.normal(size=(size, int(rng.integers(0, size + 1)))) * 0.5
    blur = rng.normal(size=(seen, int(rng.integers(0, seen + 1))))
    # so much noise that hundreds of particles are enough
    blur *= max(1.0, 0.8 / np.linalg.svd(blur, compute_uv=False).min(initial=1.0))
    moves = rng.random(STEPS) > 0.3
    wide = rng.normal(size=(size, size))
    return mo.Gaussian(rng.normal(size=size), wide @ wide.T / size + 0.3 * np.eye(size)), {
        "A": np.where(moves[:, None, None], A, np.eye(size)),
        "Q": np.where(moves[:, None, None], noise @ noise.T, 0.0),
        "C": np.tile(rng.normal(size=(seen, size)), (STEPS, 1, 1)),
        "R": np.tile(blur @ blur.T, (STEPS, 1, 1)),
    }


def is_sharp(inputs):
    return np.linalg.matrix_rank(inputs["R"][0]) < inputs["R"].shape[1]


def exact(initial, inputs, ys):
    """Smoothed means `(t, x)` and covariances `(t, x, x)`: the joint law of all states, given all measurements at once."""
    size = len(initial.mean())
    mean = [np.asarray(initial.mean(), float)]
    cov = np.zeros((STEPS * size, STEPS * size))
    here = np.asarray(initial.cov(), float)
    for t in range(STEPS):
        if t:
            here = inputs["A"][t] @ here @ inputs["A"][t].T + inputs["Q"][t]
            mean.append(inputs["A"][t] @ mean[-1])
        across = here
        for later in range(t, STEPS):
            across = inputs["A"][later] @ across if later > t else across
            cov[later * size : (later + 1) * size, t * size : (t + 1) * size] = across
            cov[t * size : (t + 1) * size, later * size : (later + 1) * size] = across.T
    sight, blur = (np.zeros((STEPS * len(inputs["R"][0]), STEPS * width)) for width in (size, len(inputs["R"][0])))
    for t in range(STEPS):
        rows = slice(t * len(inputs["R"][0]), (t + 1) * len(inputs["R"][0]))
        sight[rows, t * size : (t + 1) * size], blur[rows, rows] = inputs["C"][t], inputs["R"][t]
    flat = np.concatenate(mean)
    gain = cov @ sight.T @ np.linalg.pinv(sight @ cov @ sight.T + blur, rcond=1e-12, hermitian=True)
    found, left = flat + gain @ (ys.reshape(-1) - sight @ flat), cov - gain @ sight @ cov
    return found.reshape(STEPS, size), np.stack([left[t * size : (t + 1) * size, t * size : (t + 1) * size] for t in range(STEPS)])


def breach(paths, inputs):
    """Largest break of the law of motion along paths `(t, x, m)`, in shares of their size."""
    worst = 0.0
    for t in range(1, STEPS):
        left = np.asarray(paths[t], float) - inputs["A"][t] @ np.asarray(paths[t - 1], float)
        values, vectors = np.linalg.eigh(inputs["Q"][t])
        worst = max(worst, np.abs(vectors[:, values < 1e-9].T @ left).max(initial=0.0))
    return worst / (1 + np.abs(paths).max())


def measured(seed):
    """Measurements that the model of a seed made."""
    initial, inputs = drawn(seed)
    return np.asarray(mo.simulate(seed, mo.StateSpaceModel(initial, MOTION, SIGHT), STEPS, inputs)[1])


def judged(name, seed):
    """Errors in standard errors and breaches of a smoother on one model, or the refusal."""
    initial, inputs = drawn(seed)
    smoother, of = SMOOTHERS[name]
    model = mo.StateSpaceModel(initial, MOTION, SIGHT)
    filter = of(len(initial.mean()), is_sharp(inputs))
    ys = measured(seed)
    mean, cov = exact(initial, inputs, ys)
    found = []
    try:
        for run in range(1 if name in EXACT else RUNS):
            history = mo.run(run, filter, model, ys, inputs, mo.keep.laws)
            found.append(mo.smooth(100 + run, smoother, model, history, ys, inputs))
    except mo.MotesError as error:
        return error
    means = np.stack([np.asarray(one.mean) for one in found])
    scale = 1 + np.abs(mean).max()
    if name in EXACT:
        off = max(np.abs(means[0] - mean).max(), np.abs(np.asarray(found[0].cov) - cov).max())
        return off / scale / 1e-5, 0.0
    # of one run; a spread of eight runs says it to a quarter, and what is known for sure has none
    spread = np.maximum(means.std(axis=0, ddof=1), 0.02 * np.sqrt(np.abs(np.diagonal(cov, axis1=1, axis2=2))) + 1e-5 * scale)
    worst = max((breach(one.paths, inputs) for one in found if one.paths is not None), default=0.0)
    return float(np.abs((means.mean(axis=0) - mean) / spread).max()), worst


@pytest.mark.parametrize("name", EXACT)
def test_exact_smoothers(name, double):
    found = {seed: judged(name, seed) for seed in (range(200) if NIGHT else (8, 12, 85))}
    assert not {seed: one for seed, one in found.items() if isinstance(one, mo.MotesError) or one[0] > 1}


@pytest.mark.night
@pytest.mark.parametrize("seed", range(200))
def test_smoothers_by_particles(seed, double):
    """A smoother may refuse a sensor without noise, and that of two filters a step without; never anything else."""
    initial, inputs = drawn(seed)
    far = exact(initial, inputs, measured(seed))[0][0] - np.asarray(initial.mean())
    # where hundreds of particles have hardly one their averages are off; what they obey is asked all the same
    found_by_few = stats.chi2.sf(far @ np.linalg.solve(np.asarray(initial.cov()), far), len(far)) > 1e-3
    still = any(np.linalg.matrix_rank(Q) < len(Q) for Q in inputs["Q"][1:])
    for name in sorted(set(SMOOTHERS) - set(EXACT)):
        if name == "Rao-Blackwellized" and len(initial.mean()) == 1:
            continue
        found = judged(name, seed)
        if isinstance(found, mo.MotesError):
            assert is_sharp(inputs) or (name == "two filters" and still), f"{name}: {found}"
            continue
        off, worst = found
        assert off < 5 or not found_by_few, f"{name}: {off:.1f} standard errors"
        assert worst < 1e-4, f"{name}: a path breaks the law of motion by {worst:.1e}"


def test_faults_would_be_found(monkeypatch, double):
    """Filtered moments are not smoothed ones; a variance that rounding left, taken for one, ruins the square root."""
    initial, inputs = drawn(8)
    model = mo.StateSpaceModel(initial, MOTION, SIGHT)
    ys = measured(8)
    assert np.abs(np.asarray(mo.run(0, mo.KalmanFilter(), model, ys, inputs).mean) - exact(initial, inputs, ys)[0]).max() > 0.01
    name = "Rauch-Tung-Striebel, square root"
    triangle = linalg.triangle
    jax.clear_caches()
    monkeypatch.setattr(linalg, "triangle", lambda v, scale=None: triangle(v))
    assert judged(name, 8)[0] > 1000
    jax.clear_caches()
