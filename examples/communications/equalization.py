"""Bits over a channel with echoes that nobody knows: blind equalization.

    python examples/communications/equalization.py [--blocks 600] [--particles 16] [--merge 3]

Three complex taps, drawn for each block with powers .6, .3 and .1, reach over three symbols: y_t = h_0 s_t + h_1 s_{t-1} + h_2 s_{t-2} +
noise, s_t = d_t s_{t-1}. Before a block nothing is sent; its first symbol is no bit, since the sign of the channel is unknown too. The
modes of the jump-Markov system are d = 1 and -1, the three last symbols are states without variance. Beside it: the Viterbi algorithm
where the channel is known, and per-survivor processing (Raheli, Polydoros, Tzou 1995), where each survivor of the trellis carries a Kalman
filter of the taps. Taps that stand still, and taps that move. Where a first or last tap is next to nothing, taps and bits that are both
moved by a symbol fit as well: bits of blind receivers are counted at the shift, of at most two symbols, that leaves fewest wrong in a
block. Paths of the jump-Markov filter that agree in the last three bits and symbols are merged, which leaves sixteen and nothing to chance:
what differs further back is in the taps, and costs particles for a long time otherwise. The picture goes to out/equalization.png.
"""

import argparse

import jax.numpy as jnp
import numpy as np
from links import complete, decided, noise, picture, power, table

import motes as mo

POWERS = np.array([0.6, 0.3, 0.1])
SYMBOLS, SCORED = 200, 50
"""Symbols of a block, and those before the first that counts."""
LAG, PARTICLES, MERGE = 4, 16, 3
DECIBELS = (6, 8, 10, 12, 15)
MOVING = 0.998
"""Correlation of a tap with itself at the symbol before, where taps move."""
FAILED, LOST = 0.1, 0.25
"""Shares of wrong bits above which a block has failed, and above which the receiver has not even found the channel."""
NAMES = (*(f"{part} {tap}" for tap in range(3) for part in ("re", "im")), "symbol", "one before", "two before")
STATES = np.array([[1, 1], [1, -1], [-1, 1], [-1, -1]])
"""Last symbol and that before, for each state of the trellis."""
BEFORE = 2 * (STATES[:, 1] < 0)[:, None] + np.arange(2)
"""The two states from which each comes."""


def link(memory):
    """Return the jump-Markov model; its input is the power of the noise.

    Args:
        memory: correlation of a tap with itself at the symbol before.
    """
    taps = np.repeat(POWERS, 2) / 2
    prior, fresh = (np.diag(np.append(variance, np.zeros(3))).astype(np.float32) for variance in (taps, (1 - memory**2) * taps))

    def moved(x, u, t, mode):
        return jnp.concatenate([memory * x[:6], x[6:7] * (1 - 2 * mode), x[6:8]])

    start = mo.Gaussian(np.array([0, 0, 0, 0, 0, 0, 1, 0, 0], np.float32), prior)
    sensor = mo.AdditiveGaussian(lambda x, u, t: x[6:] @ x[:6].reshape(3, 2), lambda x, u, t: u / 2 * jnp.eye(2))
    one = mo.StateSpaceModel(start, mo.AdditiveGaussian(moved, fresh), sensor, NAMES)
    return mo.JumpMarkovModel([0.5, 0.5], np.full((2, 2), 0.5), model=one, modes=2)


def simulated(seed, blocks, memory, symbols=SYMBOLS):
    """Return modes `(blocks, symbols)`, taps `(blocks, symbols, 3)`, and noise of power 1 `(blocks, symbols)`."""
    rng = np.random.default_rng(seed)
    modes = rng.integers(0, 2, (blocks, symbols))
    modes[:, 0] = 0
    taps = np.sqrt(POWERS) * noise(rng, (blocks, symbols, 3))
    for t in range(1, symbols):
        taps[:, t] = memory * taps[:, t - 1] + np.sqrt(1 - memory**2) * taps[:, t]
    return modes, taps, noise(rng, (blocks, symbols))


def sent(modes):
    """Return what is sent of modes `(blocks, t)`: each symbol and the two before, `(blocks, t, 3)`, 0 before the first."""
    symbols = np.pad(np.cumprod(1 - 2 * modes, axis=1), ((0, 0), (2, 0)))
    return np.stack([symbols[:, 2 - late : symbols.shape[1] - late] for late in range(3)], axis=2)


def branches(t):
    """Return the three last symbols on the two branches into each state `(4, 2, 3)`, and which of them may be."""
    last = np.broadcast_to(STATES[:, None, :1], (4, 2, 1))
    symbols = np.concatenate([last, STATES[BEFORE]], axis=2)
    # at first 1 is sent, after nothing: of branches that are alike one remains
    if t < 2:
        symbols = np.where(np.arange(3) > t, 0, symbols)
        may = (BEFORE == 0) & (t > 0 or STATES[:, :1] > 0) & (STATES[:, 1:] > 0)
        return symbols, may
    return symbols, np.ones((4, 2), bool)


