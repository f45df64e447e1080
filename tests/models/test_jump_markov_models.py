"""Jump-Markov models: what is drawn from them, equal ones share compiled code, and on-line use."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import motes as mo
from motes.filters import run as running


def model(bias=1.5):
    """Transitions depend on the inputs, one sensor is nonlinear, and initial laws differ."""
    def transition(u, t):
        return jnp.stack([jnp.stack([1 - u, u]), jnp.array([0.3, 0.7])])

    still = mo.StateSpaceModel(mo.Gaussian([0.0], [[0.01]]), mo.LinearGaussian([[0.5]], [[0.04]]), mo.LinearGaussian([[1.0]], [[0.01]]))
    away = mo.StateSpaceModel(mo.Gaussian([5.0], [[0.01]]), mo.AdditiveGaussian(lambda x, u, t: 0.5 * x + bias, [[0.01]]),
                              mo.AdditiveGaussian(lambda x, u, t: x**2, [[0.25]]))  # fmt: skip
    return mo.JumpMarkovModel([0.8, 0.2], transition, [still, away], ("level",))


def test_draws_follow_the_chain_the_dynamics_and_the_sensors():
    """Frequencies of transitions for each input, and moments of the noises of each mode, at a level of 1e-6."""
    u = np.where(np.arange(20_000) % 2, 0.9, 0.2)
    xs, ys = map(np.array, mo.simulate(2, model(), len(u), u))
    assert xs.shape == (len(u), 2) and ys.shape == (len(u), 1)
    before, after = xs[:-1, 1], xs[1:, 1]
    for mode, given, chance in ((0, 0.2, 0.2), (0, 0.9, 0.9), (1, 0.2, 0.7), (1, 0.9, 0.7)):
        some = (before == mode) & np.isclose(u[1:], given)
        assert abs(after[some].mean() - chance) < 5 * np.sqrt(chance * (1 - chance) / some.sum())
    for mode, push, variance, spread in ((0, 0.0, 0.04, 0.01), (1, 1.5, 0.01, 0.25)):
        own = after == mode
        noise = (xs[1:, 0] - 0.5 * xs[:-1, 0] - push)[own]
        off = (ys[1:, 0] - np.where(mode, xs[1:, 0] ** 2, xs[1:, 0]))[own]
        for sample, wanted in ((noise, variance), (off, spread)):
            assert abs(sample.mean()) < 5 * np.sqrt(wanted / own.sum())
            assert abs(sample.var() / wanted - 1) < 5 * np.sqrt(2 / own.sum())


def test_the_initial_law_of_the_joined_model():
    initial = model().as_state_space().initial
    points = np.asarray(initial.sample(jax.random.key(0), 20_000))
    assert np.allclose(points.mean(axis=1), initial.mean(), atol=0.08) and np.allclose(np.cov(points), initial.cov(), atol=0.12)
    assert np.allclose(initial.mean(), [1.0, 0.2], atol=1e-6)
    wanted = np.log(0.2) - 0.5 * np.log(2 * np.pi * 0.01) - 0.5
    assert np.allclose(initial.log_prob(jnp.array([5.1, 1.0])), wanted, atol=1e-4)


@pytest.mark.night
def test_equal_models_share_compiled_code_and_a_stream_draws_the_same():
    u, ys = np.full(6, 0.3), np.array([[0.1], [0.2], [9.0], [7.0], [np.nan], [0.4]])
    filter = mo.JumpMarkovFilter(n=8)
    history = mo.run(1, filter, model(), ys, u, keep=mo.keep.modes)
    compiled = running._run._cache_size()
    again = mo.run(1, filter, model(), ys, u, keep=mo.keep.modes)
    assert running._run._cache_size() == compiled and np.array_equal(history.mean, again.mean)
    stream = mo.stream(1, filter, model(), u[0])
    for t, y in enumerate(ys):
        if t:
            stream.predict(u[t])
        stream.update(y)
    assert np.array_equal(stream.mean, history.mean[-1])
    assert np.allclose(stream.state.mode_probabilities(), history.mode_probabilities[-1], atol=1e-6)
    joined = mo.ParticleFilter(n=50)
    mo.run(1, joined, model().as_state_space(), ys, u)
    compiled = running._run._cache_size()
    mo.run(2, joined, model().as_state_space(), ys, u)
    assert running._run._cache_size() == compiled
    mo.run(2, joined, model(bias=2.0).as_state_space(), ys, u)
    assert running._run._cache_size() == compiled + 1
