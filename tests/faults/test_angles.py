"""Angles among the states: a heading that crosses the cut is filtered and smoothed as well as one that is never wrapped.

One compiled program serves both: an input tells the dynamics whether to wrap the heading.
"""

import importlib
import inspect
import pkgutil
import sys
from functools import cache
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import motes as mo
import motes.smoothers
from motes.core.record import replace
from motes.diagnostics import undeclared
from motes.laws import circular, cloud
from motes.smoothers.interface import Smoother
from tiers import NIGHT, each

sys.path.append(str(Path(__file__).parents[1] / "contract"))
from discovery import examples, is_variant

TURN = 2 * np.pi
STEPS = 48
TURNS = np.where(np.arange(STEPS) // 2 % 2, -0.7, 0.7)
SMALL = {"lower": (-6.0, -np.pi), "upper": (6.0, np.pi * 43 / 45), "nodes": (25, 45)}
WITHOUT_ANGLES_IN_THE_WAY = {
    "MarginalizedParticleFilter, one state": mo.MarginalizedParticleFilter(n=300, linear=("a",)),
    "ParticleFilter, proposal": mo.ParticleFilter(
        n=300, proposal=mo.AdditiveGaussian(lambda x, uy, t: moved(x, uy[0], t), np.diag([0.3, 0.05]), angles=(1,))),
    "PointMassFilter": mo.PointMassFilter(**SMALL),
    "RegularizedParticleFilter, before": mo.RegularizedParticleFilter(
        n=300, form="pre", regularization=mo.resampling.Regularization(shrink=True)),
    "EnsembleKalmanFilter, inflated": mo.EnsembleKalmanFilter(n=300, inflation=1.05),
    "PaRIS": mo.smoothers.PaRIS(n=60, function=lambda before, after, u, t: after[:1], size=1),
    "ParticleFilter, transport": mo.ParticleFilter(n=60, scheme=mo.resampling.EntropicTransport()),
}  # fmt: skip
"""In place of those of the contract suite whose parameters are for another model, and some more that average."""
LINEAR = ("KalmanFilter", "SquareRootKalmanFilter")


def wrapped(h):
    return h - TURN * jnp.ceil(h / TURN - 0.5)


def moved(x, u, t):
    h = x[1] + u["turn"]
    return jnp.array([0.9 * x[0] + 0.5 * jnp.sin(x[1]), jnp.where(u["wrap"], wrapped(h), h)])


def turned(x, u, t):
    return jnp.array([0.9 * x[0], x[1] + u["turn"]])


def model_of(f, angles=(1,)):
    initial = mo.Gaussian([0.0, np.pi - 0.3], np.diag([1.0, 0.02]))
    dynamics = mo.AdditiveGaussian(f, np.diag([0.2, 0.01]), angles=angles)
    return mo.StateSpaceModel(initial, dynamics, mo.AdditiveGaussian(lambda x, u, t: x, np.diag([0.25, 0.04]), angles=(1,)), ("a", "b"))


MODEL, UNDECLARED = model_of(moved), model_of(moved, ())


def inputs(wrap):
    return {"turn": jnp.asarray(TURNS), "wrap": jnp.full(STEPS, wrap)}


@cache
def world():
    xs, ys = (np.array(values) for values in mo.simulate(3, MODEL, STEPS, inputs(False)))
    ys[:, 1] = wrapped(ys[:, 1])
    ys[10, 1] = ys[20, 0] = ys[30] = np.nan
    return xs, ys


def errors(xs, means):
    return np.asarray(wrapped(np.asarray(means)[:, 1] - xs[:, 1]))


def rms(values):
    return float(np.sqrt(np.mean(np.square(values))))


def both(filter, model=MODEL, **options):
    return [mo.run(1, filter, model, world()[1], inputs(wrap), **options) for wrap in (True, False)]


def alike(found, whole):
    """Check that a heading that was wrapped is as well known as one that was not, and known."""
    xs = world()[0]
    ours, theirs = rms(errors(xs, found.mean)), rms(errors(xs, whole.mean))
    claimed, meant = (np.sqrt(np.mean(np.asarray(one.cov)[:, 1, 1])) for one in (found, whole))
    return ours <= 1.1 * theirs and claimed <= 1.1 * meant and theirs < 0.5


def filters():
    return examples() | WITHOUT_ANGLES_IN_THE_WAY


def test_the_heading_crosses_the_cut():
    signs = np.sign(wrapped(world()[0][:, 1]))
    assert np.sum(signs[1:] != signs[:-1]) >= 20


BY_DAY = {"ParticleFilter", "MarginalizedParticleFilter", "UnscentedKalmanFilter", "GaussianParticleFilter",
          "InteractingMultipleModel", "KalmanParticleKernelFilter", "EnsembleKalmanFilter"}  # fmt: skip
"""One for each way to average: points with weights, means of Kalman filters, sigma points, draws, modes, kernels, members."""


@pytest.mark.parametrize("name", each(sorted(set(filters()) - set(LINEAR)), lambda name: name not in BY_DAY))
def test_every_filter(name):
    assert alike(*both(filters()[name]))


@pytest.mark.parametrize("name", LINEAR)
def test_linear_filters_know_the_angle_of_the_sensor(name):
    xs, ys = world()
    found = mo.run(1, filters()[name], model_of(turned), ys, inputs(False))
    assert rms(errors(xs, found.mean)) < 0.2


@pytest.mark.parametrize("fault", each(["laws", "fits", "declaration"], {"fits"}))
def test_the_faults_are_seen(fault, monkeypatch):
    # other sizes than elsewhere: what was compiled without the fault must not be used again
    filter, model = mo.ParticleFilter(n=299), MODEL
    if fault == "laws":
        monkeypatch.setattr(cloud.Cloud, "gathered", lambda self, angles: self)
    elif fault == "fits":
        filter = mo.GaussianParticleFilter(n=299)
        monkeypatch.setattr("motes.filters.gaussian_particle.gathered", lambda points, log_weights, angles: points)
    else:
        model = UNDECLARED
    assert not alike(*both(filter, model))


def smoother_classes():
    for module in pkgutil.iter_modules(motes.smoothers.__path__):
        for value in vars(importlib.import_module(f"motes.smoothers.{module.name}")).values():
            if inspect.isclass(value) and issubclass(value, Smoother) and not inspect.isabstract(value):
                yield value


CLOUD = mo.ParticleFilter(n=200)
SMOOTHERS = {
    "BackwardSimulationSmoother": (CLOUD, mo.smoothers.BackwardSimulationSmoother(n=100)),
    "BackwardSimulationSmoother, rejected": (CLOUD, mo.smoothers.BackwardSimulationSmoother(n=100, parents=mo.smoothers.RejectedParents())),
    "GenealogySmoother": (CLOUD, mo.smoothers.GenealogySmoother()),
    "GenealogySmoother, lag": (CLOUD, mo.smoothers.GenealogySmoother(lag=2)),
    "MixtureSmoother": (mo.JumpMarkovFilter(n=100, sampled=("a",)), mo.smoothers.MixtureSmoother(n=60)),
    "MixtureSmoother, kernels": (mo.KalmanParticleKernelFilter(n=100), mo.smoothers.MixtureSmoother(n=60)),
    "RaoBlackwellizedSmoother": (mo.MarginalizedParticleFilter(n=100), mo.smoothers.RaoBlackwellizedSmoother(n=60)),
    "RauchTungStriebelSmoother": (mo.ExtendedKalmanFilter(), mo.smoothers.RauchTungStriebelSmoother()),
    "RauchTungStriebelSmoother, sigma": (mo.UnscentedKalmanFilter(), mo.smoothers.RauchTungStriebelSmoother(mo.gaussian.Cubature())),
    "TwoFilterSmoother": (CLOUD, mo.smoothers.TwoFilterSmoother(n=200)),
}  # fmt: skip


def test_no_smoother_is_left_out():
    """Those of Viterbi's algorithm have states that are known: none is averaged."""
    assert {cls.__name__ for cls in smoother_classes()} == {name.split(",")[0] for name in SMOOTHERS} | {"Viterbi"}


def smoothed(filter, smoother, wrap, filtered=None):
    history = mo.run(1, filter, MODEL, world()[1], inputs(wrap if filtered is None else filtered), keep=mo.keep.laws)
    return mo.smooth(2, smoother, MODEL, history, world()[1], inputs(wrap))


def walks(found):
    """Mean square of the heading's noise along drawn paths, in units of its variance; 1 without paths."""
    if found.paths is None:
        return 1.0
    h = np.asarray(found.paths)[:, 1]
    return np.mean(wrapped(h[1:] - h[:-1] - TURNS[1:, None]) ** 2) / 0.01


def smoothed_alike(filter, smoother, filtered=None):
    found, whole = smoothed(filter, smoother, True, filtered), smoothed(filter, smoother, False)
    return bool(alike(found, whole)) and walks(found) < 1.15 * walks(whole)


@pytest.mark.parametrize("name", each(list(SMOOTHERS), lambda name: is_variant(name) or name == "GenealogySmoother"))
def test_every_smoother(name):
    assert smoothed_alike(*SMOOTHERS[name])


@pytest.mark.parametrize("fault", each([False, True], {"True"}))
def test_laws_on_another_branch_than_the_dynamics(fault, monkeypatch):
    """A filter left the heading unwrapped, and the smoother's dynamics wrap it: the same angles all the same."""
    if fault:
        monkeypatch.setattr("motes.smoothers.rao_blackwellized.wrap", lambda difference, angles: difference)
    assert (
        smoothed_alike(mo.MarginalizedParticleFilter(n=100 - fault), mo.smoothers.RaoBlackwellizedSmoother(n=60), filtered=False)
        is not fault
    )


def mixed(x_p, u, t):
    h = x_p + u["turn"]
    return jnp.where(u["wrap"], wrapped(h), h), jnp.zeros((1, 1)), jnp.array([[0.01]])


MIXED = mo.MixedLinearModel(
    mo.Gaussian([np.pi - 0.3], [[0.02]]), mo.Gaussian([0.0], [[1.0]]), mixed,
    lambda x_p, u, t: (0.5 * jnp.sin(x_p), jnp.array([[0.9]]), jnp.array([[0.2]])),
    lambda x_p, u, t: (jnp.array([0.0, x_p[0]]), jnp.array([[1.0], [0.0]]), jnp.diag(jnp.array([0.25, 0.04]))),
    angles=(1,), linear=(0,), names=("a", "b"), circular=(1,),
)  # fmt: skip
SLOW = mo.StateSpaceModel(MODEL.initial, mo.AdditiveGaussian(moved, np.diag([0.2, 0.001]), angles=(-1,)), MODEL.sensor, MODEL.names)
JUMPING = mo.JumpMarkovModel([0.5, 0.5], [[0.8, 0.2], [0.2, 0.8]], [MODEL, SLOW])
CORRELATED = mo.StateSpaceModel(MODEL.initial, MODEL.dynamics, MODEL.sensor, MODEL.names, np.array([[0.1, 0.0], [0.0, 0.015]]))
LINEAR_HEADING = model_of(turned)
LAPLACE = replace(MODEL, dynamics=mo.AdditiveNoise(moved, mo.Laplace([0.3, 0.07]), angles=(1,)))
OWN = replace(MODEL, dynamics=mo.Custom(
    lambda key, x, u, t: moved(x, u, t) + jnp.array([0.45, 0.1]) * jax.random.normal(key, (2,)), angles=(1,)))  # fmt: skip
OTHERS = {
    "mixed linear": (MIXED, mo.MarginalizedParticleFilter(n=300)),
    "mixed linear, joined": (MIXED, mo.EnsembleKalmanFilter(n=300)),
    "modes mixed": (JUMPING, mo.InteractingMultipleModel()),
    "modes followed": (JUMPING, mo.JumpMarkovFilter(n=20)),
    "modes joined": (JUMPING.as_state_space(), mo.ParticleFilter(n=400)),
    "correlated noises": (CORRELATED, mo.ParticleFilter(n=400)),
    "noise of another law": (LAPLACE, mo.ParticleFilter(n=400)),
    "in the user's words": (OWN, mo.ParticleFilter(n=400)),
}  # fmt: skip


@pytest.mark.parametrize("kind", each(list(OTHERS), {"mixed linear, joined", "modes followed", "modes joined", "noise of another law"}))
def test_every_kind_of_model(kind):
    model, filter = OTHERS[kind]
    assert alike(*both(filter, model))


def test_an_angle_in_the_kalman_part():
    """The heading is linear here; the filter wraps nothing itself, and means of particles may lie on any branch."""
    history = mo.run(1, mo.MarginalizedParticleFilter(n=100), LINEAR_HEADING, world()[1], inputs(False))
    assert rms(errors(world()[0], history.mean)) < 0.2
    law = history.state
    off = replace(law, kalman=replace(law.kalman, center=law.kalman.center.at[-1, ::2].add(TURN)))
    np.testing.assert_allclose(off.gathered((1,)).mean(), law.mean(), atol=1e-5)
    assert float(off.cov()[1, 1]) > 5 > 0.1 > float(off.gathered((1,)).cov()[1, 1])


def test_the_mean_is_the_circular_mean():
    history = both(CLOUD, keep=mo.keep.laws)[0]
    weights, h = np.exp(np.asarray(history.law.log_weights, np.float64)), np.asarray(history.law.particles[:, 1], np.float64)
    expected = np.angle(np.sum(weights * np.exp(1j * h), axis=1))
    assert np.abs(wrapped(history.mean[:, 1] - expected)).max() < 2e-3
    # and on the branch where most of the particles are left by the dynamics
    assert np.abs(history.mean[:, 1]).max() < np.pi + 0.5


@pytest.mark.optimized
def test_streams_give_the_same_bits():
    ys, told = world()[1][:8], inputs(True)
    for filter in (CLOUD, *[mo.EnsembleKalmanFilter(n=50)] * NIGHT):
        history = mo.run(1, filter, MODEL, ys, jax.tree.map(lambda leaf: leaf[:8], told))
        stream = mo.stream(1, filter, MODEL, jax.tree.map(lambda leaf: leaf[0], told))
        for t, y in enumerate(ys):
            if t:
                stream.predict(jax.tree.map(lambda leaf, t=t: leaf[t], told))
            stream.update(y)
            np.testing.assert_array_equal(stream.mean, history.mean[t])


@pytest.mark.parametrize("engine", each(["double", "native"], {"double"}))
def test_precisions_and_engines(engine):
    filter = mo.ParticleFilter(n=300)
    with jax.enable_x64(engine != "native"), mo.engine("native" if engine == "native" else "jax"):
        assert alike(*both(filter))


def test_points_are_moved_by_whole_turns_to_most_of_the_weight():
    h = jnp.array([3.0, -3.1, 3.05, -2.9 + 3 * TURN, jnp.nan, 0.1])
    points, log_weights = jnp.stack([jnp.zeros(6), h]), jnp.log(jnp.array([0.3, 0.2, 0.3, 0.2, 0.0, 0.0]))
    found = np.asarray(circular.gathered(points, log_weights, (1,)))
    np.testing.assert_array_equal(found[0], 0)
    np.testing.assert_allclose(found[1], [3.0, TURN - 3.1, 3.05, TURN - 2.9, np.nan, 0.1], atol=1e-5)
    assert found[1, 0] == h[0]
    assert found[1, 2] == h[2]
    # an unwrapped heading is left alone on whatever turn it is
    far = points.at[1].set(jnp.array([40.0, 40.1, 39.9, 40.0, 41.0, 42.0]))
    np.testing.assert_array_equal(circular.gathered(far, log_weights, (1,)), far)


def test_errors_are_judged_the_short_way_round():
    history = both(CLOUD)[0]
    xs = world()[0]
    assert history.circular == (1,)
    judged = np.asarray(mo.diagnostics.nees(history, xs))
    np.testing.assert_allclose(mo.diagnostics.nees(history, xs + np.array([0, TURN])), judged, rtol=1e-2, atol=1e-3)
    assert judged.mean() < 6
    assert float(mo.diagnostics.coverage(history, xs)[1]) > 0.8


def test_a_saved_history_knows_its_angles(tmp_path):
    history = both(CLOUD)[0]
    assert mo.History.load(history.save(tmp_path / "a.npz")).circular == (1,)


def test_liu_west_knows_them():
    given = mo.parameters.Posterior(mo.Gaussian([0.2], [[1e-4]]), lambda theta: MODEL, CLOUD, world()[1], inputs(True))
    found = mo.parameters.liu_west(1, given, 300)
    assert rms(wrapped(found.mean[:, 2] - world()[0][:, 1])) < 0.2


def test_what_cannot_be_is_refused():
    for wrong in (lambda: model_of(moved, (2,)), lambda: replace_circular((5,)),
                  lambda: mo.filters.run_in_parallel(LINEAR_HEADING, world()[1], inputs(False))):
        with pytest.raises(mo.MotesError, match="angles|circular"):
            wrong()


def replace_circular(circular):
    return mo.MixedLinearModel(MIXED.initial_p, MIXED.initial_k, mixed, MIXED.kalman, MIXED.sensor, circular=circular)


CUTS = {"(-pi, pi]": wrapped, "[0, 2 pi)": lambda h: h % TURN, "nowhere": lambda h: h}


def diagnosed(filter, cut, angles=()):
    model = model_of(lambda x, u, t: jnp.array([0.9 * x[0] + jnp.sin(x[1]), CUTS[cut](x[1] + 0.15)]), angles)
    ys = np.array(mo.simulate(1, model, 80)[1])
    ys[:, 1] = wrapped(ys[:, 1])
    return mo.diagnose(mo.run(1, filter, model, ys))


@pytest.mark.parametrize("cut", each(list(CUTS), {"[0, 2 pi)", "nowhere"}))
def test_a_heading_that_is_wrapped_and_not_declared_is_told(cut):
    found = diagnosed(CLOUD, cut)
    assert ("undeclared angle" in found) == (cut != "nowhere")
    if cut != "nowhere":
        assert not found.trusted
        assert "b looks like an angle" in str(found)
        assert "angles=(1,)" in str(found)
        # a Gaussian is never torn, but nobody knows its errors
        assert "undeclared angle" in diagnosed(mo.ExtendedKalmanFilter(), cut)
        assert "undeclared angle" not in diagnosed(CLOUD, cut, (1,))


def test_few_states_that_are_no_angles_look_like_one():
    """Kalman estimates of walks about the size of a turn; at most one of 300 may be mistaken."""
    rng, mistaken = np.random.default_rng(0), 0
    for _ in range(600):
        a, q = rng.choice([0.5, 0.9, 0.99, 1.0]), 10 ** rng.uniform(-2, 0.5)
        r, truth, mean, var, means, deviations = q * 10 ** rng.uniform(-1, 1.5), rng.normal() * rng.choice([1, 3, 10]), 0.0, 1e2, [], []
        for t in range(200):
            truth = a * truth + q * rng.normal()
            mean, var = a * mean, a * a * var + q * q
            if rng.random() < 0.7 or not t:
                gain = var / (var + r * r)
                mean, var = mean + gain * (truth + r * rng.normal() - mean), (1 - gain) * var
            means.append(mean)
            deviations.append(var**0.5)
        steps, _ = undeclared._crossings(np.array(means), np.array(deviations))
        mistaken += bool(steps.size)
    assert mistaken <= 2
