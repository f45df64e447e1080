"""The bits of a message as the modes of a jump-Markov system: complex amplitude and frequency of the carrier are tracked beside them.

    a_t = a_{t-1} turned by 2 w_{t-1}, + noise,   w_t = w_{t-1} + noise,   b_t in {0, 1} evenly,
    y_t = (a_t p0, a_t turned by w_t, p1) + noise,   p0 = (1 - d) b_t + d (1 - b_{t-1}),   p1 = d b_t + (1 - d) (1 - b_t)

A bit has two samples; d is how far pulses begin after a sample, so that the last half of the bit before reaches into the first sample.
Bits are states without variance. Messages come one after the other: with the first bit of each its preamble says where a and w begin.
"""

import jax
import jax.numpy as jnp
import numpy as np

from motes.applications.mode_s.preambles import BITS, HEAD, Preambles
from motes.laws.conditional import AdditiveGaussian
from motes.laws.gaussian import Gaussian
from motes.models.jump_markov import JumpMarkovModel
from motes.models.state_space import StateSpaceModel

STATES = ("re", "im", "turn", "bit", "before")
START_SD, START_TURN_SD = 0.2, 0.02
"""Of what a preamble says: of the amplitude, as a share of it; radians a sample."""
DRIFT, TURN_DRIFT = 0.03, 0.003
"""Of a bit: of the amplitude, as a share; radians a sample."""
SHAPE = 0.15
"""By how much a pulse differs from a rectangle, as a share of its height."""


def bits() -> JumpMarkovModel:
    """Return the model; its inputs are those of `series`."""

    def moved(x: jax.Array, u: dict[str, jax.Array], t: jax.Array, mode: jax.Array) -> jax.Array:
        turned = _turned(x[:2], 2 * x[2])
        carrier = jnp.where(u["first"], u["start"], jnp.concatenate([turned, x[2:3]]))
        # before the first bit it is silent, as after a one
        return jnp.concatenate([carrier, jnp.stack([jnp.asarray(mode, x.dtype), jnp.where(u["first"], 1.0, x[3])])])

    def noise(x: jax.Array, u: dict[str, jax.Array], t: jax.Array) -> jax.Array:
        begin, later = ([size * u["level"], size * u["level"], jnp.asarray(turn, x.dtype)]
                        for size, turn in ((START_SD / jnp.sqrt(2.0), START_TURN_SD), (DRIFT / jnp.sqrt(2.0), TURN_DRIFT)))  # fmt: skip
        sd = jnp.where(u["first"], jnp.stack(begin), jnp.stack(later))
        return jnp.diag(jnp.concatenate([sd**2, jnp.zeros(2, x.dtype)]))

    def seen(x: jax.Array, u: dict[str, jax.Array], t: jax.Array) -> jax.Array:
        shift, bit, before = u["shift"], x[3], x[4]
        first, second = (1 - shift) * bit + shift * (1 - before), shift * bit + (1 - shift) * (1 - bit)
        return jnp.concatenate([first * x[:2], second * _turned(x[:2], x[2])])

    def spread(x: jax.Array, u: dict[str, jax.Array], t: jax.Array) -> jax.Array:
        return jnp.eye(4, dtype=x.dtype) * (u["noise"] + (SHAPE * u["level"]) ** 2) / 2

    known = Gaussian(np.zeros(5, np.float32), np.zeros((5, 5), np.float32))
    one = StateSpaceModel(known, AdditiveGaussian(moved, noise), AdditiveGaussian(seen, spread), STATES)
    return JumpMarkovModel([0.5, 0.5], np.full((2, 2), 0.5), model=one, modes=2)


def series(samples: np.ndarray, found: Preambles, noise: float) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Put the messages one behind the other, after one step in which nothing is measured.

    Args:
        samples: complex, `(t,)`.
        found: where they begin.
        noise: power a sample, at the least: where more is about a preamble that no pulse explains, as much counts as noise.

    Returns:
        Measurements `(1 + 112 k, 4)`, and inputs.
    """
    count = len(found.sample)
    halves = samples[found.sample[:, None] + HEAD + np.arange(2 * BITS)].reshape(count * BITS, 2)
    rows = np.stack([np.real(halves[:, 0]), np.imag(halves[:, 0]), np.real(halves[:, 1]), np.imag(halves[:, 1])], axis=1)
    start = found.amplitude * np.exp(1j * found.turn * HEAD)
    first = np.zeros((count, BITS), bool)
    first[:, 0] = True
    each = {"start": np.stack([np.real(start), np.imag(start), found.turn], axis=1), "shift": found.shift, "level": np.abs(found.amplitude),
            "noise": np.maximum(noise, found.excess)}  # fmt: skip
    inputs = {name: np.repeat(column.astype(np.float32), BITS, axis=0) for name, column in each.items()} | {"first": first.reshape(-1)}
    rows = np.concatenate([np.full((1, 4), np.nan), rows]).astype(np.float32)
    return rows, {name: np.concatenate([column[:1] * 0, column]) for name, column in inputs.items()}


def _turned(pair: jax.Array, angle: jax.Array) -> jax.Array:
    """Turn the real and imaginary part of a number."""
    c, s = jnp.cos(angle), jnp.sin(angle)
    return jnp.stack([c * pair[0] - s * pair[1], s * pair[0] + c * pair[1]])
