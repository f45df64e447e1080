"""Several filters on the same simulated flights: runs lost, errors beside the bound, honest covariances, time (Dahia et al. 2004).

Two rules tell lost runs. At the end: the final horizontal error exceeds `scenario.LOST` meters and six times the bound. The paper's: at
`IN_A_ROW` fixes one after the other, once half the flight is over, the error lies outside the ellipse that holds 99 percent by the bound;
even a filter as good as the bound breaks it now and then, since the bound knows of one mode only.
"""

import time
from collections.abc import Sequence
from itertools import groupby
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from scipy.stats import chi2

from motes.applications.terrain.model import Track, places_of
from motes.applications.terrain.scenario import LOST, Flight
from motes.bounds.at_truth import kalman_at_truth
from motes.core.progress import tracked
from motes.core.record import replace
from motes.diagnostics.consistency import chi_square_band
from motes.filters.interface import Filter
from motes.filters.kernel import KalmanParticleKernelFilter
from motes.filters.marginalized import MarginalizedParticleFilter
from motes.filters.regularized import RegularizedParticleFilter
from motes.filters.run import run
from motes.io.result_table import Table
from motes.laws.conditional import Conditional
from motes.models.state_space import StateSpaceModel
from motes.resampling.kernels import Regularization
from motes.resampling.splitting import SplitKernels

IN_A_ROW, WITHIN, BOUNDS = 5, 0.99, 6.0
LITTLE = 1e-6
"""m^2, added to covariances: a cloud of equal particles has none."""
LAST = 100
"""Fixes at the end over which errors are judged."""
COLUMNS = ("filter", "lost", "paper's rule", "RMSE, m", "of bound", "NEES / 2", "in band, %", "NEES / 2, all", "ms/step")


class Rival(NamedTuple):
    """A filter, and the dynamics that it believes in: those of the flight where none are given."""

    filter: Filter
    dynamics: Conditional | None = None


class Flown(NamedTuple):
    """What a filter did on all flights.

    Attributes:
        errors: position north and east, truth less estimate, `(run, t, 2)`, m.
        velocity_errors: likewise, `(run, t, 2)`, m/s.
        nees: horizontal normalized estimation error squared by the filter's own covariance, `(run, t)`.
        seconds: of a step, the least of all runs.
    """

    errors: np.ndarray
    velocity_errors: np.ndarray
    nees: np.ndarray
    seconds: float

    def lost(self, bound: np.ndarray) -> np.ndarray:
        """Tell which runs are lost at the end, `(run,)`, by the least horizontal covariance `(t, 2, 2)`."""
        return np.linalg.norm(self.errors[:, -1], axis=-1) > max(LOST, BOUNDS * np.sqrt(np.trace(bound[-1])))


class Comparison(NamedTuple):
    """What all filters did on the same flights.

    Attributes:
        table: one row per filter.
        flown: name to what the filter did.
        bound: least horizontal error covariance along the true track, `(t, 2, 2)`, m^2.
        velocity_bound: the same of the velocity, `(t, 2, 2)`, m^2/s^2.
    """

    table: Table
    flown: dict[str, Flown]
    bound: np.ndarray
    velocity_bound: np.ndarray

    @property
    def curves(self) -> dict[str, np.ndarray]:
        """Root mean square errors of position (m) and velocity (m/s) over the runs that each filter kept, `(t, 2)`, and the bound."""
        found = {}
        for name, one in self.flown.items():
            kept = ~one.lost(self.bound)
            if kept.any():
                both = [np.mean(np.sum(part[kept] ** 2, axis=-1), axis=0) for part in (one.errors, one.velocity_errors)]
                found[name] = np.sqrt(np.stack(both, axis=1))
        least = [np.trace(part, axis1=1, axis2=2) for part in (self.bound, self.velocity_bound)]
        return found | {"bound": np.sqrt(np.stack(least, axis=1))}


def usual_rivals(model: StateSpaceModel, wide: StateSpaceModel) -> dict[str, Rival]:
    """Return the filters of Dahia et al. (2004), and a fair rival of its Rao-Blackwellized one: with more process noise than there is.

    Args:
        model: of the flights.
        wide: the same with more position noise.
    """
    map_cell = float(min(model.sensor.f.terrain.dn, model.sensor.f.terrain.de))  # type: ignore[attr-defined]
    kernel = KalmanParticleKernelFilter(n=2500, nonlinear=("rN", "rE"), kernels=SplitKernels(longest=map_cell))
    return {
        "kernel, 2500": Rival(kernel),
        "marginalized, 15000": Rival(MarginalizedParticleFilter(n=15000)),
        "same, more noise": Rival(MarginalizedParticleFilter(n=15000), wide.dynamics),
        "regularized, 2500": Rival(RegularizedParticleFilter(n=2500, regularization=Regularization(scale=0.5))),
    }


