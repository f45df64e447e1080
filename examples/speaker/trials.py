"""Many rendered recordings, every way to track in them, and what is counted."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import model
import numpy as np
from delays import FRAME, Heard, correlated, peaks
from room import ORDER, Room, heard
from voice import voice, walk

import motes as mo
from motes.laws.observed import Observed

RATE = 16_000
FIRST = 1.0
"""Seconds in which the speaker may be found first; errors count from then on."""
NEAR = 0.5
"""Meters within which a speaker is held."""
LAST = 2.0
"""Seconds at the end: a speaker is lost where the mean error is larger than NEAR then."""


class Worlds(NamedTuple):
    """Recordings of several runs as correlations, and the true places `(runs, t, 2)`."""

    heard: Heard
    path: np.ndarray


def rendered(room: Room, runs: int, seconds: float, reverberation: float, order: int = ORDER) -> Worlds:
    """Render runs of a voice that walks through a room."""
    found, paths = [], []
    steps, hop = round(seconds / FRAME), round(FRAME * RATE)
    for seed in range(runs):
        rng = np.random.default_rng(seed)
        sound = voice(rng, steps * FRAME, RATE)[: steps * hop]
        paths.append(walk(rng, room.size, FRAME, steps))
        found.append(correlated(heard(room, sound, paths[-1], RATE, reverberation, order, seed), RATE, room.longest))
    return Worlds(Heard(*map(np.stack, zip(*found, strict=True))), np.stack(paths))


def handed_over(worlds: Worlds) -> Worlds:
    """Return the same where the speaker of the next run takes over at half time, somewhere else."""
    half = worlds.path.shape[1] // 2
    after = lambda rows: np.concatenate([rows[:, :half], np.roll(rows, 1, axis=0)[:, half:]], axis=1)  # noqa: E731
    return Worlds(Heard(*map(after, worlds.heard)), after(worlds.path))


def tracked(filter: mo.Filter, room_model: mo.StateSpaceModel, ys: np.ndarray, heard: Heard, keep: Any = mo.keep.means) -> mo.History:
    """Run a filter over frames of all runs; silent ones measure nothing."""

    def one(row: Any) -> mo.History:
        key, y, sound, recent = row
        return mo.run(key, filter, room_model, Observed(y, sound), recent, keep=keep)

    keys = jax.random.split(jax.random.key(0), len(ys))
    return jax.jit(lambda rows: jax.lax.map(one, rows))((keys, *map(jnp.asarray, (ys, heard.sound, heard.recent))))


def ways(room: Room, worlds: Worlds, particles: int) -> dict[str, np.ndarray]:
    """Return where each way has the speaker `(runs, t, 2)`, by name."""
    correlation, three = worlds.heard.correlation, peaks(worlds.heard.correlation)
    filter, lost = model.tracker(particles), model.recovering(room, particles)
    runs = {
        "three peaks, clutter .7": (filter, model.peaked(room, 0.7), three),
        "three peaks, clutter .9": (filter, model.peaked(room, 0.9), three),
        "whole correlation": (filter, model.whole(room), correlation),
        "whole correlation, recovering": (lost, model.whole(room), correlation),
    }
    frames = np.stack([model.loudest(room, jnp.asarray(run)) for run in correlation])
    found = {"frame by frame": held_on(frames, worlds.heard.sound)}
    for name, (own, sensor, ys) in runs.items():
        found[name] = np.asarray(tracked(own, model.tracking(room, sensor), ys, worlds.heard).mean)[..., :2]
    return found


def held_on(places: np.ndarray, sound: np.ndarray) -> np.ndarray:
    """Return places `(runs, t, 2)` that stay where they are in silent frames."""
    last = np.maximum.accumulate(np.where(sound, np.arange(sound.shape[1]), 0), axis=1)
    return np.take_along_axis(places, last[..., None], axis=1)


def off(found: np.ndarray, worlds: Worlds) -> np.ndarray:
    """Return distances from the truth, meters, `(runs, t)`."""
    return np.linalg.norm(found - worlds.path, axis=-1)


def judged(found: np.ndarray, worlds: Worlds) -> tuple[float, float, float, int]:
    """Return mean over runs of the rms error while there is sound and at all times, share of time away, and runs that lose the speaker."""
    error, sound = off(found, worlds)[:, round(FIRST / FRAME) :], worlds.heard.sound[:, round(FIRST / FRAME) :]
    speaking = np.mean([np.sqrt(np.mean(row[loud] ** 2)) for row, loud in zip(error, sound, strict=True)])
    lost = np.sum(error[:, -round(LAST / FRAME) :].mean(axis=1) > NEAR)
    return float(speaking), float(np.sqrt((error**2).mean(axis=1)).mean()), float((error > NEAR).mean()), int(lost)


def found_again(found: np.ndarray, worlds: Worlds) -> float:
    """Return the median of seconds after half time until the speaker is held for nine tenths of a second, infinite where never."""
    span = round(1 / FRAME)
    near = (off(found, worlds) < NEAR)[:, worlds.path.shape[1] // 2 :]
    held = np.apply_along_axis(lambda row: np.convolve(row, np.ones(span), "valid") >= 0.9 * span, 1, near)
    return float(np.median(np.where(held.any(axis=1), held.argmax(axis=1) * FRAME, np.inf)))
