"""Kalman filters speak of the innovation, not of particles; a gate leaves measurements out; an infinite variance is no measurement."""

import dataclasses
import sys
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest

import motes as mo
from tiers import each

sys.path.append(str(Path(__file__).parents[1] / "contract"))
import discovery

A = np.array([[1, 1], [0, 1.0]])
MODEL = mo.StateSpaceModel(
    mo.Gaussian([0.0, 1.0], np.eye(2)), mo.LinearGaussian(A, np.diag([0.01, 0.01])), mo.LinearGaussian([[1.0, 0.0]], [[0.01]]), ("a", "b")
)
YS = np.arange(12.0)[:, None] + np.random.default_rng(0).normal(0, 0.1, (12, 1))
WILD = YS.copy()
WILD[6] += 100
GATED = {name: cls for name, cls in discovery.filter_classes().items() if "gate" in [field.name for field in dataclasses.fields(cls)]}


def test_every_gaussian_filter_has_a_gate():
    kalman = {name for name, cls in discovery.filter_classes().items() if not cls.weighs}
    others = {"MarginalizedParticleFilter", "InteractingMultipleModel", "JumpMarkovFilter", "GaussianParticleFilter",
              "GaussianSumParticleFilter", "KalmanParticleKernelFilter"}  # fmt: skip
    assert kalman | others == set(GATED)


BY_DAY = {"KalmanFilter", "UnscentedKalmanFilter", "MarginalizedParticleFilter", "JumpMarkovFilter"}


@pytest.mark.parametrize("name", each(list(GATED), set(GATED) - {"KalmanFilter", "UnscentedKalmanFilter"}))
def test_a_wild_fix_is_left_out_and_counted(name):
    parameters = {"nonlinear": ("a",)} if name == "KalmanParticleKernelFilter" else {}
    got = mo.run(0, discovery.example(GATED[name], gate=0.9999, **parameters), MODEL, WILD)
    blank = WILD.copy()
    blank[6] = np.nan
    without = mo.run(0, discovery.example(GATED[name], **parameters), MODEL, blank)
    assert np.asarray(got.info.gated).tolist() == [0] * 6 + [1] + [0] * 5
    np.testing.assert_allclose(got.mean, without.mean, rtol=1e-5)
    np.testing.assert_allclose(got.log_likelihood, without.log_likelihood, rtol=1e-5)
    assert not got.info.collapsed.any()


WIDE = mo.replace(MODEL, sensor=mo.LinearGaussian([[1.0, 0.0], [0.0, 1.0], [1.0, 1.0]], 0.1 * np.eye(3)))
THREE = np.array(mo.simulate(4, WIDE, 12)[1])
THREE[6] += [0.0, 20.0, 0.0]


@pytest.mark.parametrize("name", each(list(GATED), set(GATED) - {"MarginalizedParticleFilter", "JumpMarkovFilter"}))
def test_a_wild_fix_of_three_components_is_left_out(name):
    """What a gate lets in grows with the components: that of clouds once stopped short of it."""
    parameters = {"nonlinear": ("a",)} if name == "KalmanParticleKernelFilter" else {}
    got = mo.run(0, discovery.example(GATED[name], gate=0.9999, **parameters), WIDE, THREE)
    assert np.asarray(got.info.gated).tolist() == [0] * 6 + [1] + [0] * 5
    assert not got.info.collapsed.any()


@pytest.mark.parametrize("name", [name for name in GATED if not GATED[name].weighs])
def test_the_message_speaks_of_the_innovation(name):
    with pytest.raises(mo.CollapseError, match="step 6: the innovation lies .* standard deviations .*gate=0.9999") as told:
        mo.run(0, discovery.example(GATED[name]), MODEL, WILD)
    assert "particle" not in str(told.value) and "weights" not in str(told.value)


def test_streams_gate_and_speak_alike():
    stream = mo.stream(0, mo.KalmanFilter(gate=0.9999), MODEL)
    for t, y in enumerate(WILD):
        if t:
            stream.predict()
        assert int(stream.update(y).gated) == (t == 6)
    plain = mo.stream(0, mo.KalmanFilter(), MODEL)
    with pytest.raises(mo.CollapseError, match="the innovation lies"):
        plain.update(WILD[6] * 10)


@pytest.mark.parametrize("gate", [0, 1.0, "0.9", 2, {3: 0.9}, {"a": 2.0}])
def test_gates_are_probabilities(gate):
    with pytest.raises(mo.MotesError, match="KalmanFilter gate: expected a probability"):
        mo.KalmanFilter(gate=gate)


DOUBLE = mo.StateSpaceModel(
    mo.Gaussian([0.0, 1.0], np.eye(2)),
    mo.LinearGaussian(A, np.diag([0.1, 0.1])),
    mo.AdditiveGaussian(lambda x, u, t: jnp.stack([x[0], x[0] + x[1]]), lambda x, u, t: jnp.diag(u)),
    ("a", "b"),
)
VARIANCES = np.full((6, 2), 0.5)
VARIANCES[2, 1] = VARIANCES[3] = np.inf


OTHERS = ("PointMassFilter", "CostReferenceParticleFilter", "SkeletonFilter")
EXAMPLES = {name: discovery.example(cls) for name, cls in discovery.filter_classes().items() if name not in OTHERS}
EITHER = {name: filter for name, filter in EXAMPLES.items() if not filter.adds_inputs}
ON_ENGINES = {f"{name}-{engine}": (name, engine) for name, filter in EITHER.items() for engine in ("jax", "native")
              if engine == "jax" or hasattr(filter, "n")}  # fmt: skip
"""Filters without particles have nothing that the native engine could do."""


@pytest.mark.parametrize("case", each(
    ON_ENGINES, lambda name: name.removesuffix("-jax") not in BY_DAY and name != "MarginalizedParticleFilter-native"))
def test_an_infinite_variance_is_no_measurement(case):
    name, engine = case
    filter = EITHER[name]
    ys = np.random.default_rng(1).normal(size=(6, 2)) + np.arange(6.0)[:, None]
    blank = np.where(np.isinf(VARIANCES), np.nan, ys)
    with mo.engine(engine):
        got = mo.run(0, filter, DOUBLE, ys, VARIANCES)
        wanted = mo.run(0, filter, DOUBLE, blank, np.where(np.isinf(VARIANCES), 1.0, VARIANCES))
    # filters that keep moments of draws alone take them again where all variances are infinite
    close = 0.1 if name in ("GaussianParticleFilter", "GaussianSumParticleFilter") else 1e-4
    np.testing.assert_allclose(got.mean, wanted.mean, rtol=close, atol=close)
    np.testing.assert_allclose(got.log_likelihood, wanted.log_likelihood, rtol=close)
    np.testing.assert_allclose(np.asarray(got.info.freedom)[3], 0, atol=1e-6)