def truth_of(flight: Flight) -> Track:
    """Return the true track of a simulated flight, as its inputs would be without errors."""
    assert flight.truth is not None and flight.errors is not None
    down = places_of(flight.model.names)[2]
    return Track(flight.truth[:, 0], flight.truth[:, 1], flight.inputs.altitude - flight.errors[:, down], flight.inputs.since)


def fly_all(flights: Sequence[Flight], rival: Rival, seed: int = 0, name: str = "flights", progress: bool | None = None) -> Flown:
    """Run a filter over simulated flights of one kind.

    Args:
        flights: with known errors.
        rival: the filter.
        seed: of the filter; each flight has a key of its own.
        name: for the progress bar.
        progress: whether to draw one on the error stream; where that is a terminal, if not given.
    """
    filter = replace(rival.filter, on_collapse="inflate")
    across, moving = _horizontal(flights[0].model.names)
    errors, nees, seconds = [], [], []
    for k, flight in enumerate(tracked(flights, name, progress)):
        model: Any = flight.model if rival.dynamics is None else replace(flight.model, dynamics=rival.dynamics)
        began = time.perf_counter()
        history = jax.block_until_ready(run(seed + k, filter, model, flight.ys, flight.inputs))
        seconds.append(time.perf_counter() - began)
        error = np.asarray(flight.errors, np.float64) - np.asarray(history.mean, np.float64)
        cov = np.asarray(history.cov, np.float64)[:, across[:, None], across] + LITTLE * np.eye(2)
        errors.append(error)
        nees.append(np.einsum("ti,ti->t", error[:, across], np.linalg.solve(cov, error[:, across, None])[..., 0]))
    whole = np.array(errors)
    return Flown(whole[..., across], whole[..., moving], np.array(nees), min(seconds) / whole.shape[1])


def compare(flights: Sequence[Flight], rivals: dict[str, Rival], seed: int = 0, progress: bool | None = None) -> Comparison:
    """Fly all filters on the same flights over one true track and tell how they did.

    RMSE, bound and NEES are over the last `LAST` fixes of the runs that were not lost at the end; "in band" is the share of these fixes
    at which the NEES, averaged over the runs, lies within its 99 percent chi-square band; "all" is the NEES of all runs, which tells
    whether a filter that is far off knows it.

    Args:
        flights: simulated, all over the same true track.
        rivals: name to filter.
        seed: of the filters.
        progress: whether to draw progress bars.
    """
    truth = truth_of(flights[0])
    least = kalman_at_truth(flights[0].model, jnp.zeros((truth.north.shape[0], flights[0].model.size)), truth)
    bound, velocity_bound = (np.asarray(least.cov, np.float64)[:, places[:, None], places] for places in _horizontal(least.names))
    flown = {name: fly_all(flights, rival, seed, name, progress) for name, rival in rivals.items()}
    return Comparison(Table(COLUMNS, tuple(row_of(name, one, bound) for name, one in flown.items())), flown, bound, velocity_bound)


def _horizontal(names: Sequence[str]) -> tuple[np.ndarray, np.ndarray]:
    """Return where states have the horizontal position and velocity errors."""
    return np.array(places_of(names)[:2]), np.array([names.index("vN"), names.index("vE")])


def row_of(name: str, flown: Flown, bound: np.ndarray) -> tuple[str | int | float | None, ...]:
    """Return a row of the table; errors are empty where all runs are lost.

    Args:
        name: of the filter.
        flown: what it did.
        bound: `(t, 2, 2)`, m^2.
    """
    least = np.sqrt(np.trace(bound, axis1=1, axis2=2))
    far = np.linalg.norm(flown.errors, axis=-1)
    lost = flown.lost(bound)
    half = far.shape[1] // 2
    outside = np.einsum("rti,tij,rtj->rt", flown.errors, np.linalg.inv(bound), flown.errors)[:, half:] > chi2.ppf(WITHIN, 2)
    strayed = sum(any(sum(1 for _ in same) >= IN_A_ROW for out, same in groupby(run) if out) for run in outside)
    told, rest = (name, int(lost.sum()), strayed), (float(flown.nees[:, -LAST:].mean() / 2), 1e3 * flown.seconds)
    kept = ~lost
    if not kept.any():
        return *told, None, None, None, None, *rest
    rmse = np.sqrt(np.mean(far[kept, -LAST:] ** 2))
    averages = flown.nees[kept, -LAST:].mean(axis=0)
    low, high = chi_square_band(2, int(kept.sum()))
    in_band = 100 * np.mean((averages > low) & (averages < high))
    of_bound = rmse / np.sqrt(np.mean(least[-LAST:] ** 2))
    return *told, float(rmse), float(of_bound), float(averages.mean() / 2), float(in_band), *rest
