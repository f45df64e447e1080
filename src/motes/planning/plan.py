"""Which states to marginalize and how many particles fit a clock (after Karlsson et al. 2005, section IV, for any model and machine).

1. List the candidates: the plain particle filter, a marginalized one for each set of states that a Kalman filter can carry, the extended
   Kalman filter.
2. Time each on this machine and find how many particles fit the budget, or try how many an accuracy needs.
3. Run all on the same tracks and measurements; drop those that are certainly worse, and give the further runs to the others.
"""

import math
from typing import Any

import jax
import numpy as np

from motes.bounds.cramer_rao import posterior_cramer_rao
from motes.core import checks, hosts, markdown
from motes.core.record import record, static
from motes.core.types import Inputs
from motes.costs.calibration import Calibration, calibrate
from motes.costs.measure import seconds_per_step
from motes.filters.interface import Filter
from motes.io.result_table import Table
from motes.models.simulate import simulate
from motes.models.state_space import numbers_of
from motes.planning.candidates import candidates, given_candidates
from motes.planning.needed import needed
from motes.planning.sizes import LONG, Clock, Sized
from motes.planning.trials import FIRST_RUNS, Trial, trials
from motes.studies.experiment import Experiment

COLUMNS = ("filter", "n", "ms/step", "by flops", "RMSE", "s.e.", "of bound", "lost", "runs")
SPAN, LONGEST = 0.04, 400
"""Seconds that a run should last that is timed, and most steps of it."""


@record
class Pilot:
    """How the planner tries candidates.

    Attributes:
        steps: length of a pilot run; that of the inputs where there are any.
        runs: most runs for one candidate.
        seed: of tracks, measurements and filters.
        inputs: of the model, a tree with the time axis first; None where it takes none.
        filters: name to filter, to choose among these instead of those that the model's structure suggests; their n is changed.
        progress: whether to draw progress bars on the error stream; where that is a terminal, if not given.
    """

    steps: int = static(default=60)
    runs: int = static(default=64)
    seed: int = static(default=0)
    inputs: Inputs = None
    filters: dict[str, Filter] | None = None
    progress: bool | None = static(default=None)

    def __post_init__(self) -> None:
        """Bring the inputs to arrays.

        Raises:
            MotesError: one is not a finite number.
        """
        object.__setattr__(self, "inputs", numbers_of("Pilot inputs", self.inputs, rows=True))


@record
class Plan:
    """What the planner found.

    Attributes:
        choice: the filter to use.
        seconds: predicted seconds of a step of it.
        table: one row for each candidate, best first: milliseconds a step as measured times predict them and by the count of equivalent
            flops; RMSE of the states that count, or of all, each in units of the best candidate's (1: best in every state).
        measured: seconds of a step measured afterwards in a run of its own (with `verify`), else None.
    """

    choice: Filter = static()
    seconds: float = static()
    table: Table = static()
    measured: float | None = static(default=None)

    def __str__(self) -> str:
        """Print the table and the choice."""
        return "\n".join([str(self.table), *(f"{what:<12}{text}" for what, text in self._facts())])

    def _repr_markdown_(self) -> str:
        return f"{self.table.to_markdown()}\n{markdown.table(('', 'plan'), self._facts())}"

    def _facts(self) -> list[tuple[str, str]]:
        facts = [("choice", repr(self.choice)), ("predicted", f"{1e3 * self.seconds:.4g} ms a step")]
        if self.measured is None:
            return facts
        return [*facts, ("measured", f"{1e3 * self.measured:.4g} ms a step ({100 * (self.measured / self.seconds - 1):+.0f} percent)")]


