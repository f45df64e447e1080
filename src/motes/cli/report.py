"""`motes report WHAT`: the web page of a study, from the folder that its runs are kept in, or of a run, from its file; needs no model."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from motes.cli.options import first_and_flags, from_flags

USAGE = "motes report WHAT"


@dataclass(frozen=True)
class Report:
    """Write the web page of a study or a run; WHAT comes first, the folder of the study's runs or the file (.npz) of the run's history.

    Attributes:
        out: file to write.
        title: heading of the page; "Study" or "Run" if not given.
    """

    out: str = field(default="report.html", metadata={"path": True})
    title: str = ""


def main(words: Sequence[str]) -> None:
    """Write the page and print the table.

    Raises:
        MotesError: the folder is no store, the file no history, or damaged, or the page cannot be written.
    """
    what, flags = first_and_flags(Report(), words, USAGE, "the folder of a study or the file of a run first",
                                  "mo.study(..., store=FOLDER) makes one, motes run the other.")  # fmt: skip
    settings = from_flags(Report(), flags, USAGE)
    from motes.filters.history import History
    from motes.report.html import report
    from motes.studies.result import StudyResult

    result = History.load(what) if Path(what).suffix == ".npz" else StudyResult.load(what)
    page = report(result, settings.out, title=settings.title)
    print(result if isinstance(result, History) else result.table())
    print(f"The report is in {page}.")
