"""What a run says unasked, in one line and once: starvation at any step, the first included, collapse by policy, numbers too coarse."""

import sys
import warnings
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import motes as mo
from motes.filters import notices

sys.path.append(str(Path(__file__).parents[1] / "contract"))
import discovery

from tiers import each

MARKS = jnp.array([[10.0, 0], [0, 10], [-10, 0], [0, -10]])
RANGES = mo.AdditiveGaussian(lambda x, u, t: jnp.hypot(MARKS[:, 0] - x[0], MARKS[:, 1] - x[1]), 1e-4 * np.eye(4))
SHARP = mo.StateSpaceModel(mo.Gaussian([0.0, 0.0], np.eye(2)), mo.LinearGaussian(np.eye(2), 0.1 * np.eye(2)), RANGES, ("a", "b"))
STARVING = [name for name, cls in discovery.filter_classes().items() if cls.starves and name != "MarginalizedParticleFilter"]


def warned(call):
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always")
        result = call()
    return result, [str(one.message) for one in found if issubclass(one.category, mo.MotesWarning)]


@pytest.mark.parametrize("name", each(list(STARVING), lambda name: name != "ParticleFilter"))
def test_starvation_at_the_first_step(name):
    _, ys = mo.simulate(3, SHARP, 3)
    filter = discovery.example(discovery.filter_classes()[name], on_collapse="predict")
    history, said = warned(lambda: mo.run(0, filter, SHARP, ys))
    assert len(said) == 1 and name in said[0] and "\n" not in said[0]
    assert "starvation" in mo.diagnose(history) and not mo.diagnose(history).trusted


def test_once_and_outside_of_jit():
    _, ys = mo.simulate(3, SHARP, 6)
    filter = mo.ParticleFilter(n=300, on_collapse="predict")
    assert not warned(lambda: jax.jit(lambda ys: mo.run(0, filter, SHARP, ys).mean)(ys))[1]
    pieces, said = warned(lambda: list(mo.filters.run_in_chunks(0, filter, SHARP, ys, chunk=2)))
    assert len(pieces) == 3 and sum("starvation" in line or "effective" in line for line in said) == 1


def test_collapse_by_policy_is_told():
    calm = mo.StateSpaceModel(mo.Gaussian([0.0], [[1.0]]), mo.LinearGaussian([[0.9]], [[1.0]]), mo.LinearGaussian([[1.0]], [[1.0]]))
    ys = np.zeros((5, 1))
    ys[3] = 1e5
    particles, kalman = mo.ParticleFilter(n=200, on_collapse="predict"), mo.KalmanFilter(on_collapse="inflate")
    for filter, word in ((particles, "no particle"), (kalman, "innovation")):
        _, said = warned(lambda filter=filter: mo.run(0, filter, calm, ys))
        assert len(said) == 1 and "at step 3" in said[0] and word in said[0]


def trend(prior, offset=0.0, sensor=None):
    sensor = mo.LinearGaussian([[1.0, 0.0]], [[1.0]]) if sensor is None else sensor
    return mo.StateSpaceModel(
        mo.Gaussian([offset, 0.0], prior * np.eye(2)), mo.LinearGaussian([[1, 1], [0, 1]], np.diag([0.25, 0.01])), sensor, ("a", "b")
    )


CLIMB = (50 + np.random.default_rng(0).normal(size=20))[:, None]
SUBTRACTING = [name for name, cls in discovery.filter_classes().items() if cls.subtracts]


@pytest.mark.parametrize("name", each(SUBTRACTING, discovery.shares_stages))
def test_wide_priors(name):
    filter = discovery.example(discovery.filter_classes()[name])
    history, said = warned(lambda: mo.run(0, filter, trend(1e7), CLIMB))
    assert sum("prior variance of component 0 of y is 1e+07 times" in line or "wide prior" in line for line in said) == 1
    assert "wide prior" in mo.diagnose(history)


def test_wide_priors_of_a_smoother():
    """The square-root filter keeps the digits that its smoother loses."""
    smoother = mo.smoothers.RauchTungStriebelSmoother()
    for prior, lines in ((1e7, 1), (1e4, 0)):
        model = trend(prior)
        history = mo.run(0, mo.SquareRootKalmanFilter(), model, CLIMB, keep=mo.keep.laws)
        _, said = warned(lambda: mo.smooth(1, smoother, model, history))  # noqa: B023
        assert len(said) == lines and all("smooth: the prior variance of component 0 of y is 1e+07 times" in line for line in said)


def test_what_needs_no_warning():
    for filter, prior in ((mo.KalmanFilter(), 1e4), (mo.SquareRootKalmanFilter(), 1e10)):
        history, said = warned(lambda filter=filter, prior=prior: mo.run(0, filter, trend(prior), CLIMB))
        assert not said and str(mo.diagnose(history)) == "Nothing wrong was found."
    with jax.enable_x64():
        _, said = warned(lambda: mo.run(0, mo.KalmanFilter(), trend(1e7, 4e6), np.asarray(CLIMB + 4e6, np.float64)))
        assert not said


SOME = ("KalmanFilter", "SquareRootKalmanFilter", "UnscentedKalmanFilter", "EnsembleKalmanFilter", "ParticleFilter")


@pytest.mark.parametrize("name", SOME)
def test_numbers_coarser_than_their_noise(name):
    """Offsets of the data, and of states that are measured without them (a range between points that lie far out)."""
    filter = discovery.example(discovery.filter_classes()[name], on_collapse="predict")
    far = 4e6
    ranged = mo.AdditiveGaussian(lambda x, u, t: jnp.abs(x[:1] - (far - 100)), [[0.01]])
    cases = [(trend(1.0, far, mo.LinearGaussian([[1.0, 0.0]], [[0.01]])), CLIMB + far)]
    if name not in ("KalmanFilter", "SquareRootKalmanFilter"):
        cases.append((trend(1.0, far, ranged), CLIMB + 100))
    for model, ys in cases:
        history, said = warned(lambda model=model, ys=ys: mo.run(0, filter, model, ys))
        assert any("component 0 of y" in line and "origin" in line for line in said)
        found = mo.diagnose(history)
        assert "precision" in found and "rocess noise" not in str(found)


def test_planted_thresholds_are_seen(monkeypatch):
    """With the threshold of old, five steps in a row below 2, nothing is said of the first step."""
    _, ys = mo.simulate(3, SHARP, 3)
    monkeypatch.setattr(notices, "SCARCE", 0.0)
    _, said = warned(lambda: mo.run(0, mo.ParticleFilter(n=300, on_collapse="predict"), SHARP, ys))
    assert not any("effective" in line for line in said)
