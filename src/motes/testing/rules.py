"""What every filter must do, whatever its method, in plain words: what is asked, and where to look when it is not so."""

from collections.abc import Callable
from typing import NamedTuple

from motes.core.findings import Finding
from motes.testing import laws, loops, measurements
from motes.testing.session import DoesNotApply, Session

_KEYS = "Derive each key from that of the step by motes.core.random.child, and keep nothing outside of the law."
_LAW = "What is needed to go on belongs to the law."
_STAGES = "Leave `step` to TwoStageFilter, which keeps the two stages apart."
_ACCEPT = "Let `correct` say what it found, and leave what follows of it to `accept` of the base class."


class Rule(NamedTuple):
    """One rule.

    Attributes:
        name: what holds, in plain words.
        ask: gives what is wrong, or None.
        advice: where to look when it does not hold.
        exact: whether it compares bits of programs compiled apart, for which compilers must not be told to be quick.
    """

    name: str
    ask: Callable[[Session], str | None]
    advice: str
    exact: bool = False


class Outcome(NamedTuple):
    """What came of a rule.

    Attributes:
        name: of the rule.
        finding: what is wrong; None where it holds, or does not apply.
        left_out: why it does not apply; None where it does.
    """

    name: str
    finding: Finding | None = None
    left_out: str | None = None


RULES = (
    Rule("the filter is a value", laws.value, "Make the class a record, and its parameters fields."),
    Rule("its law keeps its form, in both precisions", laws.form, "Make arrays in the type of the model's; shapes never change."),
    Rule("its law answers mean, covariance and draws", laws.answers, "Look at `mean`, `cov` and `sample` of the law."),
    Rule("a stream draws the numbers of a run, to the bit", loops.stream, f"{_KEYS} {_STAGES}", exact=True),
    Rule("a step without a measurement only predicts, to the bit", loops.unmeasured, f"{_ACCEPT} {_STAGES}", exact=True),
    Rule("a run that is continued goes on as if uncut, to the bit", loops.cut, f"{_KEYS} {_LAW}", exact=True),
    Rule("a stream saved and loaded goes on, to the bit", loops.checkpoint, _LAW, exact=True),
    Rule("a second run of the same kind compiles nothing", loops.compiled_once,
         "Parameters must be equal and hash alike: no arrays in static fields, no functions made anew."),
    Rule("runs under vmap give what they give alone", loops.vmapped, "Look for shapes taken from a batch, and for what runs share."),
    Rule("it computes without jit what it computes with it", loops.eager, "Look for Python code that asks whether numbers are known."),
    Rule("missing components are as if they were never measured", measurements.missing,
         "Leave NaN components of y out of the update, and of its determinants."),
    Rule("its likelihood is that of the Kalman filter", measurements.likelihood,
         "Look at constants and determinants; set has_evidence = False where what it sums is no likelihood."),
    Rule("its likelihood can be differentiated", measurements.derivative,
         "Look for square roots, logarithms and divisions at 0, also where `where` hides them."),
    Rule("it survives an outlier", measurements.outlier, _ACCEPT),
    Rule("a collapse is told of with its step", measurements.collapse, _ACCEPT),
    Rule("a collapse can be answered by inflating", measurements.inflation, "Look at `inflated` of the law."),
    Rule("weights that are none are not used in silence", measurements.weights,
         "Weigh by `update_weights` (motes.filters.clouds), which sees to it."),
    Rule("it works with one particle", measurements.fewest, "Look for divisions by n - 1, and for shapes that are 0."),
    Rule("it works on one state, with three particles", measurements.smallest, "Look for shapes that are 1 and broadcast."),
)  # fmt: skip
"""All rules."""


def asked(rule: Rule, session: Session) -> Outcome:
    """Ask a rule; whatever is raised on the way is a finding."""
    try:
        wrong = rule.ask(session)
    except DoesNotApply as reason:
        return Outcome(rule.name, left_out=str(reason))
    except Exception as error:
        wrong = f"{type(error).__name__} is raised: {' '.join(str(error).split()):.300}"
    return Outcome(rule.name, None if wrong is None else Finding(rule.name, wrong, rule.advice, True))
