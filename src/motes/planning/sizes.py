"""How many particles of each candidate fit a budget: a line through measured times, drawn where the answer lies."""

from typing import Any, NamedTuple

import jax

from motes.core import checks
from motes.core.progress import tracked
from motes.core.types import Inputs
from motes.costs.calibration import Calibration
from motes.costs.flops import complexity
from motes.costs.measure import SPAN, StepTime, least_seconds, whole_run
from motes.filters.data import steps_of
from motes.filters.interface import Filter
from motes.filters.marginalized import MarginalizedParticleFilter
from motes.filters.particle import ParticleFilter
from motes.models.split import split
from motes.planning.candidates import Candidate

FIRST, FEWEST, MOST = 1_000, 32, 20_000_000
"""Particles of the first measurement, and the range to plan in."""
LANES = 16
"""Numbers of particles are multiples of this where they can be: with odd ones compiled steps take up to half as long again."""
NEAR = 0.3
"""A measurement within this share of the budget is near enough to draw the line through; each one compiles."""
ATTEMPTS = 5
REPEATS = 3
LONG = 2.0
"""Seconds over which what was chosen is measured: longer than a neighbor on the machine usually disturbs."""


class Sized(NamedTuple):
    """A filter that can be used, and its cost.

    Attributes:
        filter: with its number of particles.
        seconds: of a step, predicted by the line through measured times.
        by_flops: the same by the paper's count of equivalent flops; None where that does not apply.
    """

    filter: Filter
    seconds: float
    by_flops: float | None


class Clock(NamedTuple):
    """What candidates are timed on.

    Attributes:
        model: their model.
        ys: measurements `(t, y)`.
        inputs: of the model, time axis first.
        costs: constants for the count of flops.
        progress: whether to draw a progress bar on the error stream; where that is a terminal, if not given.
    """

    model: Any
    ys: Any
    inputs: Inputs
    costs: Calibration
    progress: bool | None

    def seconds(self, candidate: Candidate, span: float = SPAN) -> float:
        """Measure a step of a candidate as it is, with its share of what happens once a run: to take that out, each would compile twice."""
        return least_seconds(whole_run(candidate.filter, self.model, self.ys, self.inputs), REPEATS, span) / steps_of(self.ys)

    def timed(self, reached: dict[str, Candidate]) -> dict[str, Sized]:
        """Measure candidates whose number of particles is known."""
        return {name: Sized(one.filter, self.seconds(one), self.by_flops(one)) for name, one in reached.items()}

    def fitting(self, options: list[Candidate], budget: float) -> dict[str, Sized]:
        """Find the number of particles of each candidate that fits the budget; those that do not fit at all are left out.

        Raises:
            MotesError: none fits; the message names the cheapest.
        """
        found: dict[str, Sized] = {}
        cheapest = (float("inf"), "")
        for candidate in tracked(options, "timing", self.progress):
            result = self._sized(candidate, budget)
            if isinstance(result, Sized):
                found[candidate.name] = result
            else:
                cheapest = min(cheapest, (result, candidate.name))
        if not found:
            checks.refuse("plan budget", f"at least {cheapest[0]:.3g} s a step, what the cheapest candidate takes ({cheapest[1]})",
                          f"{budget:.3g} s")
        return found

    def refined(self, sized: Sized, budget: float | None) -> Sized:
        """Measure a filter at its number of particles and change that in proportion: what is chosen should keep the budget well."""
        measured = self.seconds(Candidate("", sized.filter, ()), LONG)
        n = sized.filter.particle_count
        if n is None or budget is None:
            return sized._replace(seconds=measured)
        better = _in_lanes(n * budget / measured)
        chosen = sized.filter.with_particles(better)
        by_flops = None if sized.by_flops is None else self.by_flops(Candidate("", chosen, tuple(getattr(chosen, "linear", None) or ())))
        return Sized(chosen, measured * better / n, by_flops)

    def _sized(self, candidate: Candidate, budget: float) -> Sized | float:
        """Return the candidate with n, or the seconds of its cheapest step."""
        filter = candidate.filter
        if filter.particle_count is None:
            seconds = self.seconds(candidate)
            return Sized(filter, seconds, None) if seconds <= budget else seconds
        timed: dict[int, float] = {}
        n = FIRST
        for _ in range(ATTEMPTS):
            sized = candidate.with_particles(n)
            n = sized.filter.particle_count or n
            timed[n] = self.seconds(sized)
            if len(timed) == 1:
                n = FEWEST if timed[n] > budget else _in_lanes(max(2 * n, n * budget / timed[n]))
                continue
            line = _line(timed, budget)
            if line.seconds(1) > budget:
                return line.seconds(1)
            wanted = _in_lanes(line.particles(budget))
            if wanted in timed or abs(timed[n] / budget - 1) < NEAR:
                break
            n = wanted
        line = _line(timed, budget)
        n = _in_lanes(line.particles(budget))
        chosen = candidate.with_particles(n)
        return Sized(chosen.filter, line.seconds(n), self.by_flops(chosen))

    def by_flops(self, candidate: Candidate) -> float | None:
        """Predict the seconds of a step by the paper's count (equations 11 and 12), where the filter is one that it is about."""
        k, filter = len(candidate.linear), candidate.filter
        if not isinstance(filter, (MarginalizedParticleFilter, ParticleFilter)) or k == self.model.size:
            return None
        one = jax.tree.map(lambda leaf: leaf[0], self.inputs)
        mixed = k > 0 and split(self.model, candidate.linear, one).per_particle
        counted_flops = complexity(self.model.size - k, k, filter.n, self.costs.costs, "mixed" if mixed else "nonlinear")
        return counted_flops * self.costs.flop.value


def _in_lanes(n: float) -> int:
    whole = max(1, min(MOST, int(n)))
    return whole if whole < LANES else whole - whole % LANES


def _line(timed: dict[int, float], budget: float) -> StepTime:
    """Draw the line through the two measurements nearest to the budget, or through all where these are too close together."""
    nearest = sorted(timed.items(), key=lambda one: abs(one[1] - budget))[:2]
    try:
        return StepTime.fitted(tuple(sorted(nearest)))
    except checks.MotesError:
        return StepTime.fitted(tuple(sorted(timed.items())))
