"""Every filter with every smoother: it smooths, or its refusal names what does, or says that nothing can; found by tracing alone."""

import re
import sys
from pathlib import Path

import jax
import numpy as np
import pytest

import motes as mo
from motes.core.record import replace

sys.path.append(str(Path(__file__).parents[1] / "contract"))
from discovery import example, examples, first_of_kinds, smoother_classes
from test_smoothers import linear

from tiers import each

NOTHING = {"CostReferenceParticleFilter", "PaRIS", "Recovering", "Adapting", "AdaptiveSize", "JPDAParticleFilter"}
"""Filters whose laws cannot be smoothed."""
YS = np.array([[0.3], [1.2], [np.nan], [0.9]])
SMOOTHERS = smoother_classes()
ALL = examples() | {"ParticleFilter, transport": mo.ParticleFilter(n=9, scheme=mo.resampling.EntropicTransport())}
KINDS = first_of_kinds(ALL)
"""One filter for each kind of law, asked by day."""


def outcomes(filter, model):
    """What each smoother makes of a run: None where it smooths, otherwise its refusal."""
    found = {}
    history = jax.eval_shape(lambda: mo.run(0, filter, model, YS, keep=mo.keep.laws))
    for name in SMOOTHERS:
        try:
            jax.eval_shape(lambda history, name=name: mo.smooth(1, example(SMOOTHERS[name]), model, history, YS), history)
            found[name] = None
        except mo.MotesError as refusal:
            found[name] = str(refusal)
    return found


def ends(asked, found, met=()):
    """Whether following the hints of a refusal, whichever of them, comes to a smoother that works or to the word that nothing does."""
    if found[asked] is None:
        return True
    named = set(re.findall(r"\b\w+Smoother\b", found[asked])) - {asked}
    if not named:
        return "be smoothed" in found[asked]
    return asked not in met and all(ends(name, found, (*met, asked)) for name in named)


@pytest.mark.parametrize("name", each(list(ALL), lambda name: name not in KINDS))
def test_hints_end_in_a_smoother_that_works(name):
    found = outcomes(ALL[name], linear())
    assert [found[asked] for asked in found if not ends(asked, found)] == []
    assert (None in found.values()) is (name.split(",")[0] not in NOTHING)


MODES = mo.JumpMarkovModel([0.5, 0.5], [[0.9, 0.1], [0.1, 0.9]], [linear(), linear()])
SAMPLED = replace(linear(), dynamics=mo.Custom(sample=lambda key, x, u, t: x + jax.random.normal(key, (2,))))


@pytest.mark.parametrize(("filter", "model", "works"), [
    (mo.InteractingMultipleModel(), MODES, {"MixtureSmoother", "Viterbi"}),
    (mo.JumpMarkovFilter(n=9, sampled="a"), MODES, {"MixtureSmoother"}),
    (mo.ParticleFilter(n=9), MODES.as_state_space(), {"BackwardSimulationSmoother", "GenealogySmoother"}),
    (mo.ParticleFilter(n=9), SAMPLED, {"GenealogySmoother"}),
    (mo.ParticleFilter(n=9, scheme=mo.resampling.EntropicTransport()), SAMPLED, set()),
], ids=["mixing", "jump-Markov", "joined", "no density", "no density nor descent"])  # fmt: skip
def test_hints_of_other_models(filter, model, works):
    found = outcomes(filter, model)
    assert {name for name, refusal in found.items() if refusal is None} == works
    assert [found[asked] for asked in found if not ends(asked, found)] == []


def test_a_circle_is_seen():
    circle = {"ASmoother": "Use BSmoother.", "BSmoother": "Use ASmoother.", "CSmoother": None, "DSmoother": "Use CSmoother or ASmoother."}
    assert [asked for asked in circle if ends(asked, circle)] == ["CSmoother"]


@pytest.mark.night
def test_nodes_and_members_have_no_genealogy():
    """Nodes stay where they are, and members are moved by all others: their paths are none of the state (they were 3.6 off)."""
    for filter in (mo.PointMassFilter((-9.0, -9.0), (9.0, 9.0), (20, 20)), mo.EnsembleKalmanFilter(n=9)):
        assert "came from the ancestors they name" in outcomes(filter, linear())["GenealogySmoother"]
