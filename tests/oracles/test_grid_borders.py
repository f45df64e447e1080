"""What leaves the grid of a point-mass filter is counted, told, and taken into the likelihood: against the Kalman filter."""

import warnings

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.stats import norm

import motes as mo

YS = np.array(mo.simulate(3, mo.StateSpaceModel(mo.Gaussian([0.0], [[1.0]]), mo.LinearGaussian([[0.95]], [[0.3]]),
                                                mo.LinearGaussian([[1.0]], [[0.5]])), 30)[1])  # fmt: skip
YS[5:8] = np.nan


def walk(noise=0.3):
    return mo.StateSpaceModel(mo.Gaussian([0.0], [[1.0]]), mo.LinearGaussian([[0.95]], [[noise]]), mo.LinearGaussian([[1.0]], [[0.5]]))


def grid(end):
    return mo.PointMassFilter(-end, end, int(30 * end) + 1)


def quietly(*arguments, **options):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        return mo.run(*arguments, **options)


def test_what_leaves_is_counted_and_taken_into_the_likelihood(double):
    """On a grid of 4 the likelihood is right to 5e-5, renormalized in silence it is 5e-3 too large; gaps in the data included."""
    exact = float(mo.run(0, mo.KalmanFilter(), walk(), YS).log_likelihood)
    with pytest.warns(mo.MotesWarning, match=r"PointMassFilter: 0\.\d+ of the probability left the grid, .* at step \d+\. Use a wider"):
        found = mo.run(0, grid(4.0), walk(), YS)
    silent = float(found.log_likelihood) - float(jnp.sum(jnp.log1p(-found.info.lost)))
    assert abs(float(found.log_likelihood) - exact) < 5e-5 < 1e-3 < silent - exact
    assert found.info.lost.shape == (30,) and int(np.argmax(found.info.lost)) in range(5, 9)
    # the initial law: what a normal law has beyond the ends of the outermost cells
    assert abs(float(found.info.lost[0]) - 2 * norm.sf(4 + 1 / 30)) < 1e-6
    told = [finding for finding in mo.diagnose(found).findings if finding.name == "narrow grid"]
    assert len(told) == 1 and not told[0].serious
    stream = mo.stream(0, grid(4.0), walk())
    for t, y in enumerate(YS[:9]):
        if t:
            stream.predict()
        stream.update(y)
        assert abs(float(stream.info.lost) - float(found.info.lost[t])) < 1e-12


def test_a_wide_grid_says_nothing():
    found = quietly(0, grid(8.0), walk(), YS)
    assert not np.asarray(found.info.lost).any()
    assert float(quietly(0, mo.KalmanFilter(), walk(), YS).info.lost.max()) == 0


def test_more_than_a_hundredth_at_one_step_is_serious():
    with pytest.warns(mo.MotesWarning, match="left the grid"):
        found = mo.run(0, grid(2.5), walk(), YS)
    assert any(finding.name == "narrow grid" and finding.serious for finding in mo.diagnose(found).findings)


def test_an_angle_leaves_no_grid_of_one_turn():
    count = 60
    model = mo.StateSpaceModel(mo.Gaussian([3.0], [[0.3]]), mo.AdditiveGaussian(lambda x, u, t: x + 0.5, [[0.1]], angles=(0,)),
                               mo.AdditiveGaussian(lambda x, u, t: x, [[0.4]], angles=(0,)))  # fmt: skip
    filter = mo.PointMassFilter(-np.pi, np.pi * (1 - 2 / count), count)
    assert not np.asarray(quietly(0, filter, model, np.arange(3.0, 9.0, 0.5)[:, None]).info.lost).any()


def test_the_number_of_a_mode_has_probabilities(double):
    parts = [walk(0.3), walk(0.6)]
    model = mo.JumpMarkovModel([0.5, 0.5], [[0.8, 0.2], [0.3, 0.7]], parts)
    for end, lost in ((9.0, False), (4.0, True)):
        found = mo.run(0, mo.PointMassFilter((-end, 0.0), (end, 1.0), (int(20 * end) + 1, 2)), model.as_state_space(), YS[:9])
        assert bool(np.asarray(found.info.lost)[1:].max() > 1e-6) is lost and float(found.info.lost.max()) < 0.1
    wanted = mo.run(0, mo.JumpMarkovFilter(n=2**9), model, YS[:9])
    assert abs(float(found.log_likelihood) - float(wanted.log_likelihood)) < 0.003
    with pytest.raises(mo.MotesError, match="lower, upper, nodes: expected 0, 1 and 2 for the mode"):
        mo.run(0, mo.PointMassFilter((-3.0, 0.0), (3.0, 1.0), (50, 3)), model.as_state_space(), YS)


def test_a_step_without_noise_loses_nothing(double):
    """Nodes that stay have probabilities of one, not densities; modes some of which stay are refused where a collapse shows it."""
    still = mo.StateSpaceModel(walk().initial, mo.LinearGaussian([[1.0]], [[0.0]]), walk().sensor)
    found = mo.run(0, grid(8.0), still, YS[:5])
    assert float(found.info.lost.max()) < 1e-12
    mixed = mo.JumpMarkovModel([0.5, 0.5], [[0.8, 0.2], [0.3, 0.7]], [walk(), still]).as_state_space()
    with pytest.raises(mo.CollapseError):
        mo.run(0, mo.PointMassFilter((-5.0, 0.0), (5.0, 1.0), (99, 2)), mixed, YS[:5])
