"""`motes report STORE`: write the web page of a study from the folder that its runs are kept in; needs neither model nor filters."""

from collections.abc import Sequence
from dataclasses import dataclass

from motes.cli.options import from_flags, refuse

USAGE = "motes report STORE"


@dataclass(frozen=True)
class Report:
    """Write the web page of a study; STORE comes first, the folder that its runs are kept in.

    Attributes:
        out: file to write.
        title: heading of the page.
    """

    out: str = "report.html"
    title: str = "Study"


def main(words: Sequence[str]) -> None:
    """Write the page and print the table.

    Raises:
        MotesError: the folder is no store or is damaged, or the page cannot be written.
    """
    if words and words[0].startswith("-"):
        from_flags(Report(), words, USAGE)
    if not words or words[0].startswith("-"):
        refuse(USAGE, "the folder of a study first", " ".join(words) or "nothing", "mo.study(..., store=FOLDER) makes one.")
    settings = from_flags(Report(), words[1:], USAGE)
    from motes.report.html import report
    from motes.studies.result import StudyResult

    result = StudyResult.load(words[0])
    page = report(result, settings.out, title=settings.title)
    print(result.table())
    print(f"The report is in {page}.")
