"""Judgements in words."""

from collections.abc import Iterable

from motes.core import markdown
from motes.core.record import record, static


@record
class Finding:
    """One thing that a result tells of itself.

    Attributes:
        name: of one or two words, by which `Diagnosis` finds it.
        text: what was seen, with numbers and steps.
        advice: what to try.
        serious: whether estimates are not to be trusted.
    """

    name: str = static()
    text: str = static()
    advice: str = static()
    serious: bool = static()

    def __str__(self) -> str:
        """Print as one line."""
        return f"{'warning' if self.serious else 'note'}, {self.name}: {self.text} {self.advice}"


@record
class Diagnosis:
    """All findings about a result.

    Attributes:
        findings: the serious ones first.
    """

    findings: tuple[Finding, ...] = static()

    @classmethod
    def of(cls, found: Iterable[Finding | None]) -> "Diagnosis":
        """Collect what was found, the serious first."""
        return cls(tuple(sorted((one for one in found if one is not None), key=lambda finding: not finding.serious)))

    @property
    def trusted(self) -> bool:
        """Whether nothing serious was found."""
        return not any(finding.serious for finding in self.findings)

    def __contains__(self, name: str) -> bool:
        """Whether something of that name was found."""
        return any(finding.name == name for finding in self.findings)

    def __str__(self) -> str:
        """Print one finding per line."""
        return "\n".join(map(str, self.findings)) or "Nothing wrong was found."

    def _repr_markdown_(self) -> str:
        rows = [("warning" if one.serious else "note", one.name, one.text, one.advice) for one in self.findings]
        return markdown.table(("", "finding", "what was seen", "what to try"), rows) if rows else str(self)
