"""Plans for five models: does the choice keep its budget, and is it the best that was tried? `python benchmarks/planning.py [NAME ...]`.

Prints each plan and at last, for each model: budget, predicted and measured time of the choice, best other RMSE over its own.
"""

import sys

import jax
import jax.numpy as jnp
import numpy as np

import motes as mo
from motes.applications.terrain_navigation import scenario
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
    """The terrain scenario of paper 003, its first 100 fixes."""
    flight = scenario.simulated(0)
    return flight.model, jax.tree.map(lambda leaf: leaf[:100], flight.inputs)


CASES = {
    "radar": lambda: (radar_tracking(), None), "radar, particles": lambda: (radar_tracking(), None), "terrain": terrain,
    "growth": lambda: (growth(), None), "mixed": lambda: (mixed(), None), "seven of nine": lambda: (seven_of_nine(), None),
}  # fmt: skip
# the extended Kalman filter, which wins on the radar model, has no number of particles that could keep a budget
FILTERS = {"radar, particles": {"plain": mo.ParticleFilter(n=1), "all": mo.MarginalizedParticleFilter(n=1),
                                "velocity": mo.MarginalizedParticleFilter(n=1, linear=("vx", "vy"))}}  # fmt: skip
STATES = {"radar, particles": ("px", "py"), "radar": ("px", "py"), "terrain": ("rN", "rE")}

if __name__ == "__main__":
    summary = []
    for name in sys.argv[1:] or CASES:
        model, inputs = CASES[name]()
        found = mo.plan(model, 5 * BUDGET if name == "terrain" else BUDGET, states=STATES.get(name, ()), verify=True,
                        pilot=mo.Pilot(runs=32, inputs=inputs, filters=FILTERS.get(name)))
        print(f"\n{name}\n{found}", flush=True)
        budget = 5 * BUDGET if name == "terrain" else BUDGET
        others = found.table.column("RMSE")
        summary.append((name, budget, found.seconds, found.measured, found.measured / budget, min(others[1:], default=np.nan) / others[0]))
    print("\nmodel          budget, ms  predicted  measured  measured / budget  best other RMSE / choice")
    for name, budget, seconds, measured, share, other in summary:
        print(f"{name:<15}{1e3 * budget:8.3f}{1e3 * seconds:11.3f}{1e3 * measured:10.3f}{share:16.2f}{other:20.3f}")
