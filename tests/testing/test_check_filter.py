"""`mo.testing.check_filter` passes what keeps the contract, and sees for each rule a filter that breaks it."""

import jax.numpy as jnp
import pytest
from broken_filters import BROKEN
from example_filter import TextbookFilter
from example_wrapper import Remembering

import motes as mo
from motes.testing.rules import RULES, asked
from motes.testing.session import Session
from motes.testing.verdict import Verdict
from tiers import each

WORDS = {
    "value": "is not refused", "form": "holds numbers of float32", "answers": "covariance of 40 000 draws", "stream": "differ from step 1",
    "unmeasured": "predicts", "cut": "differ in", "checkpoint": "is raised", "compiled_once": "an equal filter", "vmapped": "is off by",
    "eager": "the means differ", "missing": "of 3 measured", "likelihood": "times the exact one", "derivative": "not finite",
    "outlier": "not step 3 alone", "collapse": "nobody is told", "inflation": "variances", "weights": "as collapsed",
    "fewest": "means are not finite", "smallest": "is raised",
}  # fmt: skip
"""What the finding of each rule says of the broken filter."""


@pytest.mark.parametrize("rule", each({rule.ask.__name__: rule for rule in RULES}, {"eager"}))
def test_each_rule_sees_a_filter_that_breaks_it(rule):
    name = rule.ask.__name__
    outcome = asked(rule, Session(BROKEN[name]))
    assert outcome.finding is not None, outcome
    assert WORDS[name] in outcome.finding.text, outcome.finding.text


@pytest.mark.optimized
@pytest.mark.night
def test_a_filter_of_ones_own_is_asked_everything_that_applies():
    verdict = mo.testing.check_filter(TextbookFilter())
    verdict.raise_on_failure()
    assert verdict.passed and len(verdict.held) == len(RULES) - 2
    assert {reason for _, reason in verdict.left_out} == {"the filter weighs nothing.", "the filter has no n."}


@pytest.mark.optimized
@pytest.mark.night
def test_a_wrapper_of_ones_own_is_one_file():
    mo.testing.check_filter(Remembering(mo.ParticleFilter(n=200))).raise_on_failure()


def test_a_wrapper_of_ones_own_runs():
    model = mo.textbook.constant_velocity()
    ys = mo.simulate(0, model, 6)[1]
    history = mo.run(1, Remembering(mo.ParticleFilter(n=200)), model, ys)
    assert jnp.array_equal(history.mean, mo.run(1, mo.ParticleFilter(n=200), model, ys).mean) and history.last.state.beside != 0


def test_a_verdict_tells_rule_by_rule_and_raises():
    broken = asked(RULES[0], Session(BROKEN["value"]))
    verdict = Verdict("AnyPolicy()", ("another",), (broken.finding,), (("a third", "no reason."),))
    lines = str(verdict).splitlines()
    assert lines[0] == "AnyPolicy(): 1 rules hold, 1 broken, 1 left out"
    assert lines[1].startswith("  broken    the filter is a value: on_collapse='ignore' is not refused.")
    assert lines[2:] == ["  holds     another", "  left out  a third: no reason."]
    with pytest.raises(AssertionError, match="1 broken"):
        verdict.raise_on_failure()


def test_refusals():
    with pytest.raises(mo.MotesError, match="check_filter filter: expected a filter such as"):
        mo.testing.check_filter(mo.laws.Cloud)
    bent = mo.StateSpaceModel(mo.Gaussian([0.0], [[1.0]]), mo.AdditiveGaussian(lambda x, u, t: jnp.sin(x), [[1.0]]),
                              mo.LinearGaussian([[1.0]], [[1.0]]))  # fmt: skip
    with pytest.raises(mo.MotesError, match="TextbookFilter model: expected matrices"):
        mo.testing.check_filter(TextbookFilter(), bent)


def test_on_a_model_of_ones_own_rules_ask_what_they_can_know():
    tilt = mo.StateSpaceModel(mo.Gaussian([1.0], [[2.0]]), mo.LinearGaussian([[0.9]], [[0.4]]), mo.LinearGaussian([[1.5]], [[0.3]]))
    session = Session(TextbookFilter(), tilt)
    short = [rule for rule in RULES if not rule.exact and rule.ask.__name__ not in ("eager", "derivative", "vmapped")]
    outcomes = {rule.ask.__name__: asked(rule, session) for rule in short}
    assert {name for name, one in outcomes.items() if one.left_out} == {"missing", "likelihood", "weights", "fewest", "smallest"}
    assert [one.finding for one in outcomes.values() if one.finding] == []
