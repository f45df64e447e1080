"""The planner, with a clock that is made up: what it chooses from, how many particles it gives, what it prefers, what it refuses."""

from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest

import motes as mo
from motes.costs.calibration import Calibration, Slope
from motes.models.textbook import radar_tracking
from motes.planning.candidates import candidates
from motes.planning.sizes import Clock

CONSTANTS = Calibration(*(Slope(value, value, value, 1.0) for value in (1e-10, 4e-8, 5e-8, 1e-8)), engine="jax", device="made up")
FIXED, EACH = 2e-5, 1e-8


def model():
    """A state that is seen through its square, and one that is hidden and linear."""
    return mo.StateSpaceModel(
        mo.Gaussian([1.0, 0.0], [[4.0, 0.5], [0.5, 1.0]]),
        mo.AdditiveGaussian(lambda x, u, t: jnp.array([0.9 * x[0] + 3 * jnp.cos(x[0]) + x[1], 0.8 * x[1]]), np.diag([0.5, 0.2])),
        mo.AdditiveGaussian(lambda x, u, t: x[:1] ** 2 / 5, [[0.1]]),
        ("seen", "hidden"),
    )


def cost(filter):
    """Seconds of a step: a line with a bend, dearer for each state that a Kalman filter carries."""
    n = getattr(filter, "n", 0)
    return FIXED + EACH * n * (1 + len(getattr(filter, "linear", None) or ())) * (1.3 if n > 5_000 else 1.0)


@pytest.fixture
def clock(monkeypatch):
    monkeypatch.setattr(Clock, "seconds", lambda self, candidate, span=0: cost(candidate.filter))


def plan(model, *args, runs=16, **options):
    return mo.plan(model, *args, **options, costs=CONSTANTS, pilot=mo.planning.Pilot(steps=25, runs=runs, progress=False))


def test_candidates():
    names = [candidate.name for candidate in candidates(radar_tracking(), None)]
    assert len(names) == 1 + 15 + 1 and names[0] == "particle filter" and "marginalized vx vy ax ay" in names
    size = 9
    many = mo.StateSpaceModel(
        mo.Gaussian(np.zeros(size), np.eye(size)), mo.LinearGaussian(np.eye(size) + 0.1 * np.eye(size, k=1), np.eye(size)),
        mo.AdditiveNoise(lambda x, u, t: x[:2] ** 2, mo.StudentT([1.0, 1.0], 4.0)))
    names = [candidate.name for candidate in candidates(many, None)]
    assert names[:2] == ["particle filter", "marginalized, all but x8"] and len(names) == 1 + 7 + 1 + 1
    assert all(candidate.linear for candidate in candidates(many, None)[1:])


def test_elements_are_proposed_where_they_pay(monkeypatch):
    """Four devices: a quarter of the particles each, and messages that take as long as a thousand particles more than all of it."""
    monkeypatch.setattr("motes.planning.candidates.devices", SimpleNamespace(chosen=lambda: 4))

    def seconds(self, candidate, span=0):
        shared = isinstance(candidate.filter, mo.Distributed)
        n = candidate.filter.particle_count or 0
        return FIXED + EACH * (n / 4 + 4_000 if shared else n)

    monkeypatch.setattr(Clock, "seconds", seconds)
    filters = {name: one for one in candidates(model(), None) for name in [one.name]}
    assert list(filters) == ["particle filter", "marginalized hidden", "particle filter, 4 elements", "marginalized hidden, 4 elements",
                             "extended Kalman filter"]  # fmt: skip
    clock = Clock(model(), np.zeros((3, 1)), None, CONSTANTS, False)
    plain, shared = filters["particle filter"], filters["particle filter, 4 elements"]
    for budget, pays in ((FIXED + EACH * 4_500, False), (FIXED + EACH * 64_000, True)):
        sizes = {name: one.filter.particle_count for name, one in clock.fitting([plain, shared], budget).items()}
        assert (sizes[shared.name] > sizes[plain.name]) == pays and sizes[shared.name] % 4 == 0
    best = clock.refined(clock.fitting([shared], budget)[shared.name], budget)
    assert best.filter.elements == 4 and best.seconds == pytest.approx(budget, rel=0.02)
    assert mo.Distributed(mo.ParticleFilter(n=12), 3).with_particles(100).particle_count == 102


def test_several_processes_do_not_plan(monkeypatch):
    monkeypatch.setattr("motes.core.hosts.are_several", lambda: True)
    with pytest.raises(mo.MotesError, match="plan: expected one process"):
        mo.plan(model(), 1e-4)


