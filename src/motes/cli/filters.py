"""The filter that a user names, as settings and as a record."""

import importlib
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from motes.cli.options import refuse

if TYPE_CHECKING:
    from motes.filters.interface import Filter

KINDS = {
    "marginalized": ("motes.filters.marginalized", "MarginalizedParticleFilter"),
    "particle": ("motes.filters.particle", "ParticleFilter"),
    "kernel": ("motes.filters.kernel", "KalmanParticleKernelFilter"),
    "regularized": ("motes.filters.regularized", "RegularizedParticleFilter"),
}
"""Word for a filter to its module and record; imported when asked for, since that brings JAX."""
POLICIES = {"ess": "ESS", "entropy": "Entropy", "always": "Always", "never": "Never"}
MOST = 50_000_000
"""More particles than any machine that this runs on holds; a slip of the keyboard should not exhaust its memory."""


@dataclass(frozen=True)
class FilterChoice:
    """The filter.

    Attributes:
        kind: "marginalized", "particle", "kernel" or "regularized".
        n: number of particles.
        linear: states that a Kalman filter carries, by name; all that can be if none is named. Marginalized only.
        policy: when to resample: "ess", "entropy", "always" or "never"; the filter's own rule if not given.
        threshold: of the policies ess (share of n) and entropy (nats), the filter's own rule being one of them; its own if not given.
    """

    kind: str = "marginalized"
    n: int = 15_000
    linear: tuple[str, ...] = ()
    policy: str | None = None
    threshold: float | None = None


def build(choice: FilterChoice) -> "Filter":
    """Return the filter that the settings describe.

    Raises:
        MotesError: a word is unknown, or a number cannot be used.
    """
    for name, given, known in (("kind", choice.kind, KINDS), ("policy", choice.policy, POLICIES)):
        if given is not None and given not in known:
            refuse(f"filter {name}", "one of " + ", ".join(map(repr, known)), repr(given))
    if choice.n > MOST:
        refuse("filter n", f"at most {MOST} particles", choice.n)
    options: dict[str, Any] = {}
    if choice.linear:
        if choice.kind != "marginalized":
            refuse("filter linear", "no states, since only a marginalized filter takes them", list(choice.linear))
        options["linear"] = choice.linear
    if choice.threshold is not None and choice.policy not in (None, "ess", "entropy"):
        refuse("filter threshold", f"none with the policy {choice.policy!r}", choice.threshold)
    module, record = KINDS[choice.kind]
    filter = getattr(importlib.import_module(module), record)(n=choice.n, **options)
    if choice.policy is None and choice.threshold is None:
        return filter
    rule = getattr(importlib.import_module("motes.resampling.policy"), POLICIES[choice.policy]) if choice.policy else type(filter.policy)
    policy = rule() if choice.threshold is None else rule(choice.threshold)
    return importlib.import_module("motes.core.record").replace(filter, policy=policy)
