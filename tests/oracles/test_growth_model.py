"""The univariate growth model, bimodal and strongly nonlinear, against the exact filter on a grid."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import motes as mo
from motes.core.record import replace
from motes.models.textbook import growth
from tiers import each


@pytest.mark.night
def test_particle_filter_is_within_three_percent_of_the_exact_filter():
    model = growth()
    exact = mo.PointMassFilter(-45.0, 45.0, 1200)
    errors = {"exact": [], "particle": []}
    for seed in range(6):
        xs, ys = mo.simulate(seed, model, 150)
        errors["exact"].append(np.asarray(mo.run(0, exact, model, ys).mean - xs))
        errors["particle"].append(np.asarray(mo.run(100 + seed, mo.ParticleFilter(n=1000), model, ys).mean - xs))
    rmse = {name: np.sqrt(np.mean(np.square(e))) for name, e in errors.items()}
    assert rmse["particle"] < 1.03 * rmse["exact"]
    assert rmse["particle"] > 0.97 * rmse["exact"]


@pytest.mark.night
def test_guided_filter_agrees_with_the_exact_one(double):
    """A proposal that is not the prior: the weights must hold all three densities."""
    model = mo.StateSpaceModel(
        mo.Gaussian([0.0], [[1.0]]),
        mo.AdditiveGaussian(lambda x, u, t: jnp.sin(2 * x) + 0.5 * x, [[0.5]]),
        mo.AdditiveNoise(lambda x, u, t: x + 0.1 * x**3, mo.StudentT([0.4], 4.0)),
    )
    ys = mo.simulate(2, model, 25)[1]
    exact = mo.run(0, mo.PointMassFilter(-6.0, 6.0, 900), model, ys)

    def toward(x, uy, t):
        return 0.5 * (jnp.sin(2 * x) + 0.5 * x) + 0.35 * jnp.clip(uy[1], -3, 3)

    guided = mo.ParticleFilter(n=20_000, proposal=mo.AdditiveGaussian(toward, [[0.6]]))
    history = mo.run(1, guided, model, ys)
    assert np.abs(history.mean - exact.mean).max() < 0.03
    assert abs(float(history.log_likelihood - exact.log_likelihood)) < 0.15
    totals = jax.vmap(lambda key: mo.run(key, mo.ParticleFilter(n=2000, proposal=guided.proposal), model, ys).log_likelihood)(
        jax.random.split(jax.random.key(3), 100)
    )
    ratio = np.exp(np.asarray(totals) - float(exact.log_likelihood))
    assert abs(ratio.mean() - 1) < 4 * ratio.std() / 10


@pytest.mark.night
def test_point_mass_filter_equals_the_kalman_filter_on_linear_models(double):
    model = mo.StateSpaceModel(
        mo.Gaussian([1.0, 0.0], [[1.0, 0.2], [0.2, 0.8]]),
        mo.LinearGaussian([[0.9, 0.3], [-0.2, 0.8]], [[0.5, 0.1], [0.1, 0.6]]),
        mo.LinearGaussian([[1.0, 0.5]], [[0.4]]),
    )
    ys = mo.simulate(0, model, 6)[1]
    exact = mo.run(0, mo.KalmanFilter(), model, ys)
    grid = mo.run(0, mo.PointMassFilter((-7, -7), (7, 7), (71, 71)), model, ys)
    assert np.abs(grid.mean - exact.mean).max() < 1e-4
    assert np.abs(grid.cov - exact.cov).max() < 1e-4


@pytest.mark.parametrize("slope", each(["sigma", "jacobian"], {"sigma"}))
def test_kernels_stay_on_the_growth_model(slope):
    """Slopes of 25 at a center let covariances overflow (log likelihood -527 for -160, or NaN); planes and early splits keep near the grid.

    Six runs of 40 steps: each within 0.25 nats a step of the exact likelihood, those split every ten steps only finite, and told of.
    """
    model = growth()
    ys = np.stack([np.asarray(mo.simulate(seed, model, 40)[1]) for seed in range(6)])
    filter, grid = mo.KalmanParticleKernelFilter(n=200, slope=slope), mo.PointMassFilter(-45.0, 45.0, 300)
    told = [jax.jit(jax.vmap(lambda y, f=f: (lambda h: (h.log_likelihood, h.mean))(mo.run(1, f, model, y))))(ys) for f in (filter, grid)]
    (found, means), (exact, wanted) = (tuple(map(np.asarray, each)) for each in told)
    off = (exact - found) / 40
    assert np.isfinite(means).all() and off.max() < 0.25
    assert np.sqrt(np.mean((means - wanted) ** 2)) < 4


@pytest.mark.night
def test_kernels_that_are_left_to_grow_are_told_of():
    ys = mo.simulate(9, growth(), 60)[1]
    with pytest.warns(mo.MotesWarning, match="alarm"):
        seldom = mo.run(1, mo.KalmanParticleKernelFilter(n=200, every=10), growth(), ys)
    assert np.isfinite(seldom.mean).all() and np.isfinite(seldom.cov).all() and not mo.diagnose(seldom).trusted
    # estimates that are no numbers are told of whatever else was found
    lost = replace(seldom, kept={**seldom.kept, "mean": seldom.mean.at[17:].set(np.nan)})
    assert "43 steps (first step 17) the estimate is not a number" in str(mo.diagnose(lost)) and not mo.diagnose(lost).trusted
