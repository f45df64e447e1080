"""What the three links share: decisions of a jump-Markov filter on many blocks at once, error rates and their pictures.

Symbols are coded differentially: the mode d_t of the jump-Markov system turns the symbol s_{t-1} that was sent last into s_t. Whoever
does not know the sign (or quarter turn) of the channel loses nothing by that.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

import motes as mo
from motes.plotting.figures import COLORS, TRUE, legend_below, new_figure, tidy

NORMAL = 1.959964
"""Quantile of a normal law for 95 percent."""
BATCH = 100
"""Blocks that are worked on together."""
LINES = (TRUE, *COLORS)


class Rate(NamedTuple):
    """An error rate, and the ends of its 95 percent interval."""

    rate: float
    low: float
    high: float


class Gain(NamedTuple):
    """Mean difference of two error rates on the same blocks, and its standard error."""

    mean: float
    error: float


def power(decibels: Any) -> Any:
    """Return the power of the noise at a signal-to-noise ratio in decibels; that of the signal is 1."""
    return 10 ** (-np.asarray(decibels) / 10)


def noise(rng: np.random.Generator, shape: tuple[int, ...]) -> np.ndarray:
    """Draw complex numbers of power 1."""
    return (rng.standard_normal(shape) + 1j * rng.standard_normal(shape)) / np.sqrt(2)


def parts(numbers: Any) -> np.ndarray:
    """Return real and imaginary parts as a last axis, float32."""
    return np.stack([np.real(numbers), np.imag(numbers)], axis=-1).astype(np.float32)


def decided(filter: mo.Filter, model: mo.JumpMarkovModel, received: np.ndarray, inputs: Any, lag: int) -> np.ndarray:
    """Return the most probable mode of each symbol after 0, 1, ... `lag` more of them.

    Args:
        filter: which filter.
        model: of one block.
        received: complex, `(..., t)`.
        inputs: of the model, with the shape of `received`.
        lag: one or more.

    Returns:
        Modes `(lag + 1, ..., t)`.
    """

    def one(row: Any) -> jax.Array:
        key, y, u = row
        history = mo.run(key, filter, model, y, u, keep=mo.keep.modes(lag=lag))
        return jnp.stack([jnp.argmax(history.mode_probabilities_after(late), axis=1) for late in range(lag + 1)])

    shape = received.shape
    ys, us = parts(received).reshape(-1, shape[-1], 2), np.asarray(inputs, np.float32).reshape(-1, shape[-1])
    keys = jax.random.split(jax.random.key(0), len(ys))
    modes = jax.jit(lambda rows: jax.lax.map(one, rows, batch_size=min(BATCH, len(ys))))((keys, ys, us))
    return np.moveaxis(np.asarray(modes), 1, 0).reshape(lag + 1, *shape)


def error_rate(wrong: np.ndarray) -> Rate:
    """Return the share of wrong symbols with Wilson's 95 percent interval.

    Errors come in bursts: the interval is that of so many independent symbols as would scatter like the blocks do.

    Args:
        wrong: which symbols are, `(blocks, t)`.
    """
    blocks, rate, count = wrong.mean(axis=1), float(wrong.mean()), wrong.size
    scatter = blocks.var(ddof=1) / len(blocks)
    if scatter > 0:
        count = min(count, rate * (1 - rate) / scatter)
    middle, share = rate + NORMAL**2 / (2 * count), 1 + NORMAL**2 / count
    reach = NORMAL * np.sqrt(rate * (1 - rate) / count + NORMAL**2 / (4 * count**2))
    return Rate(rate, float(max(middle - reach, 0.0) / share), float((middle + reach) / share))


def paired(wrong: np.ndarray, other: np.ndarray) -> Gain:
    """Return by how much one error rate is above another on the same blocks."""
    difference = wrong.mean(axis=1) - other.mean(axis=1)
    return Gain(float(difference.mean()), float(difference.std(ddof=1) / np.sqrt(len(difference))))


def table(decibels: Any, found: dict[str, np.ndarray], against: str) -> mo.io.Table:
    """Return error rates by receiver and signal-to-noise ratio.

    Args:
        decibels: signal-to-noise ratios, `(k,)`.
        found: which symbols each receiver has wrong, `(k, blocks, t)`.
        against: the receiver from which the differences of others are told.
    """
    rows = []
    for name, wrong in found.items():
        for level, one, other in zip(decibels, wrong, found[against], strict=True):
            rows.append((name, level, *error_rate(one), *paired(one, other)))
    return mo.io.Table(("receiver", "dB", "error rate", "95 % from", "to", f"less that of {against}", "its standard error"), tuple(rows))


def draw(axes: Any, decibels: Any, found: dict[str, np.ndarray], title: str) -> None:
    """Draw curves of error rates with their bands into some axes."""
    for color, (name, wrong) in zip(LINES, found.items(), strict=False):
        rate, low, high = np.transpose([error_rate(one) for one in wrong])
        least = 0.5 / wrong[0].size
        axes.fill_between(decibels, np.maximum(low, least), high, color=color, alpha=0.15, linewidth=0)
        axes.plot(decibels, np.where(rate > 0, rate, np.nan), color=color, linewidth=1.3, marker="o", markersize=3, label=name)
    axes.set(yscale="log", xlabel="signal-to-noise ratio, dB", ylabel="share of wrong symbols", title=title)
    tidy(axes)


def picture(name: str, decibels: Any, panels: dict[str, dict[str, np.ndarray]]) -> None:
    """Draw a panel of curves for each title, save it as out/NAME.png and say so."""
    figure = new_figure(4.0 * len(panels) + 2.4, 4.6)
    for place, (title, found) in enumerate(panels.items()):
        draw(figure.add_subplot(1, len(panels), place + 1), decibels, found, title)
    legend_below(figure, figure.axes[0], 3)
    Path("out").mkdir(exist_ok=True)
    figure.savefig(f"out/{name}.png", dpi=80)
    print(f"picture: out/{name}.png")


def complete(decibels: Any, wrongs: Callable[[float, int], dict[str, np.ndarray]]) -> dict[str, np.ndarray]:
    """Put what a function `(power of the noise, index)` finds at each signal-to-noise ratio one behind the other, by receiver."""
    found = [wrongs(float(power(level)), index) for index, level in enumerate(decibels)]
    return {name: np.stack([each[name] for each in found]) for name in found[0]}
