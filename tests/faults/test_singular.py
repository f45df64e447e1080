"""Covariances without full rank: densities are those on the span and zero off it, for every filter and smoother."""

import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import motes as mo
from motes.laws import density
from motes.laws.conditional import AdditiveNoise
from tiers import each

sys.path.append(str(Path(__file__).parents[1] / "contract"))
from discovery import examples, filter_classes, shares_stages

YS = np.array([[1.2], [1.0], [0.7]])


def sharp(noise=0.0):
    """The first state is measured without noise."""
    return mo.StateSpaceModel(
        mo.Gaussian([0.0, 0.0], np.eye(2)),
        mo.LinearGaussian([[0.9, 0.2], [0.0, 0.8]], np.diag([0.3, 0.2])),
        mo.LinearGaussian([[1.0, 0.0]], [[noise]]),
        ("a", "b"),
    )


def on_span(mean, factor, value):
    """Log density by the eigenvectors of the covariance that count, in NumPy."""
    rank = factor.shape[1]
    values, vectors = np.linalg.eigh(factor @ factor.T)
    values, vectors = values[len(values) - rank :], vectors[:, len(vectors) - rank :]
    return -0.5 * (np.sum(np.log(2 * np.pi * values)) + np.sum((vectors.T @ (value - mean)) ** 2 / values))


@jax.jit
def densities(law, value):
    """The same density asked for in three ways."""
    zero = jnp.zeros_like(law.center)
    moved = mo.AdditiveGaussian(lambda x, u, t: law.center + x, law.covariance)
    noisy = AdditiveNoise(lambda x, u, t: law.center + x, mo.Gaussian(zero, law.covariance))
    others = [part.log_prob(value[:, None], zero[:, None], None, 0)[0] for part in (moved, noisy)]
    return jnp.array([law.log_prob(value), *others])


def largest_error(precision):
    rng = np.random.default_rng(3)
    worst = 0.0
    for size in range(1, 5):
        for rank in range(size + 1):
            factor, mean = rng.normal(size=(size, rank)), 5 * rng.normal(size=size)
            law = mo.Gaussian(jnp.asarray(mean), jnp.asarray(factor @ factor.T))
            value = mean + factor @ rng.normal(size=rank)
            wanted = on_span(mean, factor, value) if rank else 0.0
            worst = max(worst, np.abs(densities(law, jnp.asarray(value)) - wanted).max() / (1 + abs(wanted)))
            if rank < size:
                off = value + 0.01 * np.linalg.svd(np.c_[factor, np.zeros((size, 1))])[0][:, -1]
                worst = max(worst, np.inf if (densities(law, jnp.asarray(off)) > -np.inf).any() else 0)
    return worst


def test_densities_are_those_on_the_span(precision):
    assert largest_error(precision) < (1e-3 if precision == "float32" else 1e-10)


def test_the_old_density_would_be_found(monkeypatch, double):
    """Dead pivots believed nowhere: what lies off the span is ignored."""
    believed = density.log_density
    jax.clear_caches()
    monkeypatch.setattr(density, "log_density", lambda residual, factor, seen, *_: believed(residual, factor, seen, 0.0, factor[0] < 0))
    assert largest_error("float64") == np.inf
    jax.clear_caches()


def exact(history):
    """Whether what was measured is known, and the rest as the Kalman filter knows it."""
    return np.allclose(history.mean[:, 0], YS[:, 0], atol=1e-4) and np.all(np.asarray(history.cov)[:, 0, 0] < 1e-4)


WEIGH = {"ParticleFilter", "AuxiliaryParticleFilter", "RegularizedParticleFilter", "GaussianParticleFilter", "GaussianSumParticleFilter",
         "PointMassFilter", "MeanTeleportFilter"}  # fmt: skip
APART = {"CostReferenceParticleFilter"}
"""It looks at no density."""


