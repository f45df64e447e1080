"""The real recordings: an airliner that turns, and a river whose level breaks."""

from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

import motes as mo
from motes.applications.aircraft import scenario
from motes.applications.aircraft.model import Flight, Radar, constant_velocity, jumping

FLIGHT = "aircraft/adsb/belevingsvlucht.csv"
PLOTS = 1660


def aircraft(data: Path, seeds: int) -> mo.io.Table:
    """Trackers on radar plots drawn from a recorded flight, each seed with plots and particles of its own."""
    path, radar, flight = scenario.read_path(data / FLIGHT), Radar(), Flight()
    flights = jax.tree.map(lambda *leaves: jnp.stack([jnp.asarray(leaf) for leaf in leaves]),
                           *[scenario.track(path, seed, PLOTS, radar) for seed in range(seeds)])  # fmt: skip
    trackers = {
        "extended Kalman, q = 10": (mo.ExtendedKalmanFilter(on_collapse="predict"), lambda start: constant_velocity(start, 10.0, radar)),
        "extended Kalman, q = 30": (mo.ExtendedKalmanFilter(on_collapse="predict"), lambda start: constant_velocity(start, 30.0, radar)),
        "interacting models": (mo.InteractingMultipleModel(on_collapse="predict"), lambda start: jumping(start, flight, radar)),
        "jump-Markov, 200": (
            mo.JumpMarkovFilter(n=200, sampled=("turn",), on_collapse="predict"), lambda start: jumping(start, flight, radar)),
        "constant velocity, q = 5, 1000 particles": (
            mo.ParticleFilter(n=1000, on_collapse="predict"), lambda start: constant_velocity(start, 5.0, radar)),
    }  # fmt: skip
    rows = []
    for name, (tracker, build) in trackers.items():

        def one(key, track, tracker=tracker, build=build):
            history = mo.run(key, tracker, build(track.start), track.ys, track.dt)
            return scenario.score(history.mean, track), history

        scores, histories = jax.jit(jax.vmap(one))(jax.random.split(jax.random.key(0), seeds), flights)
        position, velocity, worst = (np.asarray(part, np.float64) for part in scores)
        first = mo.diagnose(jax.tree.map(lambda leaf: leaf[0], histories))
        says = ", ".join(finding.name for finding in first.findings if finding.serious) or "trusted"
        lost = int((worst > scenario.LOST).sum())
        rows.append((name, float(position.mean()), float(position.std(ddof=1)), float(velocity.mean()), float(worst.max()), lost, says))
    columns = ("tracker", "position, m", "s.d.", "velocity, m/s", "largest error, m", "lost", "diagnosis of the first run")
    return mo.io.Table(columns, tuple(rows))


def river(seeds: int) -> mo.io.Table:
    """Log likelihood of the Nile's flow with rare breaks of its level, against a grid."""
    flow = mo.data.nile().values
    start, sensor = mo.Gaussian([1000.0], [[200.0**2]]), mo.LinearGaussian([[1.0]], [[15099.0]])
    steady, broken = 100.0, 100.0 + 300.0**2
    models = tuple(mo.StateSpaceModel(start, mo.LinearGaussian([[1.0]], [[q]]), sensor, ("level",)) for q in (steady, broken))
    breaks = mo.JumpMarkovModel([0.98, 0.02], [[0.98, 0.02], [0.98, 0.02]], models)
    steps = mo.Mixture.of([0.98, 0.02], [[0.0, 0.0]], [[[steady, broken]]])
    joined = mo.StateSpaceModel(start, mo.AdditiveNoise(lambda x, u, t: x, steps), sensor, ("level",))
    exact = float(mo.run(0, mo.PointMassFilter(-200.0, 2200.0, 1201), joined, flow).log_likelihood)
    rows: list[tuple[str, float, float, float]] = [("grid of 1201 nodes", exact, 0.0, 0.0)]
    rows.append(("interacting models", float(mo.run(0, mo.InteractingMultipleModel(), breaks, flow).log_likelihood), 0.0, 0.0))
    for n in (20, 100, 500, 2000):
        keys = jax.random.split(jax.random.key(3), seeds)
        found = jax.jit(jax.vmap(lambda key, n=n: mo.run(key, mo.JumpMarkovFilter(n=n), breaks, jnp.asarray(flow)).log_likelihood))(keys)
        told = np.asarray(found, np.float64)
        rows.append((f"jump-Markov, {n}", float(told.mean()), float(told.std(ddof=1)), float(np.abs(told - exact).max())))
    return mo.io.Table(("filter", "log likelihood", "s.d. over seeds", "largest distance from the grid"), tuple(rows))
