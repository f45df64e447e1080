"""Stochastic volatility of the pound: persistence, level and spread, three ways.

    python examples/pound/run.py [--returns 945] [--draws 2000]

The 945 returns from 1 October 1981 to 28 June 1985 (Harvey, Ruiz, Shephard 1994; `mo.data.pound`),
in percent.

    h_t = mu + phi (h_{t-1} - mu) + sigma eta_t,  y_t = exp(h_t / 2) eps_t

Parameters mu, atanh phi, log sigma with independent normal priors. The likelihood is taken by a grid (exact to its spacing), by a particle
filter in PMMH, and not at all in particle Gibbs, which draws the volatilities too. The three agree. The picture of the volatilities goes to
out/pound.png. It takes some ten minutes.

Given the volatilities h, sigma can hardly move; given (h - mu) / sigma, mu can hardly move. So particle Gibbs moves the parameters in both
coordinates in turn.
"""

import argparse
import time
from pathlib import Path

import jax.numpy as jnp
import numpy as np

import motes as mo
from motes.plotting.figures import ESTIMATE, legend_below, new_figure, over_time, tidy

NAMES = ("mu", "atanh phi", "log sigma")
PRIOR = mo.Gaussian(jnp.array([0.0, 2.0, -2.0]), jnp.diag(jnp.array([1.0, 0.25, 0.5])))
START = jnp.array([-0.6, 2.0, -1.8])


def model(theta):
    """Return the model with the parameters of the head of this file; it starts from its stationary law."""
    mu, phi, sigma = theta[0], jnp.tanh(theta[1]), jnp.exp(theta[2])
    stationary = sigma**2 / (1 - phi**2)
    return mo.StateSpaceModel(
        mo.Gaussian(mu[None], stationary[None, None]),
        mo.AdditiveGaussian(lambda h, u, t: mu + phi * (h - mu), sigma**2 * jnp.eye(1)),
        mo.AdditiveGaussian(lambda h, u, t: jnp.zeros(1), lambda h, u, t: jnp.exp(h)[:, None]),
        names=("log variance",),
    )


def returns():
    """Returns of the pound in percent, mean removed, `(945, 1)`."""
    change = 100 * np.diff(np.log(mo.data.pound().values), axis=0)
    return change - change.mean()


def shaped(position):
    """Give the path in standard deviations about its level."""
    mu, _, log_sigma = position["theta"]
    return {**position, "path": (position["path"] - mu) * jnp.exp(-log_sigma)}


def unshaped(position):
    """Undo `shaped`."""
    mu, _, log_sigma = position["theta"]
    return {**position, "path": mu + jnp.exp(log_sigma) * position["path"]}


def ways(ys, particles, nodes):
    """Return each way's kernel, log density, start and the place of the parameters in its positions."""
    walk = mo.mcmc.RandomWalkMetropolis()
    grid = mo.parameters.Posterior(PRIOR, model, mo.PointMassFilter((-6.0,), (5.0,), (nodes,)), ys)
    estimated = mo.parameters.Posterior(PRIOR, model, mo.ParticleFilter(n=particles), ys)
    paths = mo.parameters.PathPosterior(PRIOR, model, ys)
    given_path = mo.mcmc.Repeat(mo.mcmc.Block("theta", mo.mcmc.Adaptive(walk, steps=2_500)), 5)
    given_shape = mo.mcmc.Reparametrized(given_path, shaped, unshaped, lambda z: z["path"].size * z["theta"][2])
    gibbs = mo.mcmc.Cycle([mo.parameters.ParticleGibbs(30), given_path, given_shape])
    return {
        "grid": (mo.mcmc.Adaptive(walk, steps=500), grid, START),
        "PMMH": (mo.mcmc.Adaptive(mo.mcmc.PseudoMarginal(walk), steps=500), estimated, START),
        "particle Gibbs": (gibbs, paths, {"theta": START, "path": jnp.log(jnp.asarray(ys) ** 2 + 0.1)}),
    }


def picture(days, ys, paths):
    """Draw the sizes of returns with the volatility: median and 90 percent band over paths of the log variance `(draw, day)`."""
    figure = new_figure(8, 4)
    axes = figure.add_subplot()
    tidy(axes)
    low, middle, high = np.quantile(np.exp(paths / 2), [0.05, 0.5, 0.95], axis=0)
    axes.vlines(days, 0, np.abs(ys), color="0.75", linewidth=0.8, label="size of the return")
    axes.fill_between(days, low, high, color=ESTIMATE, alpha=0.3, linewidth=0, label="volatility, 90 percent")
    axes.plot(days, middle, color=ESTIMATE, label="median volatility")
    axes.set(ylabel="percent a day", ylim=(0, None))
    over_time(figure, days)
    legend_below(figure, axes, 3)
    return figure


def main():
    """Draw the posterior in three ways."""
    parser = argparse.ArgumentParser(description="Stochastic volatility of the pound.")
    parser.add_argument("--returns", type=int, default=945, help="how many of the returns (945)")
    parser.add_argument("--draws", type=int, default=2000, help="draws of each of four chains (2000)")
    parser.add_argument("--particles", type=int, default=200, help="of PMMH (200)")
    parser.add_argument("--nodes", type=int, default=150, help="of the grid (150)")
    given = parser.parse_args()
    ys = returns()[: given.returns]
    found, rows = {}, []
    for name, (kernel, log_density, start) in ways(ys, given.particles, given.nodes).items():
        began = time.perf_counter()
        chains = mo.sample(0, kernel, log_density, start, draws=given.draws, burn_in=500)
        thetas = chains.positions["theta"] if isinstance(chains.positions, dict) else chains.positions
        found[name] = np.asarray(thetas, float)
        for k, quantity in enumerate(NAMES):
            draws = found[name][..., k]
            sure = mo.mcmc.standard_error(draws), mo.mcmc.bulk_ess(draws), mo.mcmc.r_hat(draws)
            rows.append((name, quantity, draws.mean(), draws.std(), *sure))
        print(f"{name}: {time.perf_counter() - began:.0f} s", flush=True)
    print(mo.io.Table(("way", "quantity", "mean", "sd", "s.e.", "bulk ESS", "R-hat"), tuple(rows)))
    for name in ("PMMH", "particle Gibbs"):
        away = [(found[name][..., k].mean() - found["grid"][..., k].mean()) / np.hypot(
            mo.mcmc.standard_error(found[name][..., k]), mo.mcmc.standard_error(found["grid"][..., k])) for k in range(3)]  # fmt: skip
        print(f"{name} less grid, in standard errors: {', '.join(f'{value:.1f}' for value in away)}")
    print(f"phi: {np.tanh(found['grid'][..., 1]).mean():.3f}, sigma: {np.exp(found['grid'][..., 2]).mean():.3f}")
    # the last way is particle Gibbs; a tenth of its paths is enough for a picture
    paths = np.asarray(chains.positions["path"])[:, ::10, :, 0].reshape(-1, len(ys))
    Path("out").mkdir(exist_ok=True)
    picture(mo.data.pound().times[1 : len(ys) + 1], ys[:, 0], paths).savefig("out/pound.png")
    print("picture: out/pound.png")


if __name__ == "__main__":
    main()