def survivors(received, first, extend):
    """Find the best path through the trellis (Viterbi 1967); return its modes `(blocks, t)`.

    Args:
        received: `(blocks, t)`.
        first: what each survivor carries at the start, arrays `(blocks, 4, ...)`.
        extend: given the step, the symbols of branches `(4, 2, 3)` and what survivors carry on each branch `(blocks, 4, 2, ...)`, the cost
            of each branch `(blocks, 4, 2)` and what is carried on.
    """
    blocks, steps = received.shape
    rows, states = np.arange(blocks)[:, None], np.arange(4)
    cost, carried, chosen = np.zeros((blocks, 4)), first, np.empty((blocks, steps, 4), int)
    for t in range(steps):
        symbols, may = branches(t)
        more, onward = extend(t, symbols, tuple(one[:, BEFORE] for one in carried))
        total = np.where(may, cost[:, BEFORE] + more, np.inf)
        best = total.argmin(axis=2)
        cost = np.minimum(total.min(axis=2), 1e30)
        chosen[:, t] = BEFORE[states, best]
        carried = tuple(one[rows, states, best] for one in onward)
    state, symbols = cost.argmin(axis=1), np.empty((blocks, steps), int)
    for t in reversed(range(steps)):
        symbols[:, t] = STATES[state, 0]
        state = chosen[np.arange(blocks), t, state]
    return np.pad((symbols[:, 1:] != symbols[:, :-1]).astype(int), ((0, 0), (1, 0)))


def viterbi(received, taps):
    """Decide where the taps `(blocks, t, 3)` are known."""

    def extend(t, symbols, carried):
        off = received[:, t, None, None] - np.einsum("bk,ijk->bij", taps[:, t], symbols)
        return np.abs(off) ** 2, ()

    return survivors(received, (), extend)


def per_survivor(received, level, memory):
    """Decide where each survivor of the trellis follows the taps by a Kalman filter of its own."""
    blocks, prior = len(received), np.diag(POWERS).astype(complex)
    first = np.zeros((blocks, 4, 3), complex), np.broadcast_to(prior, (blocks, 4, 3, 3))

    def extend(t, symbols, carried):
        mean, cov = carried
        if t:
            mean, cov = memory * mean, memory**2 * cov + (1 - memory**2) * prior
        look = np.einsum("bijkl,ijl->bijk", cov, symbols)
        variance = np.real(np.einsum("bijk,ijk->bij", look, symbols)) + level
        off = received[:, t, None, None] - np.einsum("bijk,ijk->bij", mean, symbols)
        gain = look / variance[..., None]
        cov = cov - gain[..., :, None] * np.conj(look[..., None, :])
        return np.abs(off) ** 2 / variance + np.log(variance), (mean + gain * off[..., None], cov)

    return survivors(received, first, extend)


def wrong_bits(told, modes, lag, blind):
    """Return which of the bits that count are wrong, `(blocks, t)`: without the first ones and the last `lag`.

    Args:
        told: modes that a receiver decided on, `(blocks, t)`.
        modes: true ones.
        lag: two or more.
        blind: whether the shift is free.
    """
    first, end = SCORED, modes.shape[1] - lag
    each = np.stack([told[:, first + shift : end + shift] != modes[:, first:end] for shift in ((0, -1, 1, -2, 2) if blind else (0,))])
    return each[each.sum(axis=2).argmin(axis=0), np.arange(len(modes))]


def compared(world, memory, decibels, n=PARTICLES, lag=LAG, merge=MERGE):
    """Return which of the bits that count each receiver has wrong, `(k, blocks, t)`, by name; the last `lag` do not count."""
    modes, taps, own = world
    clean = np.sum(taps * sent(modes), axis=2)

    def wrongs(level, index):
        received = clean + np.sqrt(level) * own
        return {
            "Viterbi, channel known": wrong_bits(viterbi(received, taps), modes, lag, blind=False),
            "per survivor, blind": wrong_bits(per_survivor(received, level, memory), modes, lag, blind=True),
        }

    found = complete(decibels, wrongs)
    levels = np.broadcast_to(power(decibels)[:, None, None], (len(decibels), *clean.shape))
    late = decided(mo.JumpMarkovFilter(n=n, merge=merge), link(memory), clean + np.sqrt(levels) * own, levels, lag)
    ours = {k: np.stack([wrong_bits(told, modes, lag, blind=True) for told in late[k]]) for k in (0, lag)}
    return found | {f"jump-Markov, blind, lag {k}": wrong for k, wrong in ours.items()}


def failures(decibels, found):
    """Return a table of the shares of blocks that failed and that were lost."""
    rows = []
    for name, wrong in found.items():
        for level, one in zip(decibels, wrong, strict=True):
            rows.append((name, level, *(float(np.mean(one.mean(axis=1) > share)) for share in (FAILED, LOST))))
    return mo.io.Table(("receiver", "dB", "blocks failed", "blocks lost"), tuple(rows))


def main():
    """Compare receivers on taps that stand still and that move, print the tables and draw the picture."""
    parser = argparse.ArgumentParser(description="Blind equalization.")
    parser.add_argument("--blocks", type=int, default=600, help=f"of {SYMBOLS} symbols at each signal-to-noise ratio (600)")
    parser.add_argument("--particles", type=int, default=PARTICLES, help=f"of the jump-Markov filter ({PARTICLES})")
    parser.add_argument("--merge", type=int, default=MERGE, help=f"last bits in which paths that are merged agree, 0 for none ({MERGE})")
    given = parser.parse_args()
    panels = {}
    for title, memory in (("taps that stand still", 1.0), ("taps that move", MOVING)):
        found = panels[title] = compared(simulated(0, given.blocks, memory), memory, DECIBELS, given.particles, merge=given.merge)
        print(f"\n{title}\n{table(DECIBELS, found, 'Viterbi, channel known')}\n{failures(DECIBELS, found)}", flush=True)
    picture("equalization", DECIBELS, panels)


if __name__ == "__main__":
    main()
