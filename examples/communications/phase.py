"""Symbols of two bits over a carrier whose phase walks.

    python examples/communications/phase.py [--blocks 100]

DQPSK: the symbol turns by d_t quarters, y_t = exp(i (theta_t + phi_t)) + noise, and theta walks by 2 or 6 degrees a symbol. Carrier and
symbol are only ever seen together: the state is the one angle theta_t + phi_t, and the modes of the jump-Markov system are the four turns.
Beside it: receivers that know theta; that compute everything on a fine grid of angles, forward (filtered), or forward and backward
(smoothed: all of a block is known); a phase-locked loop that believes its own decisions, with the best of many gains; and one that
compares each symbol with the one before. The picture goes to out/phase.png.
"""

import argparse

import jax.numpy as jnp
import numpy as np
from links import complete, decided, noise, picture, power, table

import motes as mo

SYMBOLS = 500
WALKS = (2, 6)
"""Degrees a symbol."""
DECIBELS = (6, 8, 10, 12, 14)
LAG, PARTICLES = 2, 8
START = np.radians(10)
"""Standard deviation of the first angle."""
CELLS = 360
"""Of the grid; a quarter of them is one mode."""
GAINS = np.arange(0.1, 0.9, 0.05)
"""Of the phase-locked loop, tried."""


def link(walk):
    """Return the jump-Markov model; its input is the power of the noise.

    Args:
        walk: of the carrier, radians a symbol.
    """
    start = mo.Gaussian(np.zeros(1, np.float32), np.array([[START**2]], np.float32))
    dynamics = mo.AdditiveGaussian(lambda x, u, t, mode: x + jnp.pi / 2 * mode, np.array([[walk**2]], np.float32))
    sensor = mo.AdditiveGaussian(lambda x, u, t: jnp.concatenate([jnp.cos(x), jnp.sin(x)]), lambda x, u, t: u / 2 * jnp.eye(2))
    one = mo.StateSpaceModel(start, dynamics, sensor, ("angle",))
    return mo.JumpMarkovModel(np.full(4, 0.25), np.full((4, 4), 0.25), model=one, modes=4)


def simulated(seed, blocks, walk, symbols=SYMBOLS):
    """Return modes, angles of the carrier, radians, and noise of power 1, `(blocks, symbols)` each; the first symbol is no turn."""
    rng = np.random.default_rng(seed)
    modes = rng.integers(0, 4, (blocks, symbols))
    modes[:, 0] = 0
    steps = np.concatenate([np.full((blocks, 1), START), np.full((blocks, symbols - 1), walk)], axis=1)
    return modes, np.cumsum(steps * rng.standard_normal((blocks, symbols)), axis=1), noise(rng, (blocks, symbols))


def sent(modes):
    """Return the symbols, complex, of modes `(blocks, t)`."""
    return 1j ** (np.cumsum(modes, axis=1) % 4)


def nearest(angles):
    """Round angles to whole quarter turns, 0 to 3."""
    return np.round(angles / (np.pi / 2)).astype(int) % 4


def turned(quarters):
    """Return the modes `(blocks, t)` of decisions on symbols, by each and the one before."""
    return np.diff(quarters, axis=1, prepend=0) % 4


def locked(received, gain):
    """Decide by a phase-locked loop of first order."""
    angle, quarters = np.zeros(len(received)), np.empty(received.shape, int)
    for t, y in enumerate(received.T):
        quarters[:, t] = nearest(np.angle(y * np.exp(-1j * angle))) if t else 0
        angle = angle + gain * np.angle(y * np.exp(-1j * (angle + np.pi / 2 * quarters[:, t])))
    return turned(quarters)


def exact(received, level, walk):
    """Decide by forward and backward recursions on a grid of angles; return modes filtered and smoothed, `(blocks, t)` each."""
    cells = 2 * np.pi * np.arange(CELLS) / CELLS
    far = np.minimum(cells, 2 * np.pi - cells)
    turns = np.arange(4) * CELLS // 4

    def spread(values, sd):
        # by the walk: a circular convolution
        kernel = np.exp(-0.5 * (far / sd) ** 2)
        return np.fft.irfft(np.fft.rfft(values) * np.fft.rfft(kernel / kernel.sum()), CELLS)

    def likelihood(t):
        log = -(np.abs(received[:, t, None] - np.exp(1j * cells)) ** 2) / level
        return np.exp(log - log.max(axis=1, keepdims=True))

    def at_turns(predicted):
        # (blocks, 4, cells): angles after each turn
        return np.stack([np.roll(predicted, turn, axis=1) for turn in turns], axis=1)

    blocks, steps = received.shape
    filtered, smoothed = np.zeros((2, blocks, steps), int)
    law, before = np.exp(-0.5 * (far / START) ** 2) * likelihood(0), []
    for t in range(1, steps):
        before.append(np.maximum(spread(law, walk), 0))
        joint = at_turns(before[-1]) * likelihood(t)[:, None]
        filtered[:, t] = joint.sum(axis=2).argmax(axis=1)
        law = joint.sum(axis=1)
        law /= law.sum(axis=1, keepdims=True)
    after = np.ones((blocks, CELLS))
    for t in reversed(range(1, steps)):
        later = likelihood(t) * after
        smoothed[:, t] = np.sum(at_turns(before[t - 1]) * later[:, None], axis=2).argmax(axis=1)
        after = np.maximum(spread(sum(np.roll(later, -turn, axis=1) for turn in turns), walk), 0)
        after /= after.sum(axis=1, keepdims=True)
    return filtered, smoothed


def compared(world, walk, decibels, n=PARTICLES, lag=LAG):
    """Return which symbols each receiver has wrong, `(k, blocks, t)`, by name, without the first and the last `lag`."""
    modes, carrier, own = world
    clean, counted = sent(modes) * np.exp(1j * carrier), slice(1, modes.shape[1] - lag)

    def wrongs(level, index):
        received = clean + np.sqrt(level) * own
        filtered, smoothed = exact(received, level, walk)
        loops = [locked(received, gain) for gain in GAINS]
        told = {
            "phase known": turned(nearest(np.angle(received * np.exp(-1j * carrier)))),
            "exact, filtered": filtered,
            "exact, smoothed": smoothed,
            "phase-locked loop": min(loops, key=lambda one: np.sum(one != modes)),
            "differential": nearest(np.angle(received * np.conj(np.roll(received, 1, axis=1)))),
        }
        return {name: (one != modes)[:, counted] for name, one in told.items()}

    found = complete(decibels, wrongs)
    levels = np.broadcast_to(power(decibels)[:, None, None], (len(decibels), *clean.shape))
    late = decided(mo.JumpMarkovFilter(n=n), link(walk), clean + np.sqrt(levels) * own, levels, lag)
    return found | {f"jump-Markov, lag {k}": (late[k] != modes)[..., counted] for k in (0, lag)}


def main():
    """Compare receivers for a slow and a quick walk, print the tables and draw the picture."""
    parser = argparse.ArgumentParser(description="Symbols over a carrier whose phase walks.")
    parser.add_argument("--blocks", type=int, default=100, help=f"of {SYMBOLS} symbols at each signal-to-noise ratio (100)")
    given = parser.parse_args()
    panels = {}
    for degrees in WALKS:
        walk = np.radians(degrees)
        found = panels[f"the phase walks {degrees} degrees a symbol"] = compared(simulated(0, given.blocks, walk), walk, DECIBELS)
        print(f"\nwalk of {degrees} degrees a symbol\n{table(DECIBELS, found, 'exact, filtered')}", flush=True)
    picture("phase", DECIBELS, panels)


if __name__ == "__main__":
    main()
