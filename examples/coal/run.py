"""How many times did the rate of coal-mining disasters change, and when?

    python examples/coal/run.py [--draws 4000]

Yearly counts of British disasters (Jarrett 1979, `mo.data.coal`). Prints the posterior of the number of changes beside the exact
one; the picture goes to out/coal.png. It takes about a minute.
"""

import argparse
from pathlib import Path

import jax
import numpy as np
from exact import exact
from model import log_prior, problem, spans

import motes as mo
from motes.plotting.figures import new_figure, tidy


def main():
    """Draw the posterior and set it beside the exact one."""
    parser = argparse.ArgumentParser(description="Change points of coal-mining disasters.")
    parser.add_argument("--draws", type=int, default=4000, help="draws of each of eight chains (4000)")
    given = parser.parse_args()
    counts = mo.data.coal().values[:, 0].astype(int)
    log_density, kernel, start = problem(counts)
    chains = mo.sample(0, mo.mcmc.Repeat(kernel, 5), log_density, start, draws=given.draws, chains=8, burn_in=given.draws // 4)
    number, first = exact(counts, log_prior())
    model = np.asarray(chains.positions.model)
    table = mo.mcmc.frequencies(model.sum(axis=-1))
    rows = [(*row, float(number[int(row[0])]), (row[1] - number[int(row[0])]) / row[2] if row[2] > 0 else None) for row in table.rows]
    print(mo.io.Table(("changes", "probability", "s.e.", "exact", "z"), tuple(rows)))
    years = np.where(model.any(axis=-1), 1852 + model.argmax(axis=-1), np.nan)
    exact_mean = (first * (1852 + np.arange(111))).sum() / first.sum()
    drawn = years[:, :][np.isfinite(years)]
    print(f"\nfirst change at the beginning of {drawn.mean():.2f} (exact {exact_mean:.2f}), "
          f"standard error {mo.mcmc.standard_error(np.where(np.isfinite(years), years, drawn.mean())):.2f}")  # fmt: skip
    for name, rate in chains.acceptance.items():
        print(f"{name}: {rate:.0%} accepted")
    rates = np.asarray(jax.vmap(jax.vmap(lambda c: c.x[spans(c.model)]))(chains.positions)).reshape(-1, len(counts))
    figure = new_figure(8, 4)
    axes = figure.add_subplot()
    tidy(axes)
    low, middle, high = np.quantile(rates, [0.05, 0.5, 0.95], axis=0)
    axes.bar(1851 + np.arange(112), counts, color="0.85", label="disasters")
    axes.fill_between(1851 + np.arange(112), low, high, alpha=0.3, step="mid", label="rate, 90 percent")
    axes.step(1851 + np.arange(112), middle, where="mid", label="median rate per year")
    axes.set(xlabel="year", ylabel="disasters a year")
    axes.legend(frameon=False)
    Path("out").mkdir(exist_ok=True)
    figure.savefig("out/coal.png")
    print("picture: out/coal.png")


if __name__ == "__main__":
    main()
