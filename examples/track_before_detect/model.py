"""A dim target that appears and vanishes, frames in which it cannot be seen, and a proposal that says where to look for it.

Six states: place (pixels), velocity (pixels per frame), peak (in standard deviations of a pixel's noise), and whether the target exists,
0 or 1; the others are zero where it does not. Its light is spread by a Gaussian of one pixel. A frame is measured as it is, by the
likelihood ratio of its pixels with the target over those without (Salmond, Birch 2001): only those near the target differ from one.
"""

from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp

import motes as mo
from motes.core import random
from motes.core.record import static
from motes.laws.cloud import draw

STATES = ("px", "py", "vx", "vy", "peak", "exists")
REACH = 3
"""Pixels on each side of a target whose light counts; beyond them it has less than 1.1 percent of its peak."""


@dataclass(frozen=True)
class Target:
    """What a filter is told of targets.

    Attributes:
        size: pixels on each side of a frame; place (0, 0) is the middle of its first pixel.
        spread: standard deviation of the point spread, pixels.
        appears: probability of a target in a frame after one without.
        vanishes: probability of none in a frame after one with it.
        velocity: mean of each component when it appears, pixels per frame.
        speed: standard deviation of each component when it appears, pixels per frame.
        wander: standard deviations of what a frame adds to place and velocity, pixels and pixels per frame.
        peaks: least and largest peak of a target that appears, in standard deviations of the noise.
        flicker: standard deviation of what a frame adds to the peak.
    """

    size: int = 24
    spread: float = 1.0
    appears: float = 0.02
    vanishes: float = 0.03
    velocity: tuple[float, float] = (0.0, 0.0)
    speed: float = 0.3
    wander: tuple[float, float] = (0.03, 0.02)
    peaks: tuple[float, float] = (1.0, 4.0)
    flicker: float = 0.05


def newborn(target: Target, key: jax.Array, n: int) -> jax.Array:
    """Draw n targets that appear, `(6, n)`: anywhere in the frame."""
    numbers = random.uniform(random.child(key, 0), (3, n), jnp.float32)
    place = numbers[:2] * target.size - 0.5
    velocity = jnp.asarray(target.velocity)[:, None] + target.speed * random.normal(random.child(key, 1), (2, n), jnp.float32)
    low, high = target.peaks
    return jnp.concatenate([place, velocity, low + (high - low) * numbers[2:], jnp.ones((1, n))])


def moved(target: Target, key: jax.Array, X: jax.Array) -> jax.Array:
    """Move targets `(6, n)` that go on existing by one frame."""
    noise = random.normal(key, (5, X.shape[1]), X.dtype)
    place, velocity = target.wander
    steps = jnp.concatenate([X[2:4] + place * noise[:2], velocity * noise[2:4], target.flicker * noise[4:]])
    return X.at[:5].add(steps).at[4].max(0.0)


