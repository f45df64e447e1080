"""Two cascaded tanks: five parameters in one pass over half of the recording, the other half foretold from the pump alone.

    python examples/tanks/run.py [--data FOLDER] [--particles 1000] [--seeds 10] [--walk 0.003]

FOLDER holds identification/tanks.csv, the benchmark of Schoukens and Noel; without it tanks of the same kind are simulated. The picture
goes to out/tanks.png. It takes half a minute.
"""

import argparse
from functools import partial
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from model import PRIOR, PRIOR_SD, made_up, recorded, simulated, tanks
from scipy.optimize import least_squares

import motes as mo
from motes.plotting.figures import ESTIMATE, INERTIAL, TRUE, legend_below, new_figure, tidy

WALK, NOISES = 0.003, (0.05, 0.1)
TITLES = ("k1, out of the upper", "k2, into the lower", "k3, out of the lower", "k4, pump", "k5, overflow")


def foretold(k, recording):
    """Simulate the test half from its first level, which hardly moves: the upper tank is taken to bring what runs out of the lower one."""
    first = float(recording.y_test[0])
    return np.asarray(simulated(jnp.asarray(k, jnp.float32), (k[2] / k[1]) ** 2 * first, first, recording.u_test))


def rmse(k, recording):
    """Root mean square of the errors of the simulated test half, V."""
    return float(np.sqrt(np.mean((foretold(k, recording) - recording.y_test) ** 2)))


def fitted(recording):
    """Parameters with which the simulated first half comes nearest to the measured one, of searches that begin at several places."""

    def off(p):
        return simulated(p[:5], p[5], recording.y[0], recording.u) - recording.y

    values, slopes = (lambda p, of=of: np.asarray(of(jnp.float32(p)), float) for of in (jax.jit(off), jax.jit(jax.jacfwd(off))))
    starts = [[k, 0.2, 0.2, 0.2, k5, 5.0] for k in (0.1, 0.2, 0.3) for k5 in (0.5, 1.0)]
    return min((least_squares(values, start, slopes) for start in starts), key=lambda found: found.cost).x[:5]


def passed(filter, model, recording, seeds=1):
    """Go over the first half with so many seeds; the step to t is driven by the pump at t - 1."""
    driven = jnp.concatenate([jnp.zeros(1, jnp.float32), jnp.asarray(recording.u[:-1])])
    return jax.vmap(lambda key: mo.run(key, filter, model, recording.y[:, None], driven))(jax.random.split(jax.random.key(0), seeds))


def compared(recording, particles, seeds, steps=WALK):
    """Return a table of all ways, the least-squares parameters, and the run of the marginalized filter with walking parameters."""
    k, rows, kept = fitted(recording), [], None
    rows.append(("least squares", "constant", None, rmse(k, recording), None, None, None))
    particle = partial(passed, mo.MarginalizedParticleFilter(n=particles), recording=recording, seeds=seeds)
    # a Gaussian filter that loses the level is to go on, as the others do
    ways = {"marginalized particle filter": (particle, "sensor"),
            "extended Kalman": (partial(passed, mo.ExtendedKalmanFilter(on_collapse="predict"), recording=recording), "dynamics"),
            "unscented Kalman": (partial(passed, mo.UnscentedKalmanFilter(on_collapse="predict"), recording=recording),
                                 "dynamics")}  # fmt: skip
    for name, (run, capped) in ways.items():
        for walk in (0.0, steps):
            for noise in NOISES:
                history = run(model=tanks(recording.y[0], walk, noise, capped))
                off = [rmse(mean, recording) for mean in np.asarray(history.mean)[:, -1, 2:]]
                spread = (min(off), max(off)) if len(off) > 1 else (None, None)
                log_likelihood = float(np.median(history.log_likelihood))
                rows.append((name, "walking" if walk else "constant", noise, float(np.median(off)), *spread, log_likelihood))
                kept = history if kept is None and walk else kept
    head = ("way", "parameters", "noise of levels, V", "RMSE, V", "least", "largest", "log likelihood")
    return mo.io.Table(head, tuple(rows)), k, kept


def picture(recording, history, k):
    """Draw the foretold half and the parameters of the run whose simulation is the median one."""
    mean, cov = np.asarray(history.mean), np.asarray(history.cov)
    off = [rmse(one[-1, 2:], recording) for one in mean]
    run = int(np.argsort(off)[len(off) // 2])
    figure = new_figure(9, 5.2)
    grid = figure.add_gridspec(2, 5, height_ratios=(1.4, 1))
    top = figure.add_subplot(grid[0, :])
    minutes = np.arange(len(recording.y_test)) * 4 / 60
    top.plot(minutes, recording.y_test, color=TRUE, linewidth=1.6, label="measured")
    top.plot(minutes, foretold(mean[run, -1, 2:], recording), color=ESTIMATE, linewidth=1.1, label="simulated, by particle filter")
    top.plot(minutes, foretold(k, recording), color=INERTIAL, linewidth=0.9, linestyle="--", label="simulated, by least squares")
    top.set(xlabel="minutes of the test half", ylabel="lower level, V", xlim=(0, minutes[-1]))
    tidy(top)
    for place, name in enumerate(TITLES):
        axes = figure.add_subplot(grid[1, place])
        middle, sd = mean[run, :, 2 + place], np.sqrt(cov[run, :, 2 + place, 2 + place])
        axes.fill_between(minutes, middle - 2 * sd, middle + 2 * sd, color=ESTIMATE, alpha=0.25, linewidth=0)
        axes.plot(minutes, middle, color=ESTIMATE, linewidth=1)
        axes.axhline(k[place], color=INERTIAL, linewidth=0.9, linestyle="--")
        axes.set(ylim=(PRIOR[place] - 2 * PRIOR_SD[place], PRIOR[place] + 2 * PRIOR_SD[place]), xlim=(0, minutes[-1]))
        axes.set_title(name, fontsize=9)
        tidy(axes)
    figure.axes[3].set_xlabel("minutes of the first half")
    legend_below(figure, top, 3)
    return figure


def main():
    """Learn the parameters in all ways, print the table and draw the picture."""
    parser = argparse.ArgumentParser(description="Identification of two cascaded tanks.")
    parser.add_argument("--data", type=Path, help="folder with identification/tanks.csv; simulated tanks without it")
    parser.add_argument("--particles", type=int, default=1000, help="number of particles (1000)")
    parser.add_argument("--seeds", type=int, default=10, help="passes of the particle filter (10)")
    parser.add_argument("--walk", type=float, default=WALK, help=f"step of a parameter that walks, in sd of its prior ({WALK})")
    given = parser.parse_args()
    recording = recorded(given.data / "identification" / "tanks.csv") if given.data else made_up()
    print(mo.structure(tanks(recording.y[0], given.walk, NOISES[0]), inputs=jnp.float32(0)), end="\n\n")
    table, k, history = compared(recording, given.particles, given.seeds, given.walk)
    print(table)
    Path("out").mkdir(exist_ok=True)
    picture(recording, history, k).savefig("out/tanks.png", dpi=80)
    print("picture: out/tanks.png")


if __name__ == "__main__":
    main()
