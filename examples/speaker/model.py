"""Where a speaker is: a walk, what pairs of microphones say of it, and a filter that finds a lost speaker again.

States are place (meters) and velocity (meters per second) in the plane of the mouth. Velocity is an Ornstein-Uhlenbeck process, the
Langevin motion of Vermaak, Blake 2001. A place x says with which delay direct sound reaches the microphones of a pair,

    tau(x) = (|x - m2| - |x - m1|) / c

and correlations r(lag) of a frame are held against it in two ways:

    whole correlation    log p = sharpness r(tau(x)) - log of the mean over lags of exp(sharpness r)
    peaks                p = clutter / lags + (1 - clutter) / 3 sum_j N(lag of the j-th peak; tau(x), 1 unit)

The first is the likelihood of phases that lie about those of a delay by von Mises's law, with a sharpness that counts frames for less than
they are: reflections come again in the next frame. The second is that of Ward, Lehmann, Williamson 2003.
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from delays import FRAME, PEAKS, STEPS, UNIT
from room import SOUND, Room

import motes as mo

STATES = ("x", "y", "vx", "vy")
FORGETS, SPEED = 1.5, 0.6
"""Of the walk: 1 / s in which velocity is forgotten, and its standard deviation in each direction, m/s."""
SHARPNESS, SURE = 3.0, 60.0
"""Of one frame; of the correlations of about half a second, of which a lost speaker is sought."""
SPREAD = 1.0
"""Standard deviation of a direct sound's delay, units."""
OUTSIDE = -50.0
"""Log likelihood of a speaker outside of the room."""
CELL = 0.1
"""Meters between the places where a lost speaker is sought."""


def walking() -> mo.LinearGaussian:
    """Return the law of place and velocity after a frame."""
    kept = jnp.exp(-FORGETS * FRAME)
    moved = (1 - kept) / FORGETS
    place = (2 * FORGETS * FRAME - 3 + 4 * kept - kept**2) / FORGETS**2
    cross, velocity = moved**2 * FORGETS, 1 - kept**2
    one = jnp.eye(2)
    A = jnp.block([[one, moved * one], [0 * one, kept * one]])
    return mo.LinearGaussian(A, SPEED**2 * jnp.block([[place * one, cross * one], [cross * one, velocity * one]]))


def delays(room: Room, X: jax.Array) -> jax.Array:
    """Return the delays of direct sound from states `(4, n)` or places `(2, n)`, units, `(pairs, n)`."""
    mouth = jnp.stack([X[0], X[1], jnp.full_like(X[0], room.mouth)])
    away = jnp.linalg.norm(mouth - jnp.asarray(room.microphones, X.dtype)[..., None], axis=2)
    return (away[:, 1] - away[:, 0]) / (SOUND * UNIT)


def inside(room: Room, X: jax.Array) -> jax.Array:
    """Return the log of a prior that knows the walls, `(n,)`."""
    return jnp.where(jnp.all((X[:2] >= 0) & (X[:2] <= jnp.asarray(room.size[:2, None])), axis=0), 0.0, OUTSIDE)


def at(room: Room, correlation: jax.Array, X: jax.Array) -> jax.Array:
    """Return correlations `(pairs, lags)` at the delays of states `(x, n)`, `(pairs, n)`."""
    place = (delays(room, X) * STEPS) + correlation.shape[1] // 2
    low = jnp.clip(jnp.floor(place).astype(int), 0, correlation.shape[1] - 2)
    near, far = (jnp.take_along_axis(correlation, low + step, axis=1) for step in (0, 1))
    return near + (place - low) * (far - near)


def whole(room: Room) -> mo.Custom:
    """Return the sensor that takes whole correlations `(pairs, lags)`."""

    def log_prob(y: jax.Array, X: jax.Array, u: Any, t: Any) -> jax.Array:
        usual = jax.scipy.special.logsumexp(SHARPNESS * y, axis=1) - jnp.log(y.shape[1])
        return jnp.sum(SHARPNESS * at(room, y, X) - usual[:, None], axis=0) + inside(room, X)

    return mo.Custom(log_prob=log_prob, batched=True)


def peaked(room: Room, clutter: float) -> mo.Custom:
    """Return the sensor that takes lags of peaks `(pairs, PEAKS)`, units; NaN is a peak that was not there.

    Args:
        room: with its microphones.
        clutter: probability that no peak of a pair is of direct sound.
    """
    lags = 2.0 * room.longest + 1

    def log_prob(y: jax.Array, X: jax.Array, u: Any, t: Any) -> jax.Array:
        off = (y[:, :, None] - delays(room, X)[:, None]) / SPREAD
        density = jnp.where(jnp.isnan(off), 1 / lags, jnp.exp(-0.5 * off**2) / (SPREAD * (2 * jnp.pi) ** 0.5))
        return jnp.sum(jnp.log(clutter / lags + (1 - clutter) / PEAKS * density.sum(axis=1)), axis=0) + inside(room, X)

    return mo.Custom(log_prob=log_prob, batched=True, partial=True)


def places(room: Room) -> jax.Array:
    """Return the middles of all cells of the room `(2, cells)`."""
    axes = [jnp.arange(CELL / 2, side, CELL) for side in room.size[:2]]
    return jnp.stack(jnp.meshgrid(*axes, indexing="ij")).reshape(2, -1)


def tracking(room: Room, sensor: mo.Custom) -> mo.StateSpaceModel:
    """Return the model of a speaker who may be anywhere in the room at first."""
    return mo.StateSpaceModel(mo.laws.Cloud.equal(standing(jax.random.key(0), places(room))), walking(), sensor, STATES)


def standing(key: jax.Array, place: jax.Array) -> jax.Array:
    """Return states at places `(2, n)` or at one `(2,)`, somewhere in their cells and at any speed."""
    cell, speed = jax.random.split(key)
    place = place + CELL * jax.random.uniform(cell, place.shape, minval=-0.5, maxval=0.5)
    return jnp.concatenate([place, SPEED * jax.random.normal(speed, place.shape)])


def tracker(particles: int) -> mo.ParticleFilter:
    """Return the filter; in a frame that no particle explains it waits for the next."""
    return mo.ParticleFilter(n=particles, on_collapse="predict")


def recovering(room: Room, particles: int) -> mo.Recovering:
    """Return the filter that finds a lost speaker: where correlations of the last half second, its inputs, say that somebody is."""
    return mo.Recovering(tracker(particles), somewhere(room), slow=0.003, fast=0.06, margin=1.3)


def somewhere(room: Room) -> Callable[..., jax.Array]:
    """Return a function that draws a state of a speaker of whom nothing is known but recent correlations."""
    cells = places(room)

    def drawn(key: jax.Array, y: Any, u: jax.Array, t: Any) -> jax.Array:
        where, how = jax.random.split(key)
        return standing(how, cells[:, jax.random.categorical(where, SURE * jnp.sum(at(room, u, cells), axis=0))])

    return drawn


def loudest(room: Room, correlation: jax.Array) -> jax.Array:
    """Localize frame by frame: the cell with the largest sum of correlations `(t, pairs, lags)` (SRP-PHAT), `(t, 2)`."""
    cells = places(room)
    return jax.lax.map(lambda frame: cells[:, jnp.argmax(jnp.sum(at(room, frame, cells), axis=0))], correlation)
