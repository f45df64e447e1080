"""`motes plan MODULE:FUNCTION --budget 5ms`: which filter, and how many particles, for the user's own model."""

from collections.abc import Sequence
from dataclasses import dataclass

from motes.cli.compiled import keep_programs
from motes.cli.options import check_seed, seconds
from motes.cli.own import made, settings_of

USAGE = "motes plan MODULE:FUNCTION"


@dataclass(frozen=True)
class Planning:
    """Find the most accurate filter for a time per step; MODULE:FUNCTION or FILE.py:FUNCTION comes first.

    Attributes:
        application: module and function that returns the model.
        budget: time per step with its unit, such as 5ms, 200us or 0.1s.
        states: states that count, of one unit; all if none is named.
        steps: of each pilot run.
        runs: most pilot runs for one candidate.
        verify: measure the choice once more.
        seed: of the pilot runs.
    """

    application: str = ""
    budget: str = ""
    states: tuple[str, ...] = ()
    steps: int = 60
    runs: int = 32
    verify: bool = False
    seed: int = 0


def main(words: Sequence[str]) -> None:
    """Print the table of candidates and the choice.

    Raises:
        MotesError: an option or the user's function cannot be used; or no candidate fits the budget.
    """
    settings, choices = settings_of(Planning, words, USAGE)
    budget = seconds(settings.budget)
    check_seed(settings.seed)
    keep_programs()
    from motes.planning.plan import Pilot, plan

    model, given = made(settings.application, choices["folder"], None)
    pilot = Pilot(steps=settings.steps, runs=settings.runs, seed=settings.seed, inputs=given.get("inputs"))
    print(plan(model, budget, states=settings.states, verify=settings.verify, pilot=pilot))
