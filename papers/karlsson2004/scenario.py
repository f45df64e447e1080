"""The scenarios of tables II and III: what the paper leaves open, filled in.

The paper prints neither the period, nor the number of steps, nor start and prior, nor the way of resampling. Here: half a second, 100
steps, systematic resampling at every step, one fixed track drawn from the model, 100 sets of measurements.
"""

import jax
import jax.numpy as jnp
import numpy as np
from printed import KALMAN

import motes as mo
from motes.core.record import replace
from motes.models.textbook import radar_tracking

STEPS = 100
BLOCKS = {"position": ("px", "py"), "velocity": ("vx", "vy"), "acceleration": ("ax", "ay")}
NEAR, TRACKS = 300.0, 24
"""A close track comes nearer to the radar than so many meters; it is looked for among so many."""


def model(scenario: str) -> mo.StateSpaceModel:
    """Return the radar model with the prior mean of a scenario: "short", "close" (the same) or "long"."""
    radar = radar_tracking()
    if scenario != "long":
        return radar
    return replace(radar, initial=mo.Gaussian(jnp.array([2000.0, 2000, 20, 20, 0, 0]), radar.initial.cov()))


def track(seed: int, scenario: str = "short") -> jax.Array:
    """Draw a track from the model, `(t, x)`."""
    return mo.simulate(seed, model(scenario), STEPS)[0]


def nearest(xs: jax.Array) -> float:
    """Return how near a track comes to the radar, in meters."""
    return float(np.hypot(*np.asarray(xs).T[:2]).min())


def fixed_track(scenario: str) -> jax.Array:
    """Return the track of all runs of a scenario: that of seed 0, for "close" the first one that comes nearer than `NEAR`."""
    if scenario != "close":
        return track(0, scenario)
    return next(xs for xs in map(track, range(TRACKS)) if nearest(xs) < NEAR)


def make_filter(partition: str, n: int) -> mo.Filter:
    """Return the filter of a partition with n particles, which resamples at every step."""
    if not KALMAN[partition]:
        return mo.ParticleFilter(n, policy=mo.resampling.Always())
    return mo.MarginalizedParticleFilter(n, KALMAN[partition], policy=mo.resampling.Always())


def experiment(scenario: str, sizes: dict[str, int], runs: int, xs: jax.Array | None = None) -> mo.Experiment:
    """Return the runs of some partitions, with their numbers of particles, on the track of a scenario or on another one."""
    filters = {name: make_filter(name, n) for name, n in sizes.items()}
    chosen = fixed_track(scenario) if xs is None else xs
    return mo.Experiment(model(scenario), filters, STEPS, runs, track=chosen, blocks=BLOCKS)
