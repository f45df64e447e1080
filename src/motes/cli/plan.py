"""`motes plan CONFIG.toml --budget 5ms`: which filter, which states in its Kalman part, and how many particles, for the user's own flight.

The TOML file is that of `motes run`; of its measurements only the inertial track is used, along which pilot flights are drawn.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from motes.cli.compiled import keep_programs
from motes.cli.options import check_seed, from_file_and_flags, seconds
from motes.cli.own import is_own
from motes.cli.run import Config

USAGE = "motes plan CONFIG.toml"


@dataclass(frozen=True)
class Planning(Config):
    """Find the most accurate filter for a time per fix; CONFIG.toml comes first, flags change single keys of it.

    Attributes:
        budget: time per fix with its unit, such as 5ms, 200us or 0.1s.
        states: states that count, of one unit.
        fixes: how many of the first fixes to plan on.
        runs: most pilot flights for one candidate.
        verify: measure the choice once more.
    """

    budget: str = ""
    states: tuple[str, ...] = ("rN", "rE")
    fixes: int = 100
    runs: int = 32
    verify: bool = False


def main(words: Sequence[str]) -> None:
    """Print the table of candidates and the choice.

    Raises:
        MotesError: the file, what it names, or an option cannot be used; or no candidate fits the budget.
    """
    if is_own(words):
        from motes.cli import plan_own

        return plan_own.main(words)
    config = from_file_and_flags(Planning, words, USAGE)
    budget = seconds(config.budget)
    check_seed(config.seed)
    keep_programs()
    import jax

    from motes.applications.terrain_navigation import scenario
    from motes.planning.plan import Pilot, plan

    flight = scenario.load(config.map, config.data, config.noises, config.prior, config.inertial)
    inputs = jax.tree.map(lambda leaf: leaf[: config.fixes], flight.inputs)
    print(plan(flight.model, budget, states=config.states, verify=config.verify,
               pilot=Pilot(runs=config.runs, seed=config.seed, inputs=inputs)))
