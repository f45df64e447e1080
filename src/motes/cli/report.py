"""`motes report STORE`: write the web page of a study from the folder that its runs are kept in; needs neither model nor filters."""

from collections.abc import Sequence
from dataclasses import dataclass, field

from motes.cli.options import first_and_flags, from_flags

USAGE = "motes report STORE"


@dataclass(frozen=True)
class Report:
    """Write the web page of a study; STORE comes first, the folder that its runs are kept in.

    Attributes:
        out: file to write.
        title: heading of the page.
    """

    out: str = field(default="report.html", metadata={"path": True})
    title: str = "Study"


def main(words: Sequence[str]) -> None:
    """Write the page and print the table.

    Raises:
        MotesError: the folder is no store or is damaged, or the page cannot be written.
    """
    folder, flags = first_and_flags(Report(), words, USAGE, "the folder of a study first", "mo.study(..., store=FOLDER) makes one.")
    settings = from_flags(Report(), flags, USAGE)
    from motes.report.html import report
    from motes.studies.result import StudyResult

    result = StudyResult.load(folder)
    page = report(result, settings.out, title=settings.title)
    print(result.table())
    print(f"The report is in {page}.")