def next_states(target: Target, key: jax.Array, X: jax.Array, born: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Move targets `(6, n)` by one frame; where there is none one appears with probability `born`.

    Returns:
        The states, who appeared, and who is not there after not having been there before.
    """
    n, there = X.shape[1], X[5] > 0.5
    luck = random.uniform(random.child(key, 0), (n,), X.dtype)
    stays, appears = there & (luck >= target.vanishes), ~there & (luck < born)
    after = jnp.where(stays, moved(target, random.child(key, 1), X), 0.0)
    return jnp.where(appears, newborn(target, random.child(key, 2), n), after), appears, ~there & ~appears


def dynamics(target: Target) -> mo.Custom:
    """Return the law of the state after a frame."""
    return mo.Custom(lambda key, X, u, t: next_states(target, key, X, target.appears)[0], batched=True)


def light(target: Target, X: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array, jax.Array]:
    """Return the pixels near targets `(6, n)`: rows and columns `(w, n)`, and the shares of the peak `(w, n)` down and across."""

    def across(place: jax.Array) -> tuple[jax.Array, jax.Array]:
        pixels = jnp.round(place).astype(jnp.int32) + jnp.arange(-REACH, REACH + 1)[:, None]
        inside = (pixels >= 0) & (pixels < target.size)
        share = jnp.exp(-0.5 * ((pixels - place) / target.spread) ** 2)
        return jnp.clip(pixels, 0, target.size - 1), jnp.where(inside, share, 0.0)

    (columns, right), (rows, down) = across(X[0]), across(X[1])
    return rows, columns, down, right


def frames(target: Target) -> mo.Custom:
    """Return the sensor: frames `(size, size)` of unit noise, by the log of their likelihood ratio over a frame of noise alone."""

    def sample(key: jax.Array, X: jax.Array, u: Any, t: Any) -> jax.Array:
        n = X.shape[1]
        rows, columns, down, right = light(target, X)
        noise = random.normal(key, (target.size, target.size, n), X.dtype)
        return noise.at[rows[:, None], columns[None], jnp.arange(n)].add(X[4] * X[5] * down[:, None] * right[None])

    def log_ratio(frame: jax.Array, X: jax.Array, u: Any, t: Any) -> jax.Array:
        rows, columns, down, right = light(target, X)
        matched = jnp.sum(frame[rows[:, None], columns[None]] * down[:, None] * right[None], axis=(0, 1))
        energy = jnp.sum(down**2, axis=0) * jnp.sum(right**2, axis=0)
        return X[5] * X[4] * (matched - 0.5 * X[4] * energy)

    return mo.Custom(sample, log_ratio, batched=True)


@mo.record
class Looking(mo.filters.Proposal):
    """Lets targets appear where the measurement speaks for them, and more often than they do; weights make up for both.

    Attributes:
        target: what is known of targets.
        born: probability with which a target is tried where there is none.
        anywhere: share of those that are tried anywhere in the frame.
    """

    target: Target = static(default=Target())
    born: float = 0.3
    anywhere: float = 0.2

    def proposed(self, key: jax.Array, model: mo.StateSpaceModel, X: jax.Array, y: Any, u: Any, t: Any) -> mo.filters.Proposed:
        """Move particles; see `mo.filters.Proposal`."""
        target, size, n = self.target, self.target.size, X.shape[1]
        after, appears, waits = next_states(target, random.child(key, 0), X, self.born)
        # where to look: the likelihood of a target of middling peak in the middle of each pixel
        grid = jnp.stack(jnp.meshgrid(jnp.arange(size), jnp.arange(size), indexing="ij")).reshape(2, -1).astype(X.dtype)
        still = jnp.zeros((2, size**2)), jnp.full((1, size**2), sum(target.peaks) / 2), jnp.ones((1, size**2))
        shares = jax.nn.softmax(model.sensor.log_prob(y, jnp.concatenate([grid, *still]), u, t))
        shares = self.anywhere / size**2 + (1 - self.anywhere) * shares
        within = random.uniform(random.child(key, 2), (2, n), X.dtype) - 0.5
        cell = draw(random.child(key, 1), jnp.log(shares), n)
        after = after.at[:2].set(jnp.where(appears, grid[:, cell] + within, after[:2]))
        tried = jnp.log(target.appears / self.born) - jnp.log(size**2 * shares[cell])
        waited = jnp.log((1 - target.appears) / (1 - self.born))
        log_weight = model.sensor.log_prob(y, after, u, t) + jnp.where(appears, tried, 0.0) + jnp.where(waits, waited, 0.0)
        return mo.filters.Proposed(after, log_weight, jnp.full((), jnp.inf))


def tracking(target: Target, sensor: Any) -> mo.StateSpaceModel:
    """Return the model of a target that is not there in the first frame, and any sensor of it."""
    nothing = mo.Gaussian(jnp.zeros(6), jnp.zeros((6, 6)))
    return mo.StateSpaceModel(nothing, dynamics(target), sensor, STATES)


def tracker(target: Target, n: int) -> mo.ParticleFilter:
    """Return a filter of n particles."""
    return mo.ParticleFilter(n=n, proposal=Looking(target))


def existence(law: Any) -> dict[str, jax.Array]:
    """Keep the probability that the target exists, `()`, and its mean place if it does, `(2,)`."""
    X, there = law.particles, law.weights * law.particles[5]
    total = jnp.sum(there)
    return {"exists": total, "place": X[:2] @ there / jnp.maximum(total, 1e-12)}
