"""`motes plan APPLICATION --budget 5ms`: which filter, which states in its Kalman part, and how many particles.

Of the measurements nothing is used but the inputs, along which pilot runs are drawn.
"""

from collections.abc import Sequence

from motes.cli.asked import Plan, asked
from motes.cli.options import check_seed, seconds

USAGE = "motes plan APPLICATION"


def main(words: Sequence[str]) -> None:
    """Print the table of candidates and the choice.

    Raises:
        MotesError: an option, a file or the user's function cannot be used; or no candidate fits the budget.
    """
    wish = asked(Plan, words, USAGE)
    settings = wish.settings
    budget = seconds(settings.budget)
    check_seed(settings.seed)
    import jax

    from motes.planning.plan import Pilot, plan

    job = wish.job()
    inputs = jax.tree.map(lambda leaf: leaf[: settings.steps], job.inputs)
    pilot = Pilot(steps=settings.steps, runs=settings.runs, seed=settings.seed, inputs=inputs)
    print(plan(job.simulated(), budget, states=settings.states or job.counted, verify=settings.verify, pilot=pilot))
