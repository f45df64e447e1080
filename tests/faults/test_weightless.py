"""Hypotheses without weight: those that underflow keep their order, and those that are no number leave the others alone."""

import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import motes as mo
from motes.laws import gaussian
from motes.laws.mixture import Mixture
from motes.montecarlo.tempering import _largest_step
from motes.resampling import reduction
from tiers import each

sys.path.append(str(Path(__file__).parents[1] / "contract"))
from discovery import example, filter_classes, first_of_kinds, shares_stages

UNDERFLOWN = jnp.array([-200.0, -201, -202, -203, -204, -205, -1.0, -0.459])


def kept(n=4):
    found = reduction.reduced(jax.random.key(0), UNDERFLOWN, n)
    return set(np.asarray(found.ancestors).tolist()), float(jnp.exp(found.log_weights).sum())


@pytest.mark.parametrize("paired", [0, reduction.PAIRED], ids=["sorted", "in pairs"])
def test_the_heaviest_are_kept(paired, monkeypatch):
    monkeypatch.setattr(reduction, "PAIRED", paired)
    places, total = kept()
    assert {6, 7, 0} <= places and abs(total - 1) < 1e-3


def test_a_threshold_of_weights_that_underflow_would_be_found(monkeypatch):
    monkeypatch.setattr(reduction, "PAIRED", 0)
    monkeypatch.setattr(reduction, "_log_threshold", lambda log_weights, n: jnp.asarray(-jnp.inf))
    assert kept()[1] < 0.5


def test_lighter_ones_take_turns():
    """The last place goes to one of five in proportion to their weights, none of which float32 can tell from zero; level 1e-6."""
    draws = jax.vmap(lambda key: reduction.reduced(key, UNDERFLOWN, 4).ancestors)(jax.random.split(jax.random.key(1), 2000))
    share = np.mean(np.asarray(draws)[:, 1] == 1)
    wanted = 1 / np.exp(-np.arange(5.0)).sum()
    assert abs(share - wanted) < 4.9 * np.sqrt(wanted * (1 - wanted) / 2000)


def test_chains_that_met_nothing_are_drawn_by_weight():
    log_weights = jnp.where(jnp.arange(5000) == 4321, 0.0, -jnp.inf)
    assert np.all(np.asarray(mo.resampling.MetropolisResampling(8).ancestors(jax.random.key(0), log_weights, 5000)) == 4321)


@pytest.mark.parametrize("span", [1.0, 1e3, 1e9, 1e15])
def test_steps_of_the_exponent_keep_their_size_at_every_scale(span):
    values = -span * jnp.linspace(0, 1, 200) ** 2
    values = jnp.where(jnp.arange(200) < 150, values, -jnp.inf)
    step = _largest_step(values, jnp.zeros(()), 0.5)
    weights = jax.nn.softmax(jnp.where(jnp.isfinite(values), step * values, -jnp.inf))
    assert 0.49 * 150 < 1 / float(jnp.sum(weights**2)) and (step == 1 or 1 / float(jnp.sum(weights**2)) < 0.52 * 150)


def void(x, u, t):
    """A map that knows nothing beyond 1, neither height nor slope."""
    return (x[:1] + 0.1 * x[:1] ** 2) * jnp.where(x[:1] > 1.0, jnp.nan, 1.0)


def reaching():
    return mo.StateSpaceModel(
        mo.Gaussian([0.0, 0.0], np.eye(2)),
        mo.LinearGaussian([[0.9, 0.1], [0.0, 0.8]], 0.05 * np.eye(2)),
        mo.AdditiveGaussian(void, [[0.1]]),
        ("a", "b"),
    )


YS = np.array([[-0.3], [-0.2], [0.1], [0.0]])
CLOSE = {f"{kind}ParticleFilter" for kind in ("", "Marginalized", "Regularized", "Auxiliary", "Gaussian", "GaussianSum")}
ONE_LAW = {f"{kind}Filter" for kind in ("UnscentedKalman", "CubatureKalman", "GaussHermite", "EnsembleKalman")}
"""Points of theirs in the void leave them without a prediction."""
CLOSE |= {"KalmanParticleKernelFilter", "PointMassFilter"}


def means(filter):
    return np.asarray(mo.run(1, filter, reaching(), YS).mean)


KINDS = first_of_kinds({name: example(cls) for name, cls in filter_classes().items()})


@pytest.mark.parametrize("name", each(sorted(filter_classes()), lambda name: name not in KINDS or shares_stages(name)))
def test_a_void_in_reach_leaves_moments_alone(name):
    """16 percent of the prior lie in it."""
    parameters = {"KalmanParticleKernelFilter": {"nonlinear": ("a", "b"), "every": 1, "n": 2000}}.get(name, {})
    try:
        found = means(example(filter_classes()[name], **parameters))
    except mo.CollapseError:
        assert name in ONE_LAW
        return
    except mo.MotesError as error:
        assert "expected a linear-Gaussian model" in str(error)
        return
    assert np.all(np.isfinite(found))
    if name in CLOSE:
        assert np.abs(found - means(mo.ParticleFilter(20_000))).max() < 0.4


def test_moments_that_are_no_number_would_be_found(monkeypatch):
    """With neither what keeps a law that is told nothing, nor what leaves components of weight zero out of moments."""
    monkeypatch.setattr(gaussian, "_kept_where", lambda lost, before, after: after)
    monkeypatch.setattr(Mixture, "_counted", lambda law, each: each)
    jax.clear_caches()
    with pytest.raises(mo.CollapseError):
        means(mo.KalmanParticleKernelFilter(200, nonlinear=("a", "b"), every=1, slope="jacobian"))
