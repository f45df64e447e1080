"""Plans for five models: does the choice keep its budget, and is it the best that was tried? `python benchmarks/planning.py [NAME ...]`.

Prints each plan and at last, for each model: budget, predicted and measured time of the choice, best other RMSE over its own.
"""

import sys
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

import motes as mo
from motes.applications.terrain import scenario
from motes.models.textbook import growth, radar_tracking

BUDGET = 2e-4


def mixed():
    """Two linear states that the sensor sees, through a matrix that depends on the particle."""
    return mo.MixedLinearModel(
        mo.Gaussian([1.0], [[2.0]]), mo.Gaussian([0.0, 0.0], np.eye(2)),
        lambda x, u, t: (0.5 * x + 4 * jnp.cos(x), jnp.array([[1.0, 0.3]]), 0.5 * jnp.eye(1)),
        lambda x, u, t: (jnp.zeros(2), jnp.array([[0.95, 0.2], [0.0, 0.9]]), 0.1 * jnp.eye(2)),
        lambda x, u, t: (jnp.stack([x[0] ** 2 / 10, x[0] * 0]), jnp.array([[1.0, 0.0], [0.0, 1.0]]) * (1 + jnp.sin(x[0]) / 2),
                         jnp.diag(jnp.array([0.2, 0.5]))),
    )


def seven_of_nine():
    """Nine states, seven of them linear: a position seen from five beacons, its velocity, and the slow biases of the five ranges."""
    A = np.eye(9)
    A[0, 2] = A[1, 3] = 0.5
    A[4:, 4:] *= 0.95
    beacons = np.array([[-20.0, 0.0], [30.0, 10.0], [0.0, 40.0], [-10.0, -30.0], [25.0, -25.0]])

    def ranges(x, u, t):
        return jnp.hypot(*(x[:2, None] - jnp.asarray(beacons, x.dtype).T)) + x[4:]

    return mo.StateSpaceModel(
        mo.Gaussian(np.r_[5.0, 5.0, np.zeros(7)], np.diag([25.0, 25, 1, 1, 1, 1, 1, 1, 1])),
        mo.LinearGaussian(A, np.diag([0.01, 0.01, 0.1, 0.1, 0.05, 0.05, 0.05, 0.05, 0.05])), mo.AdditiveGaussian(ranges, 0.1 * np.eye(5)),
    )


def terrain():
    """The terrain scenario of Dahia, Musso, Pham, Guibert (2004), its first 100 fixes."""
    flight = scenario.simulated(0)
    return flight.model, jax.tree.map(lambda leaf: leaf[:100], flight.inputs)


class Case(NamedTuple):
    """A model to plan for, and how."""

    model: Any
    inputs: Any = None
    budget: float = BUDGET
    states: tuple[str, ...] = ()
    filters: dict[str, Any] | None = None


# the extended Kalman filter, which wins on the radar model, has no number of particles that could keep a budget
PARTICLES = {"plain": mo.ParticleFilter(n=1), "all": mo.MarginalizedParticleFilter(n=1),
             "velocity": mo.MarginalizedParticleFilter(n=1, linear=("vx", "vy"))}  # fmt: skip
CASES = {
    "radar": lambda: Case(radar_tracking(), states=("px", "py")),
    "radar, particles": lambda: Case(radar_tracking(), states=("px", "py"), filters=PARTICLES),
    "terrain": lambda: Case(*terrain(), budget=5 * BUDGET, states=("rN", "rE")),
    "growth": lambda: Case(growth()),
    "mixed": lambda: Case(mixed()),
    "seven of nine": lambda: Case(seven_of_nine()),
}

if __name__ == "__main__":
    summary = []
    for name in sys.argv[1:] or CASES:
        case = CASES[name]()
        pilot = mo.planning.Pilot(runs=32, inputs=case.inputs, filters=case.filters)
        found = mo.plan(case.model, case.budget, states=case.states, verify=True, pilot=pilot)
        print(f"\n{name}\n{found}", flush=True)
        errors = found.table.column("RMSE")
        summary.append((name, case.budget, found.seconds, found.measured, min(errors[1:], default=np.nan) / errors[0]))
    print("\nmodel             budget, ms  predicted  measured  measured / budget  best other RMSE / choice")
    for name, budget, seconds, measured, other in summary:
        print(f"{name:<18}{1e3 * budget:8.3f}{1e3 * seconds:11.3f}{1e3 * measured:10.3f}{measured / budget:16.2f}{other:20.3f}")
