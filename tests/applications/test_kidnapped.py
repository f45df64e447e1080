"""A robot that does not know where it starts, and is carried away: ranges to known beacons and augmented recovery, in thirty lines."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import motes as mo
from data import recorded
from motes.applications.robot import scenario as job
from motes.applications.robot.world import simulated
from motes.io.recordings import read_plaza
from tiers import NIGHT

RANGE_SD, PARTICLES, CARRIED, AT = 0.54 * 1.5, 5_000, 31.0, 3_198
SCALE = 0.07
"""These radios read long."""


def localizer(beacons, scale, low, high):
    """What a user writes: a robot of place and heading, and a filter that draws particles on the ring of the present range."""

    def drive(x, u, t):
        course = x[2] + u.turn / 2
        return jnp.stack([x[0] + u.forward * jnp.cos(course), x[1] + u.forward * jnp.sin(course), x[2] + u.turn])

    def slip(x, u, t):
        place = 0.1**2 * (jnp.abs(u.forward) + u.dt)
        return jnp.diag(jnp.stack([place, place, 0.01**2 * u.dt + 0.03**2 * jnp.abs(u.turn)]))

    def ranges(x, u, t):
        return (1 + scale) * jnp.hypot(x[0] - beacons[:, 0], x[1] - beacons[:, 1])

    def on_the_ring(key, y, u, t):
        place, heading = jax.random.uniform(key, (2,), minval=-jnp.pi, maxval=jnp.pi)
        beacon = jnp.argmax(~jnp.isnan(y))
        radius = y[beacon] / (1 + scale)
        return jnp.concatenate([beacons[beacon] + radius * jnp.stack([jnp.cos(place), jnp.sin(place)]), heading[None]])

    anywhere = np.random.default_rng(0).uniform([*low, -np.pi], [*high, np.pi], (50_000, 3))
    model = mo.StateSpaceModel(
        mo.laws.Cloud.equal(jnp.asarray(anywhere.T, jnp.float32)),
        mo.AdditiveGaussian(drive, slip, angles=(2,)),
        mo.AdditiveGaussian(ranges, RANGE_SD**2 * jnp.eye(len(beacons))),
        ("px", "py", "heading"),
    )
    return model, mo.Recovering(mo.ParticleFilter(n=PARTICLES, on_collapse="predict"), on_the_ring)


def carried(scenario, at):
    """Cut out a part of the way, so that the robot is elsewhere from one step to the next; true places `(t, 2)` beside it."""
    place = np.stack([np.interp(scenario.times, scenario.times[scenario.scored], axis) for axis in scenario.truth[:, :2].T], axis=1)
    away = at + int(np.argmax(np.hypot(*(place[at:] - place[at]).T) > CARRIED))
    rows = np.concatenate([np.arange(at), np.arange(away, len(place))])
    inputs = jax.tree.map(lambda leaf: jnp.asarray(np.asarray(leaf)[rows]), scenario.inputs)
    gone = np.where(np.arange(len(rows)) >= at, scenario.times[away] - scenario.times[at], 0)
    return scenario.ys[rows], inputs, scenario.times[rows] - gone, place[rows]


def found(history, times, place, begin):
    """Seconds until the error stays below 2 m for 10 s, from a step on, and the root mean square from then on."""
    error = np.hypot(*(np.asarray(history.mean)[:, :2] - place).T)
    good = error < 2.0
    for step in range(begin, len(times)):
        if good[step : np.searchsorted(times, times[step] + 10)].all():
            return times[step] - times[begin], float(np.sqrt(np.mean(error[step:] ** 2)))
    return np.inf, np.inf


def seeds_of(scenario, at, seeds):
    ys, inputs, times, place = carried(scenario, at)
    low, high = place.min(axis=0) - 15, place.max(axis=0) + 15
    model, filter = localizer(jnp.asarray(scenario.beacons, jnp.float32), SCALE, low, high)
    return [(found(history, times, place, 0), found(history, times, place, at))
            for history in (mo.run(seed, filter, model, ys, inputs) for seed in range(seeds))]  # fmt: skip


@pytest.mark.optimized
def test_a_made_up_robot_is_found_again():
    results = seeds_of(job.of_recording(simulated(1, seconds=500.0)), 2_000, 3 if NIGHT else 1)
    assert all(first[0] < 200 and again[0] < 60 and again[1] < 2.0 for first, again in results), results


@pytest.mark.optimized
@pytest.mark.night
def test_the_robot_of_plaza_is_found_again():
    """Of 20 seeds 19 are found again within 60 s, and are then within 0.8 m (root mean square)."""
    scenario = job.of_recording(read_plaza(recorded("robot/Plaza1_.mat")))
    results = seeds_of(scenario, AT, 20 if NIGHT else 3)
    good = [again[0] <= 60 and again[1] <= 0.8 for _, again in results]
    assert sum(good) >= 19, results
