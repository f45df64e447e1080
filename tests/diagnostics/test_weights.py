"""Tails of weights, ancestors, and the variance of a log likelihood from one run."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

import motes as mo


def model():
    return mo.StateSpaceModel(mo.Gaussian([0.3], [[1.0]]), mo.LinearGaussian([[0.8]], [[1.0]]), mo.LinearGaussian([[1.0]], [[3.0]]))


@pytest.mark.parametrize("k", [-0.3, 0.2, 0.5, 0.9])
def test_pareto_k_of_known_tails(k, precision):
    """Weights from generalized Pareto laws: mean of 50 fits to 4 000 weights within 4.9 standard errors of k; tails are drawn to 0.5."""
    draws = stats.genpareto(k).rvs((50, 4000), random_state=3)
    found = np.asarray(jax.vmap(mo.diagnostics.pareto_k)(jnp.log(jnp.asarray(draws)) + 300))
    count = 3 * np.sqrt(4000)
    drawn = (count * k + 5) / (count + 10)
    assert abs(found.mean() - drawn) < 4.9 * found.std(ddof=1) / np.sqrt(50) + 0.04


def test_pareto_k_of_equal_and_of_few_weights():
    assert float(mo.diagnostics.pareto_k(jnp.zeros(200))) == -np.inf
    assert np.isnan(float(mo.diagnostics.pareto_k(jnp.zeros(20))))


def test_ancestors_by_hand():
    """Five particles, three steps, parents written down."""
    ys = np.zeros((3, 1))
    history = mo.run(0, mo.ParticleFilter(n=5), model(), ys, keep=mo.keep.laws)
    parents = jnp.array([[0, 1, 2, 3, 4], [0, 0, 2, 2, 4], [1, 1, 2, 3, 3]], jnp.int32)
    laws = mo.laws.Cloud(history.law.particles, history.law.log_weights, parents)
    history = mo.History({**history.kept, "law": laws}, history.info, history.last, history.start, history.names, "")
    assert mo.diagnostics.first_ancestors(history).tolist() == [0, 0, 2, 2, 2]
    assert mo.diagnostics.surviving_ancestors(history, 1).tolist() == [3, 3]
    assert mo.diagnostics.surviving_ancestors(history, 2).tolist() == [2]


@pytest.mark.night
def test_variance_of_the_log_likelihood_from_one_run():
    """Its mean over 60 runs is the variance over 400 runs, within 4.9 standard errors of both (multinomial, every step)."""
    _, ys = mo.simulate(3, model(), 12)
    filter = mo.ParticleFilter(n=1000, scheme=mo.resampling.Multinomial(), policy=mo.resampling.Always())
    keys = jax.random.split(jax.random.key(1), 400)
    many = np.asarray(jax.vmap(lambda key: mo.run(key, filter, model(), ys).log_likelihood)(keys), float)
    estimates = [mo.diagnostics.log_likelihood_variance(mo.run(key, filter, model(), ys, keep=mo.keep.laws)) for key in range(60)]
    assert all(estimate.first_ancestors > 20 for estimate in estimates)
    found = [estimate.variance for estimate in estimates]
    error = np.hypot(np.std(found, ddof=1) / np.sqrt(60), many.var(ddof=1) * np.sqrt(2 / 399))
    assert abs(np.mean(found) - many.var(ddof=1)) < 4.9 * error


def test_bad_input_is_named():
    ys = np.zeros((4, 1))
    moments = mo.run(0, mo.ParticleFilter(n=5), model(), ys)
    kalman = mo.run(0, mo.KalmanFilter(), model(), ys, keep=mo.keep.laws)
    laws = mo.run(0, mo.ParticleFilter(n=5), model(), ys, keep=mo.keep.laws)
    later = mo.run(0, mo.ParticleFilter(n=5), model(), ys, keep=mo.keep.laws, after=laws)
    for line, call in {
        "history.law: expected a run that kept it": lambda: mo.diagnostics.first_ancestors(moments),
        "first_ancestors history: expected laws with ancestors, got Gaussian": lambda: mo.diagnostics.first_ancestors(kalman),
        "surviving_ancestors lag: expected less than the 4 steps": lambda: mo.diagnostics.surviving_ancestors(laws, 4),
        "log_likelihood_variance history: expected a run from step 0, got one from step 4": lambda: mo.diagnostics.log_likelihood_variance(
            later
        ),
        "log_likelihood_variance history: expected a filter with scheme=Multinomial": lambda: mo.diagnostics.log_likelihood_variance(laws),
    }.items():
        with pytest.raises(mo.MotesError, match=line):
            call()
