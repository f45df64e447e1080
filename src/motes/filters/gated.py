"""Filters that leave out measurements too far off their prediction: every one that keeps Gaussians, since its claims are chi-square."""

from motes.core.record import record, static


@record
class Gated:
    """What a filter with a gate has; `Filter` checks the gate and applies it.

    Attributes:
        gate: share of measurements that lie inside the gate where the filter's claims are right, such as 0.9999; one outside is not used,
            and counts in `info.gated`. None for no gate.
    """

    gate: float | None = static(default=None, kw_only=True)
