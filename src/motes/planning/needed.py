"""How many particles an accuracy needs, candidate by candidate: first coarsely upwards, then between the last two numbers."""

from collections.abc import Callable

from motes.core import checks
from motes.core.record import replace
from motes.planning.candidates import Candidate
from motes.studies.experiment import Experiment
from motes.studies.run import study
from motes.studies.search import particles_for_rmse
from motes.studies.tables import accuracy as accuracy_of

LADDER = (100, 400, 1_600, 6_400, 25_600, 102_400)
PRECISION = 0.2
"""The numbers of particles between which the answer lies may differ by this share."""


def needed(
    options: list[Candidate], experiment: Experiment, target: float, seconds: Callable[[Candidate], float]
) -> dict[str, Candidate]:
    """Return the candidates that reach an RMSE, with the number of particles that each needs.

    Args:
        options: what to choose from.
        experiment: the pilot runs, with one block of the states that count.
        target: the RMSE.
        seconds: gives the seconds of a step; a candidate that takes longer than the fastest one found so far is not tried any further.

    Raises:
        MotesError: none reaches it.
    """
    block = experiment.blocks[0][0]
    reached: dict[str, Candidate] = {}
    fastest = float("inf")
    nearest = float("inf")
    for candidate in options:
        below = 0
        for n in LADDER if candidate.filter.particle_count is not None else (0,):
            sized = candidate.with_particles(n) if n else candidate
            if seconds(sized) > fastest:
                break
            own = replace(experiment, filters={candidate.name: sized.filter})
            rmse = accuracy_of(study(own, progress=False).squared_errors(block)[0]).rmse
            nearest = min(nearest, rmse) if rmse == rmse else nearest
            if rmse <= target:
                if below:
                    found = particles_for_rmse(own, candidate.name, block, target, (below, n), PRECISION)
                    enough = min(trial.n for trial in found.trials if trial.excess <= 0)
                    sized = candidate.with_particles(enough)
                reached[candidate.name] = sized
                fastest = min(fastest, seconds(sized))
                break
            below = n
    if not reached:
        checks.refuse("plan accuracy", f"at least {nearest:.4g}, the best that was reached with up to {LADDER[-1]} particles", target)
    return reached
