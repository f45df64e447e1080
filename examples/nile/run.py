"""When did the flow of the Nile change, how often, and by how much?

    python examples/nile/run.py [--draws 3000]

Yearly flow at Aswan, 1871 to 1970, in 1e8 m^3 (`mo.data.nile`). Levels between changes have the law N(1000, 200^2), the
log of the noise's standard deviation in 100 units N(0, 1); changes come at any new year, their number is Poisson(1) cut at 6. The picture
goes to out/nile.png. It takes about a minute.
"""

import argparse
from math import lgamma
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

import motes as mo
from motes.plotting.figures import ESTIMATE, TRUE, legend_below, new_figure, tidy

MOST = 6


def level(changes):
    """Return the level of each year."""
    return changes.x[jnp.append(0, jnp.cumsum(changes.model))]


def problem(flow):
    """Return log density, kernel and start: positions have the changes with their levels, and the noise."""
    y = jnp.asarray(flow, jnp.float32)
    places = len(flow) - 1
    of_number = jnp.asarray([-lgamma(k + 1) - (lgamma(places + 1) - lgamma(k + 1) - lgamma(places - k + 1)) for k in range(MOST + 1)])

    def log_density(p):
        c, log_sd = p["changes"], p["log sd"]
        changes = jnp.sum(c.model)
        off = y - level(c)
        levels = jnp.where(jnp.arange(MOST + 1) <= changes, -((c.x - 1000) ** 2) / (2 * 200.0**2) - jnp.log(200 * jnp.sqrt(2 * jnp.pi)), 0)
        sd = 100 * jnp.exp(log_sd)
        fits = jnp.sum(-0.5 * (off / sd) ** 2) - len(flow) * log_sd
        live = jnp.where(jnp.arange(MOST + 1) <= changes, c.x, 1.0)
        return jnp.where(jnp.all(live > 0), of_number[changes] + jnp.sum(levels) + fits - log_sd**2 / 2, -jnp.inf)

    # the first step after a change of levels is rough: steps of several sizes
    walk = mo.mcmc.Mix([mo.mcmc.RandomWalkMetropolis(8.0), mo.mcmc.RandomWalkMetropolis(30.0)])
    jumps = mo.mcmc.ReversibleJump(mo.mcmc.change_points(MOST, places, reach=5), lambda model: jnp.sum(model) + 1, within=walk)
    kernel = mo.mcmc.Cycle([mo.mcmc.Block("changes", jumps), mo.mcmc.Block("log sd", mo.mcmc.RandomWalkMetropolis(0.15))])
    start = {"changes": mo.mcmc.Configuration(jnp.zeros(places, jnp.int32), jnp.zeros(MOST + 1).at[0].set(900.0)), "log sd": 0.5}
    return log_density, kernel, start


def picture(years, flow, levels):
    """Draw the flow with the levels `(draw, year)`: their median and 90 percent band."""
    figure = new_figure(8, 4)
    axes = figure.add_subplot()
    tidy(axes)
    low, middle, high = np.quantile(levels, [0.05, 0.5, 0.95], axis=0)
    axes.plot(years, flow, ".", color=TRUE, label="flow of a year")
    axes.fill_between(years, low, high, color=ESTIMATE, alpha=0.25, linewidth=0, step="mid", label="level, 90 percent")
    axes.step(years, middle, where="mid", color=ESTIMATE, label="median level")
    axes.set(xlabel="year", ylabel="flow, 1e8 m$^3$ a year")
    legend_below(figure, axes, 3)
    return figure


def main():
    """Draw the posterior of changes and levels."""
    parser = argparse.ArgumentParser(description="Changes of the flow of the Nile.")
    parser.add_argument("--draws", type=int, default=3000, help="draws of each of eight chains (3000)")
    given = parser.parse_args()
    data = mo.data.nile()
    flow = data.values[:, 0]
    log_density, kernel, start = problem(flow)
    chains = mo.sample(0, mo.mcmc.Repeat(kernel, 10), log_density, start, draws=given.draws, chains=8)
    model = np.asarray(chains.positions["changes"].model)
    counts = model.sum(axis=-1)
    print(mo.mcmc.frequencies(counts))
    one = counts == 1
    years = 1872 + model[one].argmax(axis=-1)
    levels = np.asarray(chains.positions["changes"].x)[one][:, :2]
    best = np.bincount(years).argmax()
    print(f"given one change: at the beginning of {best} with probability {np.mean(years == best):.2f}, from "
          f"{levels[:, 0].mean():.0f} +- {levels[:, 0].std():.0f} to {levels[:, 1].mean():.0f} +- {levels[:, 1].std():.0f}; noise "
          f"{100 * np.exp(np.asarray(chains.positions['log sd'])[one]).mean():.0f}")  # fmt: skip
    for name, rate in chains.acceptance.items():
        print(f"{name}: {rate:.1%} accepted")
    drawn = np.asarray(jax.vmap(jax.vmap(level))(chains.positions["changes"])).reshape(-1, len(flow))
    Path("out").mkdir(exist_ok=True)
    picture(data.times, flow, drawn).savefig("out/nile.png")
    print("picture: out/nile.png")


if __name__ == "__main__":
    main()
