"""`motes study APPLICATION --filters.a particle --filters.a.n 500 --filters.b marginalized`: compare filters on simulated runs.

The runs are kept in the folder `--out`: a study that was stopped goes on where it was, and more runs or filters can be added. Writes
`table.csv`, `study.png` and `report.html` beside them.
"""

from collections.abc import Sequence

from motes.cli import interruption
from motes.cli.asked import Study, asked
from motes.cli.options import check_seed, refuse

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
    import jax

    from motes.cli import running
    from motes.core.checks import positive_integer
    from motes.io.files import label
    from motes.plotting.plot import plot
    from motes.report.html import report
    from motes.studies.experiment import Experiment
    from motes.studies.run import study

    wish.chosen("filters", "filter")
    running.check_written()
    running.check_folder(settings.out)
    job = wish.job()
    filters = wish.filters(job, "filters", "filter")
    if settings.steps is not None:
        positive_integer("steps", settings.steps)
    there = {leaf.shape[0] for leaf in jax.tree.leaves(job.inputs)}
    steps = settings.steps or min(there, default=STEPS)
    if there and steps > min(there):
        refuse("steps", f"at most {min(there)}, as many as there are inputs", steps)
    inputs = jax.tree.map(lambda leaf: leaf[:steps], job.inputs)
    experiment = Experiment(job.simulated(), filters, steps, settings.runs, settings.seed, inputs, blocks=job.blocks, lost=job.lost)
    folder = running.made_folder(settings.out)
    interruption.keeps(label(folder))
    result = study(experiment, store=folder / "runs")
    table = result.table()
    running.show("", table.columns, table.texts())
    table.save(folder / "table.csv")
    running.write_figure(folder / "study.png", plot(result))
    report(result, folder / "report.html")
    print(f"Results are in {folder}.")
