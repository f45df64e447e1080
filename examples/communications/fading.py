"""Bits over a channel that fades: detection without a pilot.

    python examples/communications/fading.py [--blocks 100]

The gain a_t of the channel is a complex autoregression of order two, E |a|^2 = 1; s_t = d_t s_{t-1} is sent, d_t in {1, -1}, and
y_t = a_t s_t + noise is received. The modes of the jump-Markov system are d = 1 and -1. Beside it: receivers that know the channel; that
a genie gives a second look at it, a_t + noise as large; that compare each symbol with the one before; that believe their own decisions.
After Chen, Wang, Liu 2000, Adaptive joint detection and decoding in flat-fading channels via mixture Kalman filtering.
The picture goes to out/fading.png.
"""

import argparse

import jax.numpy as jnp
import numpy as np
from links import complete, decided, error_rate, noise, paired, picture, power, table

import motes as mo

POLE = 0.985 * np.exp(0.02j * 2 * np.pi)
"""Of the autoregression, with its conjugate."""
FIRST, SECOND = 2 * POLE.real, -(abs(POLE) ** 2)
NEIGHBORS = FIRST / (1 - SECOND)
"""Correlation of the gain with that of the symbol before."""
FRESH = 1 - FIRST * NEIGHBORS - SECOND * (FIRST * NEIGHBORS + SECOND)
"""Power that is new in the gain at each symbol."""
STEP, STATIONARY = np.array([[FIRST, SECOND], [1, 0]]), np.array([[1, NEIGHBORS], [NEIGHBORS, 1]])
NAMES = ("re", "im", "re before", "im before", "symbol")
SYMBOLS = 1000
DECIBELS = (5, 10, 15, 20, 25, 30)
JUDGED = (10, 20, 30)
PARTICLES = (8, 16, 32, 64)


def link():
    """Return the jump-Markov model; its input is the power of the noise."""
    both = np.eye(2)
    prior, fresh = np.zeros((5, 5)), np.zeros((5, 5))
    prior[:4, :4], fresh[:2, :2] = np.kron(STATIONARY, both) / 2, FRESH * both / 2
    step = jnp.asarray(np.kron(STEP, both), jnp.float32)

    def moved(x, u, t, mode):
        return jnp.append(step @ x[:4], x[4] * (1 - 2 * mode))

    start = mo.Gaussian(np.array([0, 0, 0, 0, 1], np.float32), prior.astype(np.float32))
    sensor = mo.AdditiveGaussian(lambda x, u, t: x[:2] * x[4], lambda x, u, t: u / 2 * jnp.eye(2))
    one = mo.StateSpaceModel(start, mo.AdditiveGaussian(moved, fresh.astype(np.float32)), sensor, NAMES)
    return mo.JumpMarkovModel([0.5, 0.5], np.full((2, 2), 0.5), model=one, modes=2)


def simulated(seed, blocks, symbols=SYMBOLS):
    """Return modes, gains, noise of the link and of the genie's look, `(blocks, symbols)` each; the first symbol sent is 1."""
    rng = np.random.default_rng(seed)
    modes = rng.integers(0, 2, (blocks, symbols))
    modes[:, 0] = 0
    pair = noise(rng, (blocks, 2)) @ np.linalg.cholesky(STATIONARY).T
    fresh, gains = np.sqrt(FRESH) * noise(rng, (blocks, symbols)), np.empty((blocks, symbols), complex)
    for t in range(symbols):
        gains[:, t] = pair[:, 0]
        pair = np.stack([FIRST * pair[:, 0] + SECOND * pair[:, 1] + fresh[:, t], pair[:, 0]], axis=1)
    return modes, gains, noise(rng, (blocks, symbols)), noise(rng, (blocks, symbols))


def sent(modes):
    """Return the symbols, 1 and -1, of modes `(..., t)`."""
    return np.cumprod(1 - 2 * modes, axis=-1)


def turned(symbols):
    """Return the modes `(..., t)` of decisions on symbols, by each and the one before."""
    return np.concatenate([symbols[..., :1] < 0, symbols[..., 1:] != symbols[..., :-1]], axis=-1).astype(int)


def tracked(received, level, decide):
    """Follow the gain by a Kalman filter.

    Args:
        received: complex, `(blocks, t)`.
        level: power of the noise.
        decide: given the predicted gain and what is received, the symbol `(blocks,)`; None where all are 1.

    Returns:
        Filtered gains and decisions, `(blocks, t)` each.
    """
    mean, cov = np.zeros((2, len(received)), complex), STATIONARY
    gains, symbols = np.empty_like(received), np.ones(received.shape)
    for t, y in enumerate(received.T):
        if decide is not None:
            symbols[:, t] = decide(mean[0], y) if t else 1
        gain = cov[:, 0] / (cov[0, 0] + level)
        mean = mean + gain[:, None] * (symbols[:, t] * y - mean[0])
        cov = cov - np.outer(gain, cov[0])
        gains[:, t] = mean[0]
        mean, cov = STEP @ mean, STEP @ cov @ STEP.T + np.diag([FRESH, 0])
    return gains, symbols


def coherent(gains, received):
    """Decide on symbols where the gain is known, 1 or -1."""
    return np.where(np.real(np.conj(gains) * received) < 0, -1.0, 1.0)


def references(modes, gains, received, look, level):
    """Return modes by receivers without particles, `(blocks, t)` each, by name."""
    genie, _ = tracked(look, level, None)
    return {
        "channel known": turned(coherent(gains, received)),
        "genie's pilot": turned(coherent(genie, received)),
        "differential": np.pad((np.real(received[:, 1:] * np.conj(received[:, :-1])) < 0).astype(int), ((0, 0), (1, 0))),
        "decision-directed": turned(tracked(received, level, coherent)[1]),
    }


def compared(world, decibels, n, lag=1):
    """Return which bits each receiver has wrong, `(k, blocks, t - 1)`: the first is no bit, and the last have no more to come."""
    modes, gains, own, second = world

    def received(level):
        return gains * sent(modes) + np.sqrt(level) * own

    def wrongs(level, index):
        told = references(modes, gains, received(level), gains + np.sqrt(level) * second, level)
        return {name: (one != modes)[:, 1:] for name, one in told.items()}

    found = complete(decibels, wrongs)
    ys = np.stack([received(level) for level in power(decibels)])
    levels = np.broadcast_to(power(decibels)[:, None, None], ys.shape)
    late = decided(mo.JumpMarkovFilter(n=n), link(), ys, levels, lag)
    return found | {f"jump-Markov, lag {k}": (one != modes)[..., 1:] for k, one in enumerate(late)}


def main():
    """Compare receivers, print the tables and draw the picture."""
    parser = argparse.ArgumentParser(description="Bits over a channel that fades.")
    parser.add_argument("--blocks", type=int, default=100, help=f"of {SYMBOLS} symbols at each signal-to-noise ratio (100)")
    given = parser.parse_args()
    world = simulated(0, given.blocks)
    found = compared(world, DECIBELS, 32)
    print(table(DECIBELS, found, "genie's pilot"))
    rows, first = [], None
    for n in PARTICLES:
        wrong = compared(world, JUDGED, n)["jump-Markov, lag 1"]
        first = wrong if first is None else first
        for level, one, few in zip(JUDGED, wrong, first, strict=True):
            rows.append((n, level, error_rate(one).rate, *paired(one, few)))
    print(mo.io.Table(("particles", "dB", "error rate, lag 1", f"less that of {PARTICLES[0]}", "its standard error"), tuple(rows)))
    picture("fading", DECIBELS, {"flat fading": found})


if __name__ == "__main__":
    main()
