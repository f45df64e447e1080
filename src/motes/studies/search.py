"""How many particles for a given accuracy, or for a given time (Karlsson et al. 2005, Tables III and II), by bisection on paired runs."""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

from motes.core import checks
from motes.core.record import record, replace, static
from motes.studies.experiment import Experiment
from motes.studies.run import study
from motes.studies.tables import accuracy, difference

CERTAIN = 2.0
"""Standard errors by which an RMSE must miss the target to count as above or below it."""


class Trial(NamedTuple):
    """One number of particles that was tried.

    Attributes:
        n: number of particles.
        rmse: what came out.
        excess: by how much that is above the target.
        error: standard error of the excess.
    """

    n: int
    rmse: float
    excess: float
    error: float


@record
class Particles:
    """How many particles a filter needs.

    Attributes:
        n: the number whose RMSE came nearest to the target.
        at_least: largest number that was tried with an RMSE certainly above the target.
        at_most: smallest number that was tried with an RMSE certainly below the target. Between the two, the runs do not tell.
        trials: all that was tried, by n.
    """

    n: int = static()
    at_least: int = static()
    at_most: int = static()
    trials: tuple[Trial, ...] = static()


def particles_for_rmse(
    experiment: Experiment, filter: str, block: str, target: float | str, between: tuple[int, int], precision: float = 0.05
) -> Particles:
    """Find the number of particles with which a filter has a given RMSE, by bisection in log n.

    Every number is tried on the same tracks, measurements and keys, so that what differs is the filter. A target that is another filter is
    compared run by run, which makes its errors smaller than those of two RMSEs. Each number of particles compiles anew.

    Args:
        experiment: the runs.
        filter: name of the filter whose n is sought.
        block: block whose RMSE is meant.
        target: an RMSE, or the name of another filter of the experiment whose RMSE is to be reached.
        between: numbers of particles with an RMSE above and below the target.
        precision: stop when the numbers left differ by less than this share.

    Raises:
        MotesError: a name is unknown, the filter has no n, or the target does not lie between the RMSEs at the two ends.
    """
    own, against = _checked(experiment, filter, block, target, between)
    goal = accuracy(against).rmse if isinstance(target, str) else target
    trials: dict[int, Trial] = {}

    def tried(n: int) -> Trial:
        given = experiment.filters[filter]
        sized = (own.with_particles(n), given[1]) if isinstance(given, tuple) else own.with_particles(n)
        result = study(replace(experiment, filters={filter: sized}), progress=False)
        squared = result.squared_errors(block)[0]
        found = accuracy(squared)
        excess = (found.rmse - goal, found.error) if against is None else difference(squared, against)
        trials[n] = Trial(n, found.rmse, *excess)
        return trials[n]

    low, high = between
    first, last = tried(low), tried(high)
    if not first.excess > 0 > last.excess:
        checks.refuse("particles_for_rmse between", f"numbers with RMSEs above and below {goal:.4g}",
                      f"RMSEs {first.rmse:.4g} at {low} and {last.rmse:.4g} at {high}", "Give a wider range.")
    while high > low * (1 + precision) and high - low > 1:
        middle = tried(min(max(round(math.sqrt(low * high)), low + 1), high - 1))
        if abs(middle.excess) < CERTAIN * middle.error:
            break  # the runs cannot tell on which side the target lies
        low, high = (middle.n, high) if middle.excess > 0 else (low, middle.n)
    every = tuple(trials[n] for n in sorted(trials))
    above = [trial.n for trial in every if trial.excess > CERTAIN * trial.error]
    below = [trial.n for trial in every if trial.excess < -CERTAIN * trial.error]
    nearest = min(every, key=lambda trial: abs(trial.excess))
    return Particles(nearest.n, max(above, default=between[0]), min(below, default=between[1]), every)


def _checked(experiment: Experiment, filter: str, block: str, target: Any, between: tuple[int, int]) -> tuple[Any, Any]:
    """Check the arguments, and return the filter and the squared errors of the filter that is the target, if one is."""
    checks.option("particles_for_rmse filter", filter, tuple(experiment.filters))
    checks.option("particles_for_rmse block", block, tuple(name for name, _ in experiment.blocks))
    _check_range("particles_for_rmse between", between)
    own = experiment.assumed(filter)[0]
    if own.particle_count is None:
        checks.refuse("particles_for_rmse filter", "a filter with a number of particles n", type(own).__name__)
    if isinstance(target, str):
        checks.option("particles_for_rmse target", target, tuple(name for name in experiment.filters if name != filter))
        reference = study(replace(experiment, filters={target: experiment.filters[target]}), progress=False)
        return own, reference.squared_errors(block)[0]
    if not (isinstance(target, (int, float)) and 0 < target < math.inf):
        checks.refuse("particles_for_rmse target", "a positive RMSE or the name of another filter", repr(target))
    return own, None


def particles_for_time(seconds: float, seconds_per_step: Callable[[int], float], between: tuple[int, int]) -> int:
    """Return the largest number of particles whose steps take no longer than allowed, by bisection.

    Args:
        seconds: time of one step.
        seconds_per_step: gives the time of a step with n particles; it should grow with n (take the smallest of several measurements).
        between: smallest and largest number to consider.

    Raises:
        MotesError: even the smallest number takes longer, or an argument cannot be used.
    """
    _check_range("particles_for_time between", between)
    low, high = between
    least = seconds_per_step(low)
    if not least <= seconds:
        checks.refuse("particles_for_time between", f"a smallest number that takes at most {seconds:.3g} s", f"{least:.3g} s at {low}")
    if seconds_per_step(high) <= seconds:
        return high
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (middle, high) if seconds_per_step(middle) <= seconds else (low, middle)
    return low


def _check_range(argument: str, between: Any) -> None:
    whole = isinstance(between, tuple) and len(between) == 2 and all(isinstance(n, int) for n in between)
    if not whole or not 1 <= between[0] < between[1]:
        checks.refuse(argument, "two whole numbers, the first at least 1 and smaller than the second", repr(between))
