"""What the contract makes of a filter."""

from motes.core.findings import Finding
from motes.core.record import record, static


@record
class Verdict:
    """What the contract makes of a filter; it prints one line for each rule.

    Attributes:
        filter: the filter, as it prints.
        held: rules that hold.
        findings: one for each rule that does not: its name, what was seen, where to look.
        left_out: rules that do not apply, each with the reason.
    """

    filter: str = static()
    held: tuple[str, ...] = static()
    findings: tuple[Finding, ...] = static()
    left_out: tuple[tuple[str, str], ...] = static()

    @property
    def passed(self) -> bool:
        """Whether no rule was found broken."""
        return not self.findings

    def raise_on_failure(self) -> None:
        """Raise where a rule is broken.

        Raises:
            AssertionError: its message is the whole verdict.
        """
        if self.findings:
            raise AssertionError(str(self))

    def __str__(self) -> str:
        """Print one line for each rule, the broken ones first."""
        counts = f"{len(self.held)} rules hold, {len(self.findings)} broken, {len(self.left_out)} left out"
        broken = [f"  broken    {one.name}: {one.text} {one.advice}" for one in self.findings]
        held = [f"  holds     {name}" for name in self.held]
        left_out = [f"  left out  {name}: {reason}" for name, reason in self.left_out]
        return "\n".join([f"{self.filter}: {counts}", *broken, *held, *left_out])
