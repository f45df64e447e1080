"""Two antennas send to two others over a channel that fades: the world, and receivers that know, track or interpolate it.

What is sent at a step is the mode, one of four pairs of BPSK symbols; real and imaginary parts of the four taps are the states.
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import motes as mo

BITS = np.array([[0, 0], [0, 1], [1, 0], [1, 1]])
"""Of each mode: what the two antennas send, `(modes, 2)`."""
SYMBOLS = (1 - 2 * BITS) / 2**0.5
"""The same as amplitudes, with an energy of 1 in all."""
MODES = len(BITS)
TAPS = np.stack([np.kron(np.eye(2), pair) for pair in SYMBOLS])
SEEN = jnp.asarray(np.block([[TAPS.real, -TAPS.imag], [TAPS.imag, TAPS.real]]), jnp.float32)
"""From taps to measurements without noise, `(modes, 4, 8)`: real parts come first, of both."""
MEMORY = 0.998
"""Of a tap from one step to the next; after 346 steps its correlation is a half."""
PERIOD, PILOTS = 40, (0, 1)
"""Every so many steps begin with these two, which the receiver knows: the second antenna sends the same, then its negative."""
NAMES = tuple(f"{part} h{receiver}{sender}" for part in ("Re", "Im") for receiver in (1, 2) for sender in (1, 2))
FADING = mo.LinearGaussian(MEMORY * jnp.eye(8), 0.5 * (1 - MEMORY**2) * jnp.eye(8))
START = mo.Gaussian(jnp.zeros(8), 0.5 * jnp.eye(8))


def known(steps: int) -> np.ndarray:
    """Return which mode the receiver knows to be sent at each step, -1 for none, `(steps,)`."""
    within = np.arange(steps) % PERIOD
    return np.where(within < len(PILOTS), np.take(PILOTS, within, mode="clip"), -1).astype(np.int32)


def variance(decibels: Any) -> Any:
    """Variance of the noise in each part of a measurement at an energy of a bit over N0 of so many dB at each receiving antenna."""
    return 0.25 * 10 ** (-decibels / 10)


def channel(level: Any) -> mo.JumpMarkovModel:
    """Return the model of taps and symbols, with noise of such a variance; its input is the mode that is known."""

    def transition(pilot: jax.Array, t: jax.Array) -> jax.Array:
        return jnp.broadcast_to(jnp.where(pilot < 0, 1 / MODES, jax.nn.one_hot(pilot, MODES)), (MODES, MODES))

    model = mo.StateSpaceModel(START, FADING, mo.LinearGaussian(lambda x, u, t, mode: SEEN[mode], level * jnp.eye(4)), NAMES)
    # step 0 is a pilot
    return mo.JumpMarkovModel(jax.nn.one_hot(PILOTS[0], MODES), transition, model=model, modes=MODES)


def with_known_symbols(level: Any) -> mo.StateSpaceModel:
    """Return the model of taps alone; its input is the mode that is sent."""
    return mo.StateSpaceModel(START, FADING, mo.LinearGaussian(lambda x, u, t: SEEN[u], level * jnp.eye(4)), NAMES)


def each_mode(law: mo.Gaussian, y: jax.Array, level: Any) -> tuple[mo.Gaussian, jax.Array]:
    """Return the law of the taps if each mode was sent, mode axis first, and the log densities of y, `(modes,)`."""
    return jax.vmap(lambda seen: law.given(y, seen, jnp.zeros(4), level * jnp.eye(4)))(SEEN)


def channel_known(xs: jax.Array, ys: jax.Array, pilots: jax.Array, level: Any) -> jax.Array:
    """Probabilities of the modes given the true taps, `(t, modes)`; no receiver can do better."""
    off = ys[:, None] - jnp.einsum("myx,tx->tmy", SEEN, xs)
    return jax.nn.softmax(-0.5 * jnp.sum(off**2, axis=-1) / level)


def decision_directed(xs: jax.Array, ys: jax.Array, pilots: jax.Array, level: Any) -> jax.Array:
    """Decide for the most probable mode at every step, and take it for what was sent: a Kalman filter; `(t, modes)`, one of them 1."""

    def step(law: mo.Gaussian, given: Any) -> tuple[mo.Gaussian, jax.Array]:
        y, pilot = given
        laws, log_densities = each_mode(law, y, level)
        mode = jnp.where(pilot < 0, jnp.argmax(log_densities), pilot)
        law = jax.tree.map(lambda leaf: leaf[mode], laws)
        return law.through(FADING.A, jnp.zeros(8), FADING.Q), jax.nn.one_hot(mode, MODES)

    return jax.lax.scan(step, START, (ys, pilots))[1]


def between_pilots(ys: jax.Array, pilots: jax.Array, level: Any) -> mo.smoothers.Smoothed:
    """Return the law of the taps at each step given the pilots before and after: a Kalman smoother."""
    model, symbols = with_known_symbols(level), jnp.maximum(pilots, 0)
    history = mo.run(0, mo.KalmanFilter(), model, jnp.where(pilots[:, None] < 0, jnp.nan, ys), symbols)
    return mo.smooth(0, mo.smoothers.RauchTungStriebelSmoother(), model, history, inputs=symbols)


def interpolated(xs: jax.Array, ys: jax.Array, pilots: jax.Array, level: Any) -> jax.Array:
    """Probabilities of the modes given all pilots and the measurement of the step itself, `(t, modes)`."""
    taps = between_pilots(ys, pilots, level)
    return jax.nn.softmax(jax.vmap(lambda mean, cov, y: each_mode(mo.Gaussian(mean, cov), y, level)[1])(taps.mean, taps.cov, ys))


def tracked(filter: mo.Filter, ys: jax.Array, pilots: jax.Array, level: Any, lag: int = 0) -> mo.History:
    """Run a filter of jump-Markov systems."""
    return mo.run(0, filter, channel(level), ys, pilots, keep=mo.keep.modes(lag=lag))