@pytest.mark.parametrize("name", each(sorted(set(filter_classes()) - APART), shares_stages))
def test_sensor_without_noise_is_exact_or_refused(name):
    filter = examples()[name]
    try:
        history = mo.run(0, filter, sharp(), YS)
    except mo.CollapseError as error:
        assert "no noise in some component" in str(error) and name not in WEIGH
    except mo.MotesError as error:
        inner = type(filter.filter).__name__ if isinstance(filter, mo.filters.Wrapper) else name
        assert str(error).startswith(f"{inner} sensor: expected noise in every component") and "OptimalProposal" in str(error)
    else:
        assert name not in WEIGH and exact(history)


def test_a_small_variance_that_is_left_is_no_rounding():
    """The second state is known from the first to three thousandths, and from a sensor of its own; in single precision."""
    model = mo.StateSpaceModel(
        mo.Gaussian([0.0, 0.0], [[1.0, np.sqrt(1 - 1e-5)], [np.sqrt(1 - 1e-5), 1.0]]),
        mo.LinearGaussian(np.eye(2), np.zeros((2, 2))),
        mo.LinearGaussian(np.eye(2), np.diag([0.0, 1e-5])),
    )
    for ys, left in (([[0.5, np.nan]], 1e-5), ([[0.5, 0.5]], 5e-6)):
        cov = np.asarray(mo.run(0, mo.KalmanFilter(), model, np.array(ys)).cov)[0]
        assert cov[0, 0] == 0 and cov[1, 1] == pytest.approx(left, rel=0.1)


def test_ignoring_the_sensor_would_be_found():
    assert not exact(mo.run(0, mo.KalmanFilter(), sharp(), np.full_like(YS, np.nan)))


@pytest.mark.parametrize("filter", [mo.ParticleFilter, mo.AuxiliaryParticleFilter])
def test_the_cure_works(filter):
    """From the first measurement on: 4 000 particles, half of them effective at least."""
    wanted = mo.run(0, mo.KalmanFilter(), sharp(), YS)
    found = mo.run(0, filter(4000, proposal=mo.OptimalProposal()), sharp(), YS)
    assert exact(found) and np.abs(np.asarray(found.mean - wanted.mean)).max() < 0.1
    assert abs(float(found.log_likelihood - wanted.log_likelihood)) < 0.1


def test_noise_of_a_function_is_judged_by_the_weights():
    model = sharp()
    model = mo.StateSpaceModel(model.initial, model.dynamics, mo.LinearGaussian([[1.0, 0.0]], lambda x, u, t: jnp.zeros((1, 1))))
    with pytest.raises(mo.CollapseError, match="no noise in some component"):
        mo.run(0, mo.ParticleFilter(100), model, YS)


def test_steps_that_no_element_can_hold_are_refused():
    model = sharp()
    model = mo.StateSpaceModel(model.initial, mo.LinearGaussian(np.eye(2), np.diag([0.0, 0.2])), model.sensor)
    with pytest.raises(mo.MotesError, match="run_in_parallel model: expected noise .* none at step 1"):
        mo.filters.run_in_parallel(model, YS)


def driven(A, noise):
    """Discrete white-noise acceleration: every state has noise, but of rank one; the step of input 0 takes no time."""
    A = np.array(A)  # an array that JAX has met in float64 it takes for float64 in float32, too
    g = np.array([[0.5], [1.0]])
    dynamics = mo.LinearGaussian(lambda x, u, t: jnp.where(u > 0, A, np.eye(2)), lambda x, u, t: jnp.where(u > 0, noise * g @ g.T, 0))
    return mo.StateSpaceModel(mo.Gaussian([0.0, 1.0], np.diag([1.0, 0.25])), dynamics, mo.LinearGaussian([[1.0, 0.0]], [[0.25]]))


STEPS = np.array([1.0, 1, 0, 1, 1, 0, 1], np.float32)[:, None][:, 0]
A = np.array([[1.0, 1.0], [0.0, 1.0]])
SMOOTHERS = {
    "genealogy": (mo.smoothers.GenealogySmoother(), mo.ParticleFilter(1500)),
    "exact": (mo.smoothers.BackwardSimulationSmoother(600), mo.ParticleFilter(1500)),
    "rejected": (mo.smoothers.BackwardSimulationSmoother(600, parents=mo.smoothers.RejectedParents(4)), mo.ParticleFilter(1500)),
    "stepped": (mo.smoothers.BackwardSimulationSmoother(600, parents=mo.smoothers.SteppedParents(4)), mo.ParticleFilter(1500)),
    "Rao-Blackwellized": (mo.smoothers.RaoBlackwellizedSmoother(400), mo.MarginalizedParticleFilter(800, linear=(1,))),
}


