"""Many runs of both trackers on the same frames, and what is counted of them."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from model import Target, existence, frames, tracker, tracking
from plots import Detector, plots, sensor

import motes as mo
from motes.laws.observed import Observed

STEPS, APPEARS, VANISHES = 55, 12, 42
"""Frames of a run; the first with the target, and the first without it again."""
SPEED = 0.35
HELD = 3.0
"""Pixels within which an estimate is one of the target."""
GONE = 0.05
"""Probability of existence below which a track ends."""
PATIENCE = 5
"""Frames without the target after which its track is lost."""


class Found(NamedTuple):
    """Probabilities of existence `(runs, t)` and mean places `(runs, t, 2)`."""

    exists: np.ndarray
    place: np.ndarray


def path(target: Target, peak: float, key: jax.Array) -> jax.Array:
    """Draw the states `(t, 6)` of a target that crosses the middle of the frame in any direction, curving a little."""
    life, middle = VANISHES - APPEARS, (VANISHES - APPEARS) // 2
    keys = jax.random.split(key, 3)
    center = target.size / 2 - 0.5 + jax.random.uniform(keys[0], (2,), minval=-1, maxval=1) * target.size / 8
    heading = jax.random.uniform(keys[1], maxval=2 * jnp.pi)
    turns = target.wander[1] * jnp.cumsum(jax.random.normal(keys[2], (life, 2)), axis=0)
    velocity = SPEED * jnp.stack([jnp.cos(heading), jnp.sin(heading)]) + turns - turns[middle]
    place = jnp.cumsum(velocity, axis=0)
    states = jnp.concatenate([place - place[middle] + center, velocity, jnp.full((life, 1), peak), jnp.ones((life, 1))], axis=1)
    return jnp.zeros((STEPS, 6)).at[APPEARS:VANISHES].set(states)


def worlds(target: Target, peak: float, seed: int, runs: int) -> tuple[jax.Array, jax.Array]:
    """Draw true states `(runs, t, 6)` and frames `(runs, t, size, size)`; a peak of 0 is frames of noise alone."""
    draw = frames(target).sample

    def one(key: jax.Array) -> tuple[jax.Array, jax.Array]:
        keys = jax.random.split(key)
        states = path(target, peak, keys[0])
        return states, jnp.moveaxis(draw(keys[1], states.T, None, 0), -1, 0)

    return jax.jit(lambda keys: jax.lax.map(one, keys))(jax.random.split(jax.random.key(seed), runs))


def over_runs(model: mo.StateSpaceModel, filter: mo.Filter, ys: Any, seed: int = 0) -> Found:
    """Run a filter on the measurements of all runs, each with a key of its own."""

    def one(row: Any) -> tuple[jax.Array, jax.Array]:
        kept = mo.run(row[0], filter, model, row[1], keep=existence).kept
        return kept["exists"], kept["place"]

    keys = jax.random.split(jax.random.key(seed), len(jax.tree.leaves(ys)[0]))
    return Found(*(np.asarray(each) for each in jax.jit(lambda rows: jax.lax.map(one, rows))((keys, ys))))


def before_detect(target: Target, n: int, films: jax.Array) -> Found:
    """Track on the frames themselves."""
    return over_runs(tracking(target, frames(target)), tracker(target, n), Observed(films, jnp.ones(films.shape[:2], bool)))


def through_plots(target: Target, n: int, films: jax.Array, detector: Detector) -> Found:
    """Track through plots of the frames."""
    found = jax.lax.map(lambda film: plots(target, film, detector.threshold, detector.room), films)
    ys = Observed(found, jnp.ones(found.shape[:2], bool))
    return over_runs(tracking(target, sensor(target, detector)), tracker(target, n), ys)


def declared(exists: np.ndarray, threshold: float) -> np.ndarray:
    """Tell where there is a track `(runs, t)`: it begins where existence is more probable than a threshold, and ends below GONE."""
    there, now = np.zeros(exists.shape, bool), np.zeros(len(exists), bool)
    for step, probability in enumerate(exists.T):
        now = np.where(now, probability >= GONE, probability > threshold)
        there[:, step] = now
    return there


def false_tracks(exists: np.ndarray, threshold: float) -> int:
    """Count tracks that begin in runs without a target."""
    there = declared(exists, threshold)
    return int(there[:, 0].sum() + (there[:, 1:] & ~there[:, :-1]).sum())


def threshold_for(exists: np.ndarray, rate: float) -> float:
    """Return the lowest threshold on the probability of existence at which runs without a target have at most `rate` tracks a frame."""
    levels = 1 - np.geomspace(0.9, 1e-4, 200)
    enough = [level for level in levels if false_tracks(exists, level) <= rate * exists.size]
    return float(enough[0]) if enough else 1.0


class Score(NamedTuple):
    """What is counted of the runs with a target.

    Attributes:
        missed: runs without a frame in which the target is held.
        delay: frames from its appearance to the first in which it is held, mean; a missed one counts its whole life.
        lost: runs in which it was held and then not for PATIENCE frames of its life in a row, or not in the last ones.
        held: share of the frames of its life in which it is held.
        error: root mean square distance of the estimate where it is held, pixels.
        after: frames from its vanishing to the end of its track, mean, where it was held in the last frame.
    """

    missed: int
    delay: float
    lost: int
    held: float
    error: float
    after: float


def first_held(held: np.ndarray) -> np.ndarray:
    """Return the frames from the target's appearance to the first in which it is held `(runs,)`; its whole life if it never is."""
    life = held[:, APPEARS:VANISHES]
    return np.where(life.any(axis=1), life.argmax(axis=1), life.shape[1])


def scored(found: Found, threshold: float, truth: np.ndarray) -> tuple[Score, np.ndarray, np.ndarray]:
    """Count what there is to count; returns too where the target is held `(runs, t)`, and distances `(runs, t)`."""
    track = declared(found.exists, threshold)
    distance = np.linalg.norm(found.place - truth[..., :2], axis=-1)
    held = track & (distance < HELD) & (truth[..., 5] > 0)
    life = held[:, APPEARS:VANISHES]
    first = first_held(held)
    lost = 0
    for row, start in zip(life, first, strict=True):
        gaps = np.convolve(~row[start:], np.ones(PATIENCE)) if start < len(row) else np.zeros(1)
        lost += bool(gaps.max() >= PATIENCE)
    ended = np.array([row.argmin() if not row.all() else len(row) for row in track[:, VANISHES:]])
    last = held[:, VANISHES - 1]
    error = np.sqrt(np.mean(distance[held] ** 2)) if held.any() else np.nan
    after = ended[last].mean() if last.any() else np.nan
    missed = int((~life.any(axis=1)).sum())
    return Score(missed, float(first.mean()), lost, float(life.mean()), float(error), float(after)), held, distance
