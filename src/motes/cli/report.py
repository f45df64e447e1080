"""`motes report STORE`: write the web page of a study from the folder that its runs are kept in; needs neither model nor filters."""

from collections.abc import Sequence
from dataclasses import dataclass, field

from motes.cli.options import from_flags, refuse, shown

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
    if words and words[0].startswith("-"):
        from_flags(Report(), words, USAGE)
    if not words or words[0].startswith("-"):
        given = shown(" ".join(words)) if words else "nothing"
        refuse("arguments", "the folder of a study first", given, "mo.study(..., store=FOLDER) makes one.")
    settings = from_flags(Report(), words[1:], USAGE)
    from motes.report.html import report
    from motes.studies.result import StudyResult

    result = StudyResult.load(words[0])
    page = report(result, settings.out, title=settings.title)
    print(result.table())
    print(f"The report is in {page}.")
