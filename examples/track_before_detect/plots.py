"""What track before detect stands beside: plots of each frame first, tracks through the plots after.

A matched filter sums the light that a target would spread; where its output is a local maximum above a threshold stands a plot, refined
to a fraction of a pixel by a parabola. The tracker is the strongest that places of plots allow: the same particle filter with the same
model of targets, which sums over which plot is the target's, if any, and carries the probability that there is one (integrated
probabilistic data association: Musicki, Evans, Stankovic 1994). Probability of detection, number of false plots and accuracy are measured
for each threshold and each brightness, so that this tracker knows how bright its target is; track before detect is not told.
"""

from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from model import REACH, Target

import motes as mo

NEAR = 3.0
"""Pixels from a target within which a plot may be its own."""


@dataclass(frozen=True)
class Detector:
    """Numbers of a threshold, at one brightness.

    Attributes:
        threshold: on the matched filter's output, in standard deviations of its noise.
        room: most plots of a frame.
        detection: probability that a target gives a plot.
        false: false plots in a frame of noise, on average.
        variance: of each component of a target's plot, pixels^2.
    """

    threshold: float
    room: int
    detection: float
    false: float
    variance: float


def matched(target: Target, frames: jax.Array) -> jax.Array:
    """Return the matched filter's output `(t, size, size)` in standard deviations of its noise."""
    places = jnp.arange(target.size)
    offsets = places[:, None] - places
    kernel = jnp.where(jnp.abs(offsets) <= REACH, jnp.exp(-0.5 * (offsets / target.spread) ** 2), 0.0)
    norms = jnp.sqrt(jnp.sum(kernel**2, axis=1))
    return jnp.einsum("ai,tij,bj->tab", kernel, frames, kernel) / (norms[:, None] * norms)


def plots(target: Target, frames: jax.Array, threshold: float, room: int) -> jax.Array:
    """Return the plots `(t, room, 2)` of frames `(t, size, size)`, the strongest first, NaN where there are no more."""
    output = matched(target, frames)
    t, size = len(frames), target.size
    wide = jnp.pad(output, ((0, 0), (1, 1), (1, 1)), constant_values=-jnp.inf)
    around = [wide[:, 1 + i : 1 + i + size, 1 + j : 1 + j + size] for i in (-1, 0, 1) for j in (-1, 0, 1)]
    strength = jnp.where((output > threshold) & (output >= jnp.max(jnp.stack(around), axis=0)), output, -jnp.inf)
    best, cells = jax.lax.top_k(strength.reshape(t, -1), room)

    def part(before: jax.Array, after: jax.Array) -> jax.Array:
        bend = jnp.minimum(before + after - 2 * output, -1e-3)
        return jnp.where(jnp.isfinite(bend), jnp.clip(0.5 * (before - after) / bend, -0.5, 0.5), 0.0)

    shifts = [part(around[3], around[5]), part(around[1], around[7])]
    whole = jnp.stack([cells % size, cells // size], axis=-1)
    found = whole + jnp.stack([jnp.take_along_axis(shift.reshape(t, -1), cells, axis=1) for shift in shifts], axis=-1)
    return jnp.where(jnp.isfinite(best)[..., None], found, jnp.nan)


def measured(target: Target, threshold: float, noise: jax.Array, bright: jax.Array, places: jax.Array) -> Detector:
    """Measure the numbers of a threshold.

    Args:
        target: what is known of targets.
        threshold: of the detector.
        noise: frames without a target `(t, size, size)`.
        bright: frames with one.
        places: of the targets `(t, 2)`.
    """
    counts = np.isfinite(np.asarray(plots(target, noise, threshold, target.size**2 // 4))[..., 0]).sum(axis=1)
    off = np.asarray(plots(target, bright, threshold, target.size**2 // 4)) - np.asarray(places)[:, None]
    near = np.where(np.isfinite(off[..., 0]), np.hypot(*np.moveaxis(off, -1, 0)), np.inf)
    own = off[np.arange(len(off)), near.argmin(axis=1)][near.min(axis=1) < NEAR]
    # of false plots some lie near by chance
    chance = 1 - np.exp(-counts.mean() * np.pi * NEAR**2 / target.size**2)
    detection = np.clip((len(own) / len(off) - chance) / (1 - chance), 0.02, 0.999)
    room = mo.laws.cluttered.room_for(float(counts.mean())) + 1
    return Detector(threshold, max(room, int(counts.max()) + 1), float(detection), float(counts.mean()), float(np.median(own**2) / 0.455))


def sensor(target: Target, detector: Detector) -> mo.Cluttered:
    """Return the sensor of plots: a target that does not exist gives none."""
    place = mo.AdditiveGaussian(lambda x, u, t: x[:2], detector.variance * jnp.eye(2))
    frame = mo.Uniform(jnp.full(2, -0.5 - 1e-3), jnp.full(2, target.size - 0.5 + 1e-3))

    def detection(x: jax.Array, u: Any, t: Any) -> jax.Array:
        return detector.detection * x[5]

    return mo.Cluttered(place, detection, clutter=(detector.false, frame), plots=detector.room)