def test_budget(clock):
    """The number of particles is what the clock allows; the best filter comes first, and the count of flops stands beside the time."""
    found = plan(model(), 1e-4, verify=False)
    names, n = found.table.column("filter"), dict(zip(found.table.column("filter"), found.table.column("n"), strict=True))
    assert set(names) == {"particle filter", "marginalized hidden", "extended Kalman filter"}
    # beyond 5 000 particles the made-up clock runs 1.3 times slower
    for filter in (mo.ParticleFilter(n["particle filter"]), mo.MarginalizedParticleFilter(n["marginalized hidden"], linear=("hidden",))):
        assert cost(filter) == pytest.approx(1e-4, rel=0.3)
    errors = found.table.column("RMSE")
    assert names[-1] == "extended Kalman filter" and errors[-1] > 1.2 * errors[0] and errors[0] == min(errors) >= 1
    assert cost(found.choice) == pytest.approx(1e-4, rel=0.08) and found.seconds == pytest.approx(1e-4, rel=0.01)
    flops = dict(zip(names, found.table.column("by flops"), strict=True))
    assert flops["extended Kalman filter"] is None
    counted = mo.costs.complexity(2, 0, n["particle filter"], CONSTANTS.costs) * 1e-10
    assert flops["particle filter"] == pytest.approx(1e3 * counted)
    assert found.choice.n == n[names[0]] and found.choice.n % 16 == 0 and "choice" in str(found) and "ms a step" in str(found)


def test_states_that_count(clock):
    hidden = plan(model(), 1e-4, states=("hidden",))
    bound = mo.bounds.posterior_cramer_rao(0, model(), 25).overall_rmse("hidden")
    first = hidden.table.rows[0]
    assert first[hidden.table.columns.index("of bound")] == pytest.approx(first[4] / float(bound), rel=1e-4)
    assert 0.3 < first[4] < 1.0


@pytest.mark.night
def test_accuracy(clock):
    """The fastest candidate that reaches an error, with no more particles than it needs."""
    best = plan(model(), 1e-3, states=("seen",)).table.column("RMSE")[0]
    found = plan(model(), accuracy=1.15 * best, states=("seen",))
    assert found.table.column("ms/step") == sorted(found.table.column("ms/step"))
    assert found.seconds == pytest.approx(cost(found.choice)) and found.choice.n < 5_000
    with pytest.raises(mo.MotesError, match=r"plan accuracy: expected at least 0\.\d+, the best that was reached"):
        mo.plan(model(), accuracy=0.01, states=("seen",), costs=CONSTANTS,
                pilot=mo.planning.Pilot(steps=25, runs=8, filters={"plain": mo.ParticleFilter(n=1)}, progress=False))


def test_own_filters_and_a_mixed_model(clock):
    mixed = mo.MixedLinearModel(
        mo.Gaussian([0.0], [[1.0]]), mo.Gaussian([0.0, 0.0], np.eye(2)),
        lambda x, u, t: (0.5 * x + 2 * jnp.cos(x), jnp.array([[1.0, 0.2]]), jnp.eye(1)),
        lambda x, u, t: (jnp.zeros(2), jnp.array([[0.9, 0.1], [0.0, 0.8]]), 0.3 * jnp.eye(2)),
        lambda x, u, t: (x**2 / 20, jnp.array([[1.0, 0.0]]), jnp.eye(1)))
    found = mo.plan(mixed, 3e-5, costs=CONSTANTS, pilot=mo.planning.Pilot(steps=20, runs=8, progress=False, filters={
        "all": mo.MarginalizedParticleFilter(n=1), "one": mo.MarginalizedParticleFilter(n=1, linear=("x2",))}))
    assert set(found.table.column("filter")) == {"all", "one"}


REFUSED = {
    "both": (dict(budget=1e-3, accuracy=1.0), "plan: expected either a budget in seconds per step or an accuracy, got both."),
    "neither": ({}, "plan: expected either a budget in seconds per step or an accuracy, got neither."),
    "negative": (dict(budget=-1.0), "plan budget: expected a positive number of seconds, got -1.0."),
    "no states": (dict(accuracy=1.0), "plan states: expected names of states of one unit, whose RMSE the accuracy is, got none."),
    "unknown state": (dict(budget=1e-3, states=("far",)), "Experiment blocks 'states that count': expected different states out of seen"),
    "too dear": (dict(budget=1e-6), "plan budget: expected at least 2e-05 s a step, what the cheapest candidate takes (extended Kalman"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_refusals(case, clock):
    options, message = REFUSED[case]
    with pytest.raises(mo.MotesError) as refusal:
        plan(model(), **options)
    assert str(refusal.value).startswith(message)