def plan(
    model: Any,
    budget: float | None = None,
    accuracy: float | None = None,
    states: tuple[str, ...] = (),
    costs: Calibration | None = None,
    verify: bool = False,
    pilot: Pilot = Pilot(),  # noqa: B008 (a record)
) -> Plan:
    """Choose filter, partition and number of particles for a clock or an accuracy, on this machine and the engine in force.

    Where devices are shared out (`with mo.devices(8):`) it says, too, whether to have the filter in as many elements (`Distributed`).

    Times are those of a step inside a compiled run. A machine that is busy while it is timed gives a plan with too few particles.

    Args:
        model: state-space or mixed linear model that can be simulated.
        budget: seconds per step: as accurate as that allows.
        accuracy: RMSE of `states` instead: as fast as that allows.
        states: states that count, of one unit; all of them if none is named (with a budget).
        costs: constants for the count of equivalent flops; those of `calibrate(model)` if not given.
        verify: measure the choice once more, in a run of its own.
        pilot: how candidates are tried.

    Raises:
        MotesError: no candidate fits the budget (the message tells the cheapest one's time) or reaches the accuracy, or an argument cannot
            be used.
    """
    steps = pilot.steps if pilot.inputs is None else len(jax.tree.leaves(pilot.inputs)[0])
    one = jax.tree.map(lambda leaf: leaf[0], pilot.inputs)
    _check(budget, accuracy, states)
    if hosts.are_several():
        checks.refuse("plan", "one process, whose times decide", "several that work as one", "Plan on one machine, with mo.devices(count).")
    options = candidates(model, one) if pilot.filters is None else given_candidates(pilot.filters)
    costs = calibrate(model, inputs=one) if costs is None else costs

    def experiment(filters: dict[str, Filter], **more: Any) -> Experiment:
        return Experiment(model, filters, steps, seed=pilot.seed, inputs=pilot.inputs, **more)

    first = experiment({options[0].name: options[0].filter}, runs=FIRST_RUNS, blocks={"states that count": states} if states else None)
    # a step's share of what happens once a run is to be small beside the budget
    timed = steps if pilot.inputs is not None or budget is None else int(np.clip(SPAN / budget, steps, LONGEST))
    clock = Clock(model, simulate(pilot.seed, model, timed, pilot.inputs)[1], pilot.inputs, costs, pilot.progress)
    if accuracy is None:
        assert budget is not None
        fitting = clock.fitting(options, budget)
    else:
        fitting = clock.timed(needed(options, first, accuracy, clock.seconds))
    last = experiment({name: one.filter for name, one in fitting.items()}, runs=pilot.runs)
    found, unit = trials(last, states, pilot.progress)
    most = max(trial.runs for trial in found.values())
    by = (lambda name: found[name].error) if accuracy is None else (lambda name: fitting[name].seconds)
    order = sorted(fitting, key=lambda name: (accuracy is None and found[name].runs < most, by(name)))
    least = _least(last, unit)
    best = clock.refined(fitting[order[0]], budget)
    sized = {**fitting, order[0]: best}
    rows = tuple(_row(name, sized[name], found[name], least) for name in order)
    measured = seconds_per_step(best.filter, model, clock.ys, pilot.inputs, span=LONG) if verify else None
    return Plan(best.filter, best.seconds, Table(COLUMNS, rows), measured)


def _check(budget: float | None, accuracy: float | None, states: tuple[str, ...]) -> None:
    given = budget if accuracy is None else accuracy
    if (budget is None) == (accuracy is None):
        checks.refuse("plan", "either a budget in seconds per step or an accuracy", "both" if accuracy is not None else "neither")
    if isinstance(given, bool) or not isinstance(given, (int, float)) or not 0 < given < math.inf:
        what, unit = ("budget", " of seconds") if accuracy is None else ("accuracy", "")
        checks.refuse(f"plan {what}", f"a positive number{unit}", repr(given))
    if accuracy is not None and not states:
        checks.refuse("plan states", "names of states of one unit, whose RMSE the accuracy is", "none")


def _least(experiment: Experiment, unit: np.ndarray) -> float | None:
    """Return the error that the posterior Cramer-Rao bound allows, in the units of the trials, or None where there is no bound."""
    try:
        bound = posterior_cramer_rao(experiment.seed, experiment.model, experiment.steps, inputs=experiment.inputs)
    except checks.MotesError:
        return None
    variances = np.diagonal(np.asarray(bound.cov, np.float64), axis1=1, axis2=2).mean(axis=0)
    return float(np.sqrt((variances / unit).sum()))


def _row(name: str, sized: Sized, trial: Trial, least: float | None) -> tuple[str | int | float | None, ...]:
    milliseconds = (1e3 * sized.seconds, None if sized.by_flops is None else 1e3 * sized.by_flops)
    share = trial.error / least if least else None
    return name, sized.filter.particle_count, *milliseconds, trial.error, trial.standard_error, share, trial.lost, trial.runs
