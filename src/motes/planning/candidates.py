"""What the planner chooses from: filters that fit a model, one for each set of states that a Kalman filter can carry.

Where devices are shared out, those with particles are there in elements, too: few particles are moved sooner than messages are sent.
"""

from itertools import combinations
from typing import Any, NamedTuple

from motes.core import checks, devices
from motes.core.types import Inputs
from motes.filters.distributed import Distributed
from motes.filters.extended_kalman import ExtendedKalmanFilter
from motes.filters.interface import Filter
from motes.filters.marginalized import MarginalizedParticleFilter
from motes.filters.particle import ParticleFilter
from motes.models.state_space import as_state_space
from motes.models.structure import structure

FEW = 4
"""Up to so many linear states all their sets are candidates; with more, the largest set and those that lack one state."""


class Candidate(NamedTuple):
    """One way to filter a model.

    Attributes:
        name: for tables.
        filter: with any number of particles, which the planner changes.
        linear: states in the Kalman part, `k` of them.
    """

    name: str
    filter: Filter
    linear: tuple[str, ...]

    def with_particles(self, n: int) -> "Candidate":
        """Return the candidate with n particles."""
        return self._replace(filter=self.filter.with_particles(n))


def candidates(model: Any, inputs: Inputs) -> list[Candidate]:
    """List the filters that fit a model; where devices are shared out (`mo.devices`), each that has particles in elements, too.

    Args:
        model: state-space or mixed linear model.
        inputs: example of the inputs of one step.
    """
    plain = [Candidate("particle filter", ParticleFilter(n=1), ())]
    linear = tuple(model.names[i] for i in structure(model, inputs).linear)
    counts = range(1, len(linear) + 1) if len(linear) <= FEW else (len(linear) - 1, len(linear))
    for count in counts:
        for chosen in combinations(linear, count):
            plain.append(Candidate(_named(chosen, linear), MarginalizedParticleFilter(n=1, linear=chosen), chosen))
    found = [*plain, *_in_elements(plain, devices.chosen())]
    try:
        ExtendedKalmanFilter().prepare(as_state_space("plan", model), inputs)
    except checks.MotesError:
        return found
    return [*found, Candidate("extended Kalman filter", ExtendedKalmanFilter(), tuple(model.names))]


def _in_elements(plain: list[Candidate], count: int) -> list[Candidate]:
    """Return the candidates with an element on each device: fewer leave devices idle, and more cost without bringing anything."""
    if count == 1:
        return []
    return [one._replace(name=f"{one.name}, {count} elements", filter=Distributed(one.filter.with_particles(count), count))
            for one in plain]  # fmt: skip


def _named(chosen: tuple[str, ...], linear: tuple[str, ...]) -> str:
    left = [name for name in linear if name not in chosen]
    if len(linear) <= FEW:
        return f"marginalized {' '.join(chosen)}"
    return "marginalized, all" + (f" but {' '.join(left)}" if left else "")


def given_candidates(filters: dict[str, Filter]) -> list[Candidate]:
    """Make candidates of filters that the user names.

    Raises:
        MotesError: one is no filter.
    """
    for name, filter in filters.items():
        if not isinstance(filter, Filter):
            checks.refuse(f"plan filters {name!r}", "a filter", type(filter).__name__)
    return [Candidate(name, filter, tuple(map(str, getattr(filter, "linear", None) or ()))) for name, filter in filters.items()]
