"""Angles among the states: a heading that crosses the cut is filtered and smoothed as well as one that is never wrapped.

One compiled program serves both: an input tells the dynamics whether to wrap the heading.
"""

import importlib
import inspect
import os
import pkgutil
import sys
from dataclasses import replace
from functools import cache
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import motes as mo
import motes.smoothers
from motes.laws import circular, cloud
from motes.smoothers.interface import Smoother

sys.path.append(str(Path(__file__).parents[1] / "contract"))
from discovery import examples

TURN = 2 * np.pi
STEPS = 48
TURNS = np.where(np.arange(STEPS) // 2 % 2, -0.7, 0.7)
SMALL = {"lower": (-6.0, -np.pi), "upper": (6.0, np.pi * 43 / 45), "nodes": (25, 45)}
WITHOUT_ANGLES_IN_THE_WAY = {
    "MarginalizedParticleFilter, one state": mo.MarginalizedParticleFilter(n=300, linear=("a",)),
    "ParticleFilter, proposal": mo.ParticleFilter(
        n=300, proposal=mo.AdditiveGaussian(lambda x, uy, t: moved(x, uy[0], t), np.diag([0.3, 0.05]), angles=(1,))),
    "PointMassFilter": mo.PointMassFilter(**SMALL),
    "RegularizedParticleFilter, before": mo.RegularizedParticleFilter(n=300, form="pre", regularization=mo.Regularization(shrink=True)),
    "EnsembleKalmanFilter, inflated": mo.EnsembleKalmanFilter(n=300, inflation=1.05),
    "PaRIS": mo.PaRIS(n=60, function=lambda before, after, u, t: after[:1], size=1),
    "ParticleFilter, transport": mo.ParticleFilter(n=60, scheme=mo.EntropicTransport()),
}  # fmt: skip
"""In place of those of the contract suite whose knobs are for another model, and some more that average."""
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


@pytest.mark.parametrize("name", sorted(set(filters()) - set(LINEAR)))
def test_every_filter(name):
    assert alike(*both(filters()[name]))


@pytest.mark.parametrize("name", LINEAR)
def test_linear_filters_know_the_angle_of_the_sensor(name):
    xs, ys = world()
    found = mo.run(1, filters()[name], model_of(turned), ys, inputs(False))
    assert rms(errors(xs, found.mean)) < 0.2
