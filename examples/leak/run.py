"""A tank begins to leak: how soon is it noticed, and which of two tanks is it?

    python examples/leak/run.py [--runs 200] [--particles 30]

Two tanks one below the other are simulated; the level of the lower one is measured. From step 300 of 800 on, one of them loses five percent
more than runs out of it. All thresholds are set so that five percent of runs without a leak give an alarm. The picture goes to
out/leak.png. It takes about two minutes.
"""

import argparse
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

import motes as mo
from motes.plotting.figures import COLORS, TRUE, legend_below, new_figure, tidy

K1, K2, K3, PUMP = 0.24, 0.14, 0.14, 0.2
"""What runs out of the upper tank, into the lower, out of the lower, V per root of a V; what the pump brings, V per V."""
LEAK, START, STEPS = 0.05, 300, 800
MOVED, MEASURED = 0.02, 0.05
"""Standard deviations of what moves levels beside the pump at a step, and of the measured level, V."""
SHARE = 0.05
WINDOW = 20
BATCH = 100
DRAWN = ("NIS over 20 steps", "CUSUM of NIS", "CUSUM of log-evidence ratios", "jump-Markov filter")
"""In the picture; the other two lie on these."""


class Statistics(NamedTuple):
    """What a detector says of some runs.

    Attributes:
        any: that there is a leak at all, `(runs, t)`.
        each: that it is in the upper or the lower tank, `(2, runs, t)`; None where the detector cannot tell.
    """

    any: np.ndarray
    each: np.ndarray | None = None


def tanks(upper=0.0, lower=0.0, since=0):
    """Return the model of both levels, where tanks lose so much more, as shares, from a step on."""

    def dynamics(x, u, t):
        out = jnp.sqrt(jnp.maximum(x, 0.01))
        leaks = jnp.where(t >= since, jnp.array([upper, lower]), 0.0)
        return x + jnp.stack([PUMP * u, K2 * out[0]]) - (1 + leaks) * jnp.array([K1, K3]) * out

    start = mo.Gaussian(jnp.array([5.0, 5.0]), jnp.diag(jnp.array([0.2, 0.1]) ** 2))
    sensor = mo.AdditiveGaussian(lambda x, u, t: x[1:2], MEASURED**2 * jnp.eye(1))
    return mo.StateSpaceModel(start, mo.AdditiveGaussian(dynamics, MOVED**2 * jnp.eye(2)), sensor, ("upper", "lower"))


SOUND, LEAKING = tanks(), (tanks(upper=LEAK), tanks(lower=LEAK))
RATE = 1 / STEPS
"""Probability of a leak at a step."""
SWITCHING = mo.JumpMarkovModel(
    [1 - RATE, RATE / 2, RATE / 2], [[1 - RATE, RATE / 2, RATE / 2], [0, 1, 0], [0, 0, 1]], (SOUND, *LEAKING)
)


def pumped(steps):
    """Voltages of the pump, `(steps,)`: sinusoids of random phases."""
    turns = 2 * np.pi * np.arange(1, 13)[:, None] * np.arange(steps) / STEPS
    waves = np.cos(turns + np.random.default_rng(0).uniform(0, 2 * np.pi, (12, 1))).sum(axis=0)
    return jnp.asarray(np.clip(2.6 + 0.5 * waves / waves.std(), 0.5, 6), jnp.float32)


def simulated(seed, truth, runs, steps=STEPS):
    """Return measurements of so many runs, `(runs, steps, 1)`."""
    return jax.vmap(lambda key: mo.simulate(key, truth, steps, pumped(steps))[1])(jax.random.split(jax.random.key(seed), runs))


def watched(ys, particles):
    """Return what each detector says of runs `(runs, t, 1)`, by name."""
    u = pumped(ys.shape[1])
    switching = {"jump-Markov filter": mo.JumpMarkovFilter(n=particles), "interacting multiple model": mo.InteractingMultipleModel()}

    def one(row):
        key, y = row
        sound, *leaking = [mo.run(key, mo.ExtendedKalmanFilter(), model, y, u) for model in (SOUND, *LEAKING)]
        modes = [mo.run(key, filter, SWITCHING, y, u, keep=mo.keep.modes).mode_probabilities for filter in switching.values()]
        return sound.info.nis, jnp.stack([history.log_evidence - sound.log_evidence for history in leaking]), jnp.stack(modes)

    # all in one program: to compile it takes as long as a hundred runs
    keys = jax.random.split(jax.random.key(0), len(ys))
    nis, ratios, modes = jax.jit(lambda rows: jax.lax.map(one, rows, batch_size=min(BATCH, len(ys))))((keys, ys))
    sums = np.cumsum(np.pad(nis, ((0, 0), (WINDOW, 0))), axis=1)
    found = {f"NIS over {WINDOW} steps": Statistics(sums[:, WINDOW:] - sums[:, :-WINDOW])}
    # log likelihood ratio of innovations with twice the variance that was claimed
    found["CUSUM of NIS"] = Statistics(np.asarray(mo.detect.cusum(0.25 * nis - 0.5 * np.log(2)).statistic))
    sums, odds = (np.moveaxis(found.statistic, 1, 0) for found in (mo.detect.cusum(ratios), mo.detect.shiryaev(ratios, RATE / 2)))
    found["CUSUM of log-evidence ratios"] = Statistics(sums.max(axis=0), sums)
    found["Shiryaev, log-evidence ratios"] = Statistics(np.logaddexp(*odds), odds)
    for name, p in zip(switching, np.moveaxis(modes, 1, 0), strict=True):
        p = np.moveaxis(np.log(np.maximum(p, np.finfo(np.float32).tiny)), -1, 0)
        found[name] = Statistics(np.logaddexp(p[1], p[2]) - p[0], p[1:] - p[0])
    return found


