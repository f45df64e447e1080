"""Measurements that come late: what is needed to go back some steps, and to come again to where one was."""

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from motes.core import checks
from motes.core.packed import Packed
from motes.laws.observed import Observed


@dataclass
class Past:
    """The last steps of a stream.

    Attributes:
        lag: how many steps before the present one are kept.
        steps: of each kept step, the present one last: what the step before it handed on (None before step 0), its inputs, its measurement.
        begin: number of the first of them.
    """

    lag: int
    steps: deque[tuple[Packed | None, Any, Any]] = field(default_factory=deque)
    begin: int = 0

    def __post_init__(self) -> None:
        """Refuse a lag that is no whole number of at least 0."""
        checks.natural("stream lag", self.lag)

    def opened(self, before: Packed | None, u: Any, y: Any) -> None:
        """Note that a step has begun."""
        self.steps.append((before, u, y))
        while len(self.steps) > self.lag + 1:
            self.steps.popleft()
            self.begin += 1

    def measured(self, y: Any) -> None:
        """Note the measurement of the present step."""
        if self.steps:  # not so right after a checkpoint was read
            before, u, _ = self.steps[-1]
            self.steps[-1] = (before, u, y)

    def taken_back(self, steps: Any) -> Packed | None:
        """Take the last steps off, and return what the step before them handed on; None before step 0.

        Raises:
            MotesError: so many are not kept.
        """
        most = min(len(self.steps), self.lag)
        if steps not in range(1, most + 1):
            checks.refuse("back steps", f"at most {most}, which are kept", steps, "Start the stream with a larger lag=.")
        return [self.steps.pop()[0] for _ in range(steps)][-1]

    def before(self, steps: Any) -> Packed:
        """Return what was handed on to the last steps.

        Raises:
            MotesError: so many are not kept, or nothing was measured then.
        """
        found = self.steps[-steps][0] if steps in range(1, len(self.steps) + 1) else None
        if found is None:
            checks.refuse("save back", f"at most {max(0, len(self.steps) - 1)} steps, which are kept", steps)
        return found

    def place(self, t: Any) -> int:
        """Return the place of a step among those kept.

        Raises:
            MotesError: it is not among them.
        """
        last = self.begin + len(self.steps) - 1
        if isinstance(t, bool) or not isinstance(t, (int, np.integer)) or not self.begin <= t <= last:
            hint = "Start the stream with a larger lag=." if isinstance(t, (int, np.integer)) and t < self.begin else ""
            checks.refuse("insert t", f"one of the steps {self.begin} to {last}" if self.steps else "a step that has begun", t, hint)
        return int(t) - self.begin


def joined_measurement(there: Any, y: Any) -> Any:
    """Return the measurement of a step with what came late.

    Raises:
        MotesError: what came late had been measured already.
    """
    if there is None:
        return y

    def one(old: Any, new: Any) -> Any:
        both = ~np.isnan(old) & ~np.isnan(new)
        if np.any(both):
            checks.refuse("insert y", "what was not measured at that step", f"component {np.argwhere(both)[0].tolist()}, which was")
        return np.where(np.isnan(old), new, old).astype(old.dtype)

    if isinstance(there, Observed):
        if not bool(there.there):
            return y
        if not bool(y.there):
            return there
        if isinstance(there.value, Mapping) and set(there.value) == set(y.value):
            # of several sensors each may come at its own time
            found = {name: joined_measurement(own, y.value[name]) for name, own in there.value.items()}
            return Observed(found, np.ones((), bool))
        leaves = jax.tree.leaves(there.value)
        if not all(jnp.issubdtype(leaf.dtype, jnp.floating) for leaf in leaves):
            checks.refuse("insert y", "a step without a measurement", "one that has one")
        return Observed(jax.tree.map(lambda a, b: one(np.asarray(a), np.asarray(b)), there.value, y.value), np.ones((), bool))
    return one(np.asarray(there), np.asarray(y))

