"""How many groups of galaxies are there? A mixture of Gaussians with an unknown number of components.

    python examples/galaxies/run.py [--draws 3000]

82 velocities (Roeder 1990, `mo.data.galaxies`), whose 78th value is put right (26 960 km/s). A component has an amount a
with the law Gamma(1), a mean N(20, 10^2) and a log standard deviation N(0, 0.7^2), in 1000 km/s; weights are amounts over their sum; the
number of components is uniform on 1 to 10. The picture goes to out/galaxies.png. It takes about two minutes.
"""

import argparse
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

import motes as mo
from motes.plotting.figures import new_figure, tidy

MOST = 10
LAW = mo.Gaussian(jnp.array([0.0, 20.0, 0.0]), jnp.diag(jnp.array([1.5, 100.0, 0.5])))
"""Proposals of log amount, mean and log standard deviation."""


def density_at(x, k, points):
    """Log density of a mixture at points `(n,)`."""
    amount, mean, log_sd = x.reshape(MOST, 3).T
    log_weights = jax.nn.log_softmax(jnp.where(jnp.arange(MOST) < k, amount, -jnp.inf))
    each = log_weights[:, None] - 0.5 * ((points - mean[:, None]) / jnp.exp(log_sd[:, None])) ** 2 - log_sd[:, None]
    return jax.nn.logsumexp(each, axis=0) - 0.5 * jnp.log(2 * jnp.pi)


def problem(data):
    """Return log density, kernel and start; without data the prior alone."""
    points = jnp.asarray(data, jnp.float32)

    def log_density(c):
        amount, mean, log_sd = c.x.reshape(MOST, 3).T
        # of the log of a Gamma(1) number
        prior = amount - jnp.exp(amount) - (mean - 20) ** 2 / 200 - (log_sd / 0.7) ** 2 / 2 - jnp.log(10 * 0.7 * 2 * jnp.pi)
        total = jnp.sum(jnp.where(jnp.arange(MOST) < c.model, prior, 0))
        fits = jnp.sum(density_at(c.x, c.model, points)) if points.shape[0] else 0.0
        return jnp.where(c.model >= 1, total + fits, -jnp.inf)

    def split(component, u):
        amount, mean, log_sd = component
        share, apart, ratio = jax.nn.sigmoid(u[0]), u[1] * jnp.exp(log_sd), u[2]
        one = jnp.stack([amount + jnp.log(share), mean - apart * (1 - share), log_sd + ratio])
        return one, jnp.stack([amount + jnp.log1p(-share), mean + apart * share, log_sd - ratio])

    def merge(one, other):
        amount = jnp.logaddexp(one[0], other[0])
        share, log_sd = jnp.exp(one[0] - amount), (one[2] + other[2]) / 2
        mean = share * one[1] + (1 - share) * other[1]
        u = jnp.stack([one[0] - other[0], (other[1] - one[1]) / jnp.exp(log_sd), (one[2] - other[2]) / 2])
        return jnp.stack([amount, mean, log_sd]), u

    apart = mo.Gaussian(jnp.zeros(3), jnp.diag(jnp.array([2.0, 2.0, 0.2])))
    jumps = mo.mcmc.birth_death(LAW, MOST) | mo.mcmc.split_merge(split, merge, apart, MOST, 3)
    sizes = jnp.tile(jnp.array([0.2, 0.3, 0.15]), MOST)
    walks = mo.mcmc.Mix([mo.mcmc.RandomWalkMetropolis(0.4 * sizes), mo.mcmc.RandomWalkMetropolis(1.2 * sizes)])
    kernel = mo.mcmc.ReversibleJump(jumps, lambda k: 3 * k, within=walks)
    return log_density, kernel, mo.mcmc.Configuration(jnp.int32(1), jnp.zeros(3 * MOST).at[:3].set(jnp.array([0.0, 20.0, 1.5])))


def main():
    """Draw the posterior of the number of components."""
    parser = argparse.ArgumentParser(description="Number of components of a mixture.")
    parser.add_argument("--draws", type=int, default=3000, help="draws of each of eight chains (3000)")
    given = parser.parse_args()
    data = mo.data.galaxies().values[:, 0] / 1000
    log_density, kernel, start = problem(data)
    chains = mo.sample(0, mo.mcmc.Repeat(kernel, 20), log_density, start, draws=given.draws, chains=8)
    counts = np.asarray(chains.positions.model)
    print(mo.mcmc.frequencies(counts))
    print(f"R-hat of the number: {mo.mcmc.r_hat(counts):.3f}; effective draws: {mo.mcmc.mean_ess(counts):.0f}")
    for name, rate in chains.acceptance.items():
        print(f"{name}: {rate:.1%} accepted")
    grid = jnp.linspace(5, 40, 400)
    some = jax.tree.map(lambda leaf: leaf[:, ::20].reshape(-1, *leaf.shape[2:]), chains.positions)
    every = jax.vmap(lambda c: density_at(c.x, c.model, grid))(some)
    figure = new_figure(8, 4)
    axes = figure.add_subplot()
    tidy(axes)
    axes.hist(data, bins=50, density=True, color="0.85", label="galaxies")
    axes.plot(grid, np.exp(np.asarray(every)).mean(axis=0), label="density, mean of the draws")
    axes.set(xlabel="velocity, 1000 km/s", ylabel="share per 1000 km/s")
    axes.legend(frameon=False)
    Path("out").mkdir(exist_ok=True)
    figure.savefig("out/galaxies.png")
    print("picture: out/galaxies.png")


if __name__ == "__main__":
    main()
