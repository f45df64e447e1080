"""`motes study MODULE:FUNCTION --filters.a particle --filters.a.n 500 --filters.b marginalized`: compare filters on simulated runs.

In place of MODULE:FUNCTION a TOML file may come that has it as `application`, with a table [filters.NAME] for each filter. The runs are
kept in the folder `--out`: a study that was stopped goes on where it was, and more runs or filters can be added. Writes `table.csv`,
`study.png` and `report.html` beside it.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

from motes.cli.compiled import keep_programs
from motes.cli.options import check_seed, refuse
from motes.cli.own import is_own, made, settings_of
from motes.cli.records import build

USAGE = "motes study MODULE:FUNCTION"


@dataclass(frozen=True)
class Study:
    """Compare filters on simulated runs of your own model; MODULE:FUNCTION or FILE.py:FUNCTION comes first, or a TOML file.

    `--filters.a particle --filters.a.n 500` names a filter "a" and chooses it with its parameters.

    Attributes:
        application: module and function that returns the model.
        steps: of each run.
        runs: how many.
        seed: of all runs.
        out: folder in which runs and results are kept.
    """

    application: str = ""
    steps: int = 100
    runs: int = 100
    seed: int = 0
    out: str = field(default="study", metadata={"path": True})


def main(words: Sequence[str]) -> None:
    """Run the study, or go on with it.

    Raises:
        MotesError: an option or the user's function cannot be used, or the folder holds another study.
    """
    if not is_own(words):
        from motes.cli.options import first_and_flags

        first_and_flags(Study(), words, USAGE, "MODULE:FUNCTION or a TOML file first", "The function returns the model.")
        refuse("arguments", "MODULE:FUNCTION, FILE.py:FUNCTION, or a TOML file with application = one of them", repr(words[0])[:120])
    settings, choices = settings_of(Study, words, USAGE)
    check_seed(settings.seed)
    named = choices.get("filters")
    if not isinstance(named, dict) or not named:
        refuse("filters", "at least one filter by a name of its own", "none", "Give --filters.a particle --filters.a.n 1000.")
    keep_programs()
    from motes.cli import running
    from motes.filters.interface import Filter
    from motes.plotting.plot import plot
    from motes.report.html import report
    from motes.studies.experiment import Experiment
    from motes.studies.run import study

    filters = {name: build(Filter, choice, f"filters.{name}") for name, choice in named.items()}
    running.check_folder(settings.out)
    model, given = made(settings.application, choices["folder"], None)
    folder = running.made_folder(settings.out)
    experiment = Experiment(model, filters, settings.steps, settings.runs, settings.seed, given.get("inputs"))
    result = study(experiment, store=folder / "runs")
    table = result.table()
    print(table)
    table.save(folder / "table.csv")
    running.write_figure(folder / "study.png", plot(result))
    report(result, folder / "report.html")
    print(f"Results are in {folder}.")