def some_of(found, runs):
    """Return what detectors say of some of the runs."""
    return {name: Statistics(said.any[runs], None if said.each is None else said.each[:, runs]) for name, said in found.items()}


def alarms(statistic, above):
    """First steps at which a statistic `(runs, t)` is above a threshold, infinite where it never is, `(runs,)`."""
    over = statistic > above
    return np.where(over.any(axis=1), over.argmax(axis=1), np.inf)


def judged(said, above, leak):
    """Median delay, share of runs without an alarm, and share of alarms that name the right tank (None: it cannot).

    Runs with an alarm before the leak do not count: these are false.
    """
    at = alarms(said.any, above)
    true, right = at >= START, None
    if said.each is not None:
        caught = np.flatnonzero(true & np.isfinite(at))
        right = float(np.mean(said.each[:, caught, at[caught].astype(int)].argmax(axis=0) == leak))
    return float(np.median(at[true]) - START), float(np.mean(np.isinf(at[true]))), right


def compared(sound, fresh, leaks):
    """Return a table of all detectors, and their thresholds by name.

    Args:
        sound: what detectors say of runs without a leak, from which thresholds are taken.
        fresh: of further such runs.
        leaks: of runs with a leak in the upper and in the lower tank.
    """
    rows, above = [], {}
    for name, said in sound.items():
        above[name] = mo.detect.threshold(said.any, SHARE)
        false = float(np.mean(np.isfinite(alarms(fresh[name].any, above[name]))))
        told = [judged(found[name], above[name], leak) for leak, found in enumerate(leaks)]
        rows.append((name, above[name], false, *(number for leak in told for number in leak)))
    each = ("delay", "missed", "right tank")
    head = ("detector", "threshold", "false", *(f"{which}: {what}" for which in ("upper", "lower") for what in each))
    return mo.io.Table(head, tuple(rows)), above


def picture(leaks, above):
    """Draw the statistics of one run over their thresholds, and how many leaks are found by each step."""
    figure = new_figure(9, 5.6)
    grid = figure.add_gridspec(2, 2)
    top = figure.add_subplot(grid[0, :])
    one = int(np.argsort(alarms(leaks[0]["jump-Markov filter"].any, above["jump-Markov filter"]))[len(leaks[0]["CUSUM of NIS"].any) // 2])
    panels = [figure.add_subplot(grid[1, leak]) for leak in (0, 1)]
    for color, width, name in zip(COLORS, (1.1, 1.1, 3.0, 1.1), DRAWN, strict=False):
        top.plot(leaks[0][name].any[one] - above[name], color=color, linewidth=width, label=name)
        for axes, found in zip(panels, leaks, strict=True):
            at = alarms(found[name].any, above[name])
            late = np.sort(at[at >= START]) - START
            axes.step(late, (1 + np.arange(late.size)) / late.size, where="post", color=color, linewidth=width)
    top.axhline(0, color=TRUE, linewidth=0.8)
    top.axvline(START, color=TRUE, linewidth=0.8, linestyle=":")
    top.set(xlim=(0, STEPS), ylim=(-40, 40), xlabel="step (the upper tank leaks from the dotted line on)", ylabel="above the threshold")
    for axes, which in zip(panels, ("upper", "lower"), strict=True):
        axes.set(xlim=(0, 200), ylim=(0, 1), xlabel=f"steps since the leak of the {which} tank", ylabel="share of runs with an alarm")
    for axes in figure.axes:
        tidy(axes)
    legend_below(figure, top, 4)
    return figure


def main():
    """Simulate all runs, print the table and draw the picture."""
    parser = argparse.ArgumentParser(description="Detection of leaks.")
    parser.add_argument("--runs", type=int, default=200, help="runs with each leak; twice as many without, and as many to check (200)")
    parser.add_argument("--particles", type=int, default=30, help="of the jump-Markov filter (30)")
    given = parser.parse_args()
    worlds = [SOUND] * 4 + [tanks(*shares, since=START) for shares in np.diag([LEAK, LEAK])]
    ys = jnp.concatenate([simulated(seed, truth, given.runs) for seed, truth in enumerate(worlds)])
    found = watched(ys, given.particles)
    ends = ((0, 2), (2, 4), (4, 5), (5, 6))
    sound, fresh, *leaks = (some_of(found, slice(first * given.runs, last * given.runs)) for first, last in ends)
    table, above = compared(sound, fresh, leaks)
    print(table)
    Path("out").mkdir(exist_ok=True)
    picture(leaks, above).savefig("out/leak.png", dpi=80)
    print("picture: out/leak.png")


if __name__ == "__main__":
    main()
