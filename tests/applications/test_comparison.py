"""Filters compared on many flights: figures worked out by hand from made-up runs, and a small real comparison."""

from types import SimpleNamespace

import numpy as np
import pytest

import motes as mo
from motes.applications.terrain import comparison, scenario
from motes.applications.terrain.settings import Noises, Route


def row(errors, nees, bound=25.0):
    """Judge made-up runs `(run, t, 2)` with a bound of 5 m along each axis."""
    bounds = np.broadcast_to(bound * np.eye(2), (errors.shape[1], 2, 2))
    return dict(zip(comparison.COLUMNS, comparison.row_of("x", comparison.Flown(errors, errors / 10, nees, 1e-3), bounds), strict=True))


def test_figures_of_made_up_runs():
    errors = np.zeros((4, 240, 2))
    errors[..., 0] = 6.0
    errors[0, -1] = 120.0, 120.0  # 170 m at the end: lost
    errors[1, 150:155, 1] = 20.0  # five fixes far outside: strayed
    errors[2, 150:154, 1] = 20.0  # four only
    errors[3, :100, 1] = 90.0  # before half of the flight
    nees = np.full((4, 240), 2.0)
    nees[:, 140:170] = 9.0
    nees[0] = 100.0
    found = row(errors, nees)
    assert (found["lost"], found["paper's rule"], found["ms/step"]) == (1, 1, 1.0)
    square = (3 * 100 * 36 + 9 * 400) / 300
    assert found["RMSE, m"] == pytest.approx(np.sqrt(square)) and found["of bound"] == pytest.approx(np.sqrt(square / 50))
    assert found["NEES / 2"] == pytest.approx((70 * 2 + 30 * 9) / 200) and found["in band, %"] == pytest.approx(70)
    # six times a bound of 50 m allows 424 m
    assert row(errors, nees, bound=2500.0)["lost"] == 0
    assert row(errors[:1], nees[:1])["RMSE, m"] is None


@pytest.fixture(scope="module")
def flights():
    return [scenario.simulated(70 + k, route=Route(fixes=130), noises=Noises(position=1.0)) for k in range(3)]


def test_truth_lies_where_the_errors_lead(flights):
    first = flights[0]
    truth = comparison.truth_of(first)
    expected = first.model.sensor.means(np.zeros((9, 1), np.float32), SimpleNamespace(
        north=truth.north[5], east=truth.east[5], altitude=truth.altitude[5]), 5)
    at_errors = first.model.sensor.means(np.asarray(first.errors[5])[:, None], SimpleNamespace(
        north=first.inputs.north[5], east=first.inputs.east[5], altitude=first.inputs.altitude[5]), 5)
    assert float(expected[0, 0]) == pytest.approx(float(at_errors[0, 0]), abs=0.05)


@pytest.mark.night
def test_rivals_on_real_relief(flights):
    """The kernel filter keeps its way with few kernels, within twice the bound; a filter told nothing loses every run."""
    kernel = comparison.usual_rivals(flights[0].model, flights[0].model)["kernel, 2500"].filter
    few = mo.KalmanParticleKernelFilter(n=800, nonlinear=kernel.nonlinear, kernels=kernel.kernels)
    deaf = mo.LinearGaussian(np.eye(9), np.zeros((9, 9)))
    found = comparison.compare(flights, {"kernel": comparison.Rival(few), "still": comparison.Rival(mo.ParticleFilter(n=2), deaf)},
                               progress=False)
    assert found.table.column("lost") == [0, 3]
    assert 0.3 < found.table.column("of bound")[0] < 2 and found.bound.shape == (130, 2, 2)
    assert set(found.curves) == {"kernel", "bound"}
    kept, least = found.curves["kernel"], found.curves["bound"]
    flown = found.flown["kernel"]
    assert kept[9, 1] == pytest.approx(np.sqrt(np.mean(np.sum(flown.velocity_errors[:, 9] ** 2, axis=-1))))
    assert least[9] == pytest.approx(np.sqrt([np.trace(found.bound[9]), np.trace(found.velocity_bound[9])]))
    assert np.all(least[-1] < [100, 5]) and np.all(least[0] > [1000, 7])