def breach(paths):
    """Largest break of the law of motion along paths `(t, 2, m)`."""
    before, after = np.asarray(paths)[:-1], np.asarray(paths)[1:]
    moved = after - np.where(STEPS[1:, None, None] > 0, np.einsum("ij,tjm->tim", A, before), before)
    free = np.where(STEPS[1:, None] > 0, moved[:, 0] - moved[:, 1] / 2, np.abs(moved).max(axis=1))
    return np.abs(free).max()


@pytest.mark.parametrize("name", each(list(SMOOTHERS), {"rejected", "stepped"}))
def test_paths_obey_the_law_of_motion(name, double):
    """A genealogy of some hundred particles at the first step: means within a quarter of a standard deviation of the exact ones."""
    model, (smoother, filter) = driven(A, 0.09), SMOOTHERS[name]
    ys = np.asarray(mo.simulate(5, model, len(STEPS), STEPS)[1])
    wanted = mo.smooth(0, mo.smoothers.RauchTungStriebelSmoother(), model, mo.run(0, mo.KalmanFilter(), model, ys, STEPS), inputs=STEPS)
    found = mo.smooth(1, smoother, model, mo.run(2, filter, model, ys, STEPS, mo.keep.laws), inputs=STEPS)
    deviations = np.sqrt(np.asarray(wanted.cov)[:, [0, 1], [0, 1]])
    assert breach(found.paths) < 1e-4
    assert np.all(np.abs(np.asarray(found.mean - wanted.mean)) < 0.25 * deviations)
    assert breach(np.asarray(found.paths) + np.random.default_rng(0).normal(size=found.paths.shape) * 1e-3) > 1e-4


def test_what_cannot_be_smoothed_is_refused():
    model = driven(A, 0.09)
    ys = np.asarray(mo.simulate(5, model, len(STEPS), STEPS)[1])
    history = mo.run(2, mo.ParticleFilter(100), model, ys, STEPS, mo.keep.laws)
    with pytest.raises(mo.MotesError, match="TwoFilterSmoother history: expected dynamics with noise .* BackwardSimulationSmoother"):
        mo.smooth(0, mo.smoothers.TwoFilterSmoother(100), model, history, ys, STEPS)
    moved = mo.run(2, mo.EnsembleKalmanFilter(100), model, ys, STEPS, mo.keep.laws)
    with pytest.raises(mo.MotesError, match="BackwardSimulationSmoother history: expected states that the dynamics alone led to"):
        mo.smooth(0, mo.smoothers.BackwardSimulationSmoother(100), model, moved, ys, STEPS)


def test_a_grid_stands_still_or_is_refused():
    grid = mo.PointMassFilter((-3.0, -3.0), (3.0, 3.0), (15, 15))
    model = driven(A, 0.09)
    with pytest.raises(mo.CollapseError):
        mo.run(0, grid, model, YS, np.ones(3, np.float32))
    known = mo.StateSpaceModel(model.initial, mo.LinearGaussian(A, [[0.25, 0.5], [0.5, 1.0]]), model.sensor)
    with pytest.raises(mo.MotesError, match="PointMassFilter dynamics: expected noise in every direction"):
        mo.run(0, grid, known, YS)
    fixed = mo.StateSpaceModel(mo.Gaussian([0.0], [[1.0]]), mo.LinearGaussian([[1.0]], [[0.0]]), mo.LinearGaussian([[1.0]], [[0.5]]))
    found = mo.run(0, mo.PointMassFilter((-5.0,), (5.0,), (200,)), fixed, YS)
    wanted = mo.run(0, mo.KalmanFilter(), fixed, YS)
    assert np.allclose(found.mean, wanted.mean, atol=1e-3)
