"""The verb that asks the contract of anyone's filter."""

from typing import Any

import jax

from motes.core import checks
from motes.filters.interface import Filter
from motes.testing.rules import RULES, asked
from motes.testing.session import Session
from motes.testing.verdict import Verdict


def check_filter(filter: Filter, model: Any = None) -> Verdict:
    """Ask of a filter what the library asks of its own: that it keeps the contract of `mo.Filter`, rule by rule.

    It needs no test runner: print what it gives, or call `raise_on_failure` of it in a test. It runs the filter many times on a few steps,
    in the engine and precision in force, which takes half a minute, nearly all of it to compile.

    Args:
        filter: the filter, with a few hundred particles.
        model: of which data are drawn, where the filter cannot run on the contract's own, which is linear-Gaussian with states named a and
            b; rules that need to know more of the model than that there is one are then left out. It takes no inputs.

    Raises:
        MotesError: the filter is none, or refuses the model.
    """
    checks.instance("check_filter filter", filter, Filter, "a filter such as ParticleFilter(n=1000)")
    session = Session(filter, model)
    try:
        jax.eval_shape(lambda: session.run(session.ys[:1]))
    except checks.MotesError:
        raise
    except Exception:  # a broken filter: the rules tell
        pass
    outcomes = [asked(rule, session) for rule in RULES]
    held = tuple(one.name for one in outcomes if one.finding is None and one.left_out is None)
    findings = tuple(one.finding for one in outcomes if one.finding is not None)
    left_out = tuple((one.name, one.left_out) for one in outcomes if one.left_out is not None)
    return Verdict(repr(filter), held, findings, left_out)
