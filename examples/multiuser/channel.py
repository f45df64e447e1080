"""Receivers over a fading channel side by side: what is wrong in the same frames, counted and drawn."""

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import mimo
import numpy as np
from rates import Compared

import motes as mo
from motes.plotting.figures import TRUE, legend_below, new_figure, tidy

STEPS, DELAY = 200, 10
PILOTS = mimo.known(STEPS)
BETWEEN, DIRECTED, MIXED, TRACKED, LATER, KNOWN = RECEIVERS = (
    "pilots interpolated", "decision-directed", "interacting models", "jump-Markov", f"jump-Markov, {DELAY} steps later", "channel known",
)  # fmt: skip
SHOWN = 6
"""Decibels of the frame in the picture."""


def modes_by(particles: int, xs: jax.Array, ys: jax.Array, level: Any) -> dict[str, jax.Array]:
    """Return what each receiver makes of a frame: probabilities of the modes, `(t, modes)`."""
    given = (xs, ys, jnp.asarray(PILOTS), level)
    history = mimo.tracked(mo.JumpMarkovFilter(n=particles), *given[1:], lag=DELAY)
    return {
        BETWEEN: mimo.interpolated(*given),
        DIRECTED: mimo.decision_directed(*given),
        MIXED: mimo.tracked(mo.InteractingMultipleModel(), *given[1:]).mode_probabilities,
        TRACKED: history.mode_probabilities,
        LATER: history.mode_probabilities_after(DELAY),
        KNOWN: mimo.channel_known(*given),
    }


def frame(key: Any, level: Any) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Draw taps `(t, 8)`, modes `(t,)` and measurements `(t, 4)`."""
    states, ys = mo.simulate(key, mimo.channel(level), STEPS, jnp.asarray(PILOTS))
    return states[:, :8], states[:, 8].astype(jnp.int32), ys


@partial(jax.jit, static_argnums=2)
def wrong_bits(keys: jax.Array, level: jax.Array, particles: int) -> dict[str, jax.Array]:
    """Let all receivers decide on the same frames; return which bits are wrong, `(frames, bits)`, by receiver."""
    bits = jnp.asarray(mimo.BITS)

    def one(key: jax.Array) -> dict[str, jax.Array]:
        xs, modes, ys = frame(key, level)
        found = modes_by(particles, xs, ys, level)
        return {name: ((p @ bits > 0.5) != (bits[modes] > 0))[PILOTS < 0].ravel() for name, p in found.items()}

    return jax.lax.map(one, keys, batch_size=min(20, len(keys)))


def compared(decibels: tuple[float, ...], frames: int, particles: int) -> Compared:
    """Compare the receivers."""
    keys = {each: jax.random.split(jax.random.key(seed), frames) for seed, each in enumerate(decibels)}
    wrong = {each: wrong_bits(keys[each], jnp.float32(mimo.variance(each)), particles) for each in decibels}
    return Compared.of({each: {name: found[name] for name in RECEIVERS} for each, found in wrong.items()}, KNOWN, {})


class Followed(NamedTuple):
    """The real part of the first tap in one frame, each `(t,)`.

    Attributes:
        true: as it was.
        mean: by the jump-Markov filter.
        deviation: its standard deviation.
        interpolated: between pilots.
    """

    true: np.ndarray
    mean: np.ndarray
    deviation: np.ndarray
    interpolated: np.ndarray


def followed(particles: int, seed: int = 0) -> Followed:
    """Follow the channel through one frame."""
    level, pilots = jnp.float32(mimo.variance(SHOWN)), jnp.asarray(PILOTS)
    xs, _, ys = frame(jax.random.key(seed), level)
    history = mimo.tracked(mo.JumpMarkovFilter(n=particles), ys, pilots, level)
    parts = (xs[:, 0], history.mean[:, 0], jnp.sqrt(history.cov[:, 0, 0]), mimo.between_pilots(ys, pilots, level).mean[:, 0])
    return Followed(*map(np.asarray, parts))


def picture(found: Compared, tap: Followed) -> Any:
    """Draw error rates, and a tap over one frame."""
    figure = new_figure(9, 4.2)
    left, right = figure.subplots(1, 2, width_ratios=(1.1, 1.3))
    found.draw(left)
    colors, steps = found.colors(), np.arange(STEPS)
    own, between = colors[TRACKED], colors[BETWEEN]
    right.fill_between(steps, tap.mean - 2 * tap.deviation, tap.mean + 2 * tap.deviation, color=own, alpha=0.2, linewidth=0)
    right.plot(steps, tap.mean, color=own, linewidth=1.2)
    right.plot(steps, tap.interpolated, color=between, linewidth=1.2)
    right.plot(steps, tap.true, color=TRUE, linewidth=1.2, linestyle="--")
    for step in steps[PILOTS >= 0][::2]:
        right.axvline(step, color="0.6", linewidth=0.8, linestyle=":")
    tidy(right)
    right.set(xlim=(0, STEPS - 1), xlabel=f"step (pilots at dotted lines, {SHOWN} dB)", ylabel="real part of a tap")
    legend_below(figure, left, 3)
    return figure
