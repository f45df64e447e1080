"""How many particles: against a law that is known, and the refusals."""

import numpy as np
import pytest
from study_models import experiment

import motes as mo
from data import refused
from motes.studies import search


@pytest.fixture
def known(monkeypatch):
    """Studies of which the mean square error is 1 + 900 / n times noise that all share; 400 runs of 4 steps."""
    common = np.random.default_rng(2).gamma(4.0, 0.25, (400, 1)) * np.ones(4)
    asked = []

    def told(plan, progress):
        (given,) = plan.filters.values()
        asked.append(given.n)
        own = np.random.default_rng(given.n).gamma(100.0, 0.01, common.shape)
        squared = common * own * (1 + 900 / given.n)
        return type("Result", (), {"squared_errors": lambda self, block: squared[None]})()

    monkeypatch.setattr(search, "study", told)
    return asked


def test_rmse_of_another_filter_is_reached_where_the_law_says(known):
    plan = experiment(filters={"goal": mo.ParticleFilter(n=300), "sought": mo.ParticleFilter(n=7)})
    found = mo.studies.particles_for_rmse(plan, "sought", "place", "goal", (20, 5000), precision=0.02)
    assert found.at_least < 300 < found.at_most and found.at_most < 1.2 * found.at_least
    assert abs(found.n - 300) < 25
    assert known[0] == 300 and len(known) == len(found.trials) + 1 <= 12
    assert [trial.n for trial in found.trials] == sorted(trial.n for trial in found.trials)


def test_a_number_as_target_has_the_errors_of_one_study(known):
    plan = experiment(filters={"sought": mo.ParticleFilter(n=7)})
    found = mo.studies.particles_for_rmse(plan, "sought", "place", 2.0, (20, 5000))
    assert found.at_least < 300 < found.at_most
    assert found.trials[0].error == pytest.approx(np.sqrt(46.0) * 0.5 / 2 / 20, rel=0.2)


@pytest.mark.night
def test_real_runs():
    plan = experiment(runs=40, filters={"goal": mo.ParticleFilter(n=60), "sought": mo.ParticleFilter(n=1)})
    found = mo.studies.particles_for_rmse(plan, "sought", "both", "goal", (10, 360), precision=100.0)
    assert 10 <= found.n <= 360 and len(found.trials) == 2 and found.trials[0].excess > 0 > found.trials[-1].excess


def test_particles_for_time():
    for budget, expected in ((1e-3, 900), (1e-4, 0), (1.0, 5000)):
        calls = []

        def seconds(n, calls=calls):
            calls.append(n)
            return 1e-4 + 1e-6 * n

        if expected:
            assert mo.studies.particles_for_time(budget + 1e-9, seconds, (10, 5000)) == expected and len(calls) < 16
        else:
            with pytest.raises(mo.MotesError, match="a smallest number that takes at most 0.0001 s, got 0.00011 s at 10"):
                mo.studies.particles_for_time(budget, seconds, (10, 5000))


@pytest.mark.parametrize(("arguments", "message"), [
    (("other", "place", 1.0, (2, 9)), "particles_for_rmse filter: expected one of 'sought'"),
    (("sought", "speed", 1.0, (2, 9)), "particles_for_rmse block: expected one of 'place', 'both'"),
    (("sought", "place", "sought", (2, 9)), "particles_for_rmse target: expected one of"),
    (("sought", "place", -1.0, (2, 9)), "particles_for_rmse target: expected a positive RMSE or the name of another filter, got -1.0"),
    (("sought", "place", 1.0, (9, 9)), "particles_for_rmse between: expected two whole numbers"),
    (("grid", "place", 1.0, (2, 9)), "expected a filter with a number of particles n, got PointMassFilter"),
    (("sought", "place", 9.0, (20, 40)), "between: expected numbers with RMSEs above and below 9, got RMSEs 6.697 at 20 and"),
])
def test_refusals(known, arguments, message):
    plan = experiment(filters={"sought": mo.ParticleFilter(n=7), "grid": mo.PointMassFilter((0.0, 0.0), (1.0, 1.0), (5, 5))})
    with pytest.raises(mo.MotesError) as error:
        mo.studies.particles_for_rmse(plan, *arguments)
    refused(error, message)
