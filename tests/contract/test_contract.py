"""The library's own filters are asked what `mo.testing.check_filter` asks of anyone's. Filters are discovered; see discovery.py."""

import inspect
import os
from functools import lru_cache

import jax
import numpy as np
import pytest
from discovery import MAPS, PARAMETERS, example, examples, filter_classes, first_of_kinds, shares_stages, smoother_classes

import motes as mo
from motes.core.record import values
from motes.filters.interface import Filter
from motes.smoothers.interface import Smoother
from motes.testing.rules import RULES, asked
from motes.testing.session import Session

# those around other filters last
FILTERS = dict(sorted(examples().items(), key=lambda item: "filter" in values(item[1])))
CLASSES = {name for name, filter in FILTERS.items() if name == type(filter).__name__}
"""One filter of each class."""
KINDS = first_of_kinds(FILTERS)
"""One filter of each kind that the loop sees: of law, and whether it looks ahead."""
FEW = first_of_kinds(FILTERS, lambda filter: filter.look_ahead)
"""One filter that looks ahead, and one that does not."""
OWN = {name for name in CLASSES if not shares_stages(name)}
SMALL = KINDS - {"Distributed", "PaRIS"}
"""Of these without those that compile longest."""
BY_DAY = {"answers": OWN, "form": CLASSES, "value": set(FILTERS), "likelihood": SMALL,
          **dict.fromkeys(("missing", "weights", "fewest"), SMALL),
          "stream": KINDS | {"ParticleFilter"}, **dict.fromkeys(("checkpoint", "cut"), FEW | {"ParticleFilter", "PointMassFilter"}),
          **dict.fromkeys(("unmeasured", "vmapped", "inflation", "smallest", "eager", "derivative"), FEW)}  # fmt: skip
"""Filters that are asked a rule by day, all others being asked by night; of rules not named here, those of `CLASSES`."""
FUSED = {"ParticleFilter", "MarginalizedParticleFilter", "RegularizedParticleFilter", "KalmanParticleKernelFilter"}
"""Filters whose stages are native kernels; between such kernels the others run the same programs whatever the engine is called."""
NATIVE = os.environ.get("MOTES_ENGINE") == "native"
ONE_STATE = {"lower": (-9.0,), "upper": (9.0,), "nodes": (60,), "size": 1, "widths": (0.5,),
             "fresh": lambda key, y, u, t: 1.5 * jax.random.normal(key, (1,))}  # fmt: skip
"""Parameters in place of those for two states."""


def questions():
    """Each rule with each filter in both precisions, marked with when it is asked, and of which engines."""
    for rule in RULES:
        name_of_rule, day = rule.ask.__name__, BY_DAY.get(rule.ask.__name__, CLASSES - {"Adapting", "AdaptiveSize", "Distributed"})
        for name, filter in FILTERS.items():
            for precision in ("float32", "float64"):
                # that laws have their form in both is a rule of its own
                late = name not in day or precision == "float64" or (NATIVE and rule.exact and name not in FUSED)
                # the native engine works in single precision, on clouds
                jax_alone = precision == "float64" or "n" not in values(filter)
                marks = [*[pytest.mark.night] * late, *[pytest.mark.jax] * jax_alone, *[pytest.mark.optimized] * rule.exact]
                yield pytest.param(rule, filter, precision, id=f"{name_of_rule}-{precision}-{name}", marks=marks)


@lru_cache(maxsize=4)
def session(filter, precision):
    """What has been compiled and computed of a filter; the tests of one filter come one after another."""
    return Session(filter)


def on_one_state(filter):
    """The same filter of one state, where its parameters are for two."""
    return example(type(filter), **{name: value for name, value in ONE_STATE.items() if name in values(filter)})


@pytest.mark.parametrize(("rule", "filter", "precision"), list(questions()), indirect=["precision"])
def test_filter_keeps_the_contract(rule, filter, precision):
    filter = on_one_state(filter) if rule.ask.__name__ == "smallest" else filter
    outcome = asked(rule, session(filter, precision))
    assert outcome.finding is None, str(outcome.finding)
    assert outcome.left_out is None or may_be_left_out(rule, filter), outcome.left_out


def may_be_left_out(rule, filter):
    """Whether a rule need not apply to a filter: a rule that left out more would hide what it does not ask."""
    name = rule.ask.__name__
    if name in ("likelihood", "derivative", "collapse", "inflation"):
        return not filter.has_evidence
    if name == "fewest":
        return "n" not in values(filter)
    weighed = (mo.ParticleFilter, mo.PointMassFilter, mo.AuxiliaryParticleFilter, mo.RegularizedParticleFilter, mo.GaussianParticleFilter)
    return name == "weights" and not isinstance(filter, (*weighed, mo.smoothers.PaRIS))


def test_every_filter_and_smoother_is_found_and_documented():
    found = filter_classes() | smoother_classes()
    public = [getattr(room, name) for room in (mo, mo.smoothers) for name in room.__all__]
    classes = [one for one in public if isinstance(one, type) and not inspect.isabstract(one)]
    kinds = {one.__name__ for one in classes if issubclass(one, (Filter, Smoother))}
    assert kinds == (set(found) | {MAPS}) - {"SkeletonFilter"}
    assert all(cls.__doc__ for cls in found.values())
    assert all(cls.__module__ and all(cls.guide) for cls in filter_classes().values())
    assert CLASSES == set(filter_classes())


def test_what_is_asked_by_day_names_rules():
    assert set(BY_DAY) <= {rule.ask.__name__ for rule in RULES}
    assert {type(FILTERS[name]) for name in KINDS} >= {mo.smoothers.PaRIS, mo.PointMassFilter, mo.MarginalizedParticleFilter}


@pytest.mark.optimized
def test_run_in_chunks_is_the_whole_run():
    asked_of = session(example(mo.ParticleFilter), "float32")
    pieces = list(mo.filters.run_in_chunks(3, asked_of.filter, asked_of.model, asked_of.gappy[:12], chunk=6))
    assert np.array_equal(mo.filters.joined(pieces).mean, asked_of.whole.mean)


@pytest.mark.parametrize("filter", [mo.KalmanFilter(), mo.ParticleFilter(n=PARAMETERS["n"])], ids=lambda filter: type(filter).__name__)
def test_run_and_stream_raise_on_collapse(filter):
    known = session(filter, "float32")
    ys = known.ys.copy()
    ys[3] += 1e6
    with pytest.raises(mo.CollapseError, match=r"step 3: (all weights vanished: log likelihoods between -.* and -|the innovation lies)"):
        mo.run(2, filter, known.model, ys)
    stream = mo.stream(2, filter, known.model)
    stream.update(ys[0])
    for y in ys[1:3]:
        stream.predict()
        stream.update(y)
    stream.predict()
    with pytest.raises(mo.CollapseError, match="step 3"):
        stream.update(ys[3])


@pytest.mark.parametrize("name", [name for name, filter in FILTERS.items() if not filter.has_evidence])
def test_a_filter_without_a_likelihood_refuses_to_tell_one(name):
    known = session(FILTERS[name], "float32")
    shapes = jax.eval_shape(lambda: known.run(known.ys))
    for told in (shapes, known.stream()):
        with pytest.raises(mo.MotesError, match="log_likelihood: expected a filter with a likelihood"):
            _ = told.log_likelihood
