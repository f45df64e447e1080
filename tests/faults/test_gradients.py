"""The derivative of a run that resamples is not that of the log likelihood, unless the scheme makes it so: every such run says so."""

import sys
import warnings
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import motes as mo
from tiers import each

sys.path.append(str(Path(__file__).parents[1] / "contract"))
import discovery

YS = np.random.default_rng(0).normal(size=(4, 1))
PICKING = [name for name, cls in discovery.filter_classes().items() if hasattr(cls, "scheme") or name == "JumpMarkovFilter"]


def value(a, filter, closed=False):
    dynamics = mo.AdditiveGaussian(lambda x, u, t: a * x, 0.5 * np.eye(2)) if closed else mo.LinearGaussian(a * jnp.eye(2), 0.5 * np.eye(2))
    model = mo.StateSpaceModel(mo.Gaussian([0.0, 0.0], np.eye(2)), dynamics, mo.LinearGaussian([[1.0, 0.0]], [[0.3]]), ("a", "b"))
    return mo.run(0, filter, model, YS).log_likelihood


def small(name):
    return discovery.example(discovery.filter_classes()[name], n=20)


@pytest.mark.parametrize("name", [name for name in PICKING if not name.startswith("Cost")])
def test_a_filter_that_picks_says_so(name):
    with pytest.warns(mo.MotesWarning, match="mo.resampling.StopGradient"):
        jax.eval_shape(jax.grad(lambda a: value(a, small(name))), 0.7)


@pytest.mark.parametrize("closed", each([False, True], {"True"}))
def test_every_way_to_differentiate_is_seen(closed):
    filter = mo.ParticleFilter(n=20)
    for way in (lambda f: jax.grad(f), lambda f: jax.jit(jax.grad(f)), lambda f: jax.grad(jax.jit(f)), lambda f: jax.jacfwd(f)):
        for _ in range(2):  # also where all is compiled
            with pytest.warns(mo.MotesWarning, match="derivative of a run"):
                way(lambda a: value(a, filter, closed))(0.7)


@pytest.mark.parametrize(
    "filter",
    [mo.KalmanFilter(), mo.GaussianParticleFilter(n=20), mo.ParticleFilter(n=20, policy=mo.resampling.Never()),
     mo.ParticleFilter(n=20, scheme=mo.resampling.StopGradient(mo.resampling.Systematic())),
     mo.ParticleFilter(n=20, scheme=mo.resampling.EntropicTransport())],
    ids=["kalman", "gaussian", "never", "stop", "transport"],
)  # fmt: skip
def test_others_are_silent(filter):
    with warnings.catch_warnings():
        warnings.simplefilter("error", mo.MotesWarning)
        warnings.filterwarnings("ignore", message=".*effective.*")
        jax.eval_shape(jax.grad(lambda a: value(a, filter)), 0.7)


def test_what_is_not_differentiated_is_silent():
    with warnings.catch_warnings():
        warnings.simplefilter("error", mo.MotesWarning)
        jax.jit(jax.vmap(lambda a: value(a, mo.ParticleFilter(n=20))))(jnp.array([0.6, 0.7]))
