"""Stochastic volatility of the pound: persistence, level and spread, three ways.

    python examples/pound/run.py [--returns 945] [--draws 2000]

The 945 returns from 1 October 1981 to 28 June 1985 (Harvey, Ruiz, Shephard 1994; `mo.data.pound`),
in percent.

    h_t = mu + phi (h_{t-1} - mu) + sigma eta_t,  y_t = exp(h_t / 2) eps_t

Parameters mu, atanh phi, log sigma with independent normal priors. The likelihood is taken by a grid (exact to its spacing), by a particle
filter in PMMH, and not at all in particle Gibbs, which draws the volatilities too. The three agree. It takes some ten minutes.

Given the volatilities h, sigma can hardly move; given (h - mu) / sigma, mu can hardly move. So particle Gibbs moves the parameters in both
coordinates in turn.
"""

import argparse
import time

import jax.numpy as jnp
import numpy as np

import motes as mo

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


if __name__ == "__main__":
    main()
