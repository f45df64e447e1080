"""`motes study APPLICATION --filters.a particle --filters.a.n 500 --filters.b marginalized`: compare filters on simulated runs.

The runs are kept in the folder `--out`: a study that was stopped goes on where it was, and more runs or filters can be added. Writes
`table.csv`, `study.png` and `report.html` beside them. With `--scheduler` the workers of a Dask cluster do the runs.
"""

import shlex
from collections.abc import Sequence
from contextlib import nullcontext
from typing import TYPE_CHECKING

from motes.cli import interruption
from motes.cli.asked import Asked, Study, asked
from motes.cli.options import check_seed, refuse

if TYPE_CHECKING:
    from motes.studies.experiment import Experiment

USAGE = "motes study APPLICATION"
STEPS = 100


def main(words: Sequence[str]) -> None:
    """Run the study, or go on with it.

    Raises:
        MotesError: an option, a file or the user's function cannot be used, or the folder holds another study.
    """
    wish = asked(Study, words, USAGE)
    settings = wish.settings
    check_seed(settings.seed)

    from motes.cli import running
    from motes.io.files import label
    from motes.plotting.plot import plot
    from motes.report.html import report
    from motes.studies.executors import client
    from motes.studies.run import study

    wish.chosen("filters", "filter")
    running.check_written()
    running.check_folder(settings.out)
    # workers make the experiment themselves, from the same words
    source = shlex.join([f"{__name__}:experiment", *words]) if settings.scheduler else _experiment(wish)
    with client(settings.scheduler) if settings.scheduler else nullcontext() as executor:
        folder = running.made_folder(settings.out)
        interruption.keeps(label(folder))
        result = study(source, store=folder / "runs", executor=executor)
    table = result.table()
    running.show("", table.columns, table.texts())
    table.save(folder / "table.csv")
    running.write_figure(folder / "study.png", plot(result))
    report(result, folder / "report.html")
    print(f"Results are in {folder}.")


def experiment(*words: str) -> "Experiment":
    """Return the experiment that the command is asked for.

    Raises:
        MotesError: what `main` raises.
    """
    return _experiment(asked(Study, words, USAGE))


def _experiment(wish: Asked) -> "Experiment":
    import jax

    from motes.core.checks import positive_integer
    from motes.studies.experiment import Experiment

    settings, job = wish.settings, wish.job()
    filters = wish.filters(job, "filters", "filter")
    if settings.steps is not None:
        positive_integer("steps", settings.steps)
    there = {leaf.shape[0] for leaf in jax.tree.leaves(job.inputs)}
    steps = settings.steps or min(there, default=STEPS)
    if there and steps > min(there):
        refuse("steps", f"at most {min(there)}, as many as there are inputs", steps)
    inputs = jax.tree.map(lambda leaf: leaf[:steps], job.inputs)
    return Experiment(job.simulated(), filters, steps, settings.runs, settings.seed, inputs, blocks=job.blocks, lost=job.lost)
