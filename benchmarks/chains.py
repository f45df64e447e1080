"""Effective draws per second of Markov chains, ours beside those of blackjax and emcee; writes CHAINS.md beside this file.

    python benchmarks/chains.py

Two problems: a Gaussian of ten dimensions whose standard deviations go from 1 to 10, correlated; and the change points of the coal-mining
disasters, drawn anew from three rates so that no file is needed. Bulk effective draws of the slowest quantity (library arviz-stats), over
the seconds of drawing alone: compiled before, warmed up before. Ours learn a whole covariance (`Adaptive`); blackjax's NUTS learns a
diagonal one, as its documentation has it. It takes some three minutes; leave the machine alone.
"""

import os
import sys
import time
from pathlib import Path

os.environ.setdefault("JAX_PLATFORMS", "cpu")

import jax
import jax.numpy as jnp
import numpy as np
from pages import told, write_page

import motes as mo

ROOT = Path(__file__).parents[1]
SIZE, TURNS = 10, 3
WARM = 20_000
"""Steps before; a random walk needs some ten thousand to learn the shape of ten dimensions by itself."""
COLUMNS = ("problem", "who", "chains", "draws of each", "seconds", "effective draws", "per second")


def covariance():
    """Return a covariance with correlations up to 0.8."""
    spread = np.linspace(1, 10, SIZE)
    apart = np.abs(np.subtract.outer(np.arange(SIZE), np.arange(SIZE)))
    return spread[:, None] * 0.8**apart * spread


COV = covariance()
PRECISION = jnp.asarray(np.linalg.inv(COV), jnp.float32)


def log_density(x):
    return -0.5 * jnp.dot(x, PRECISION @ x)


def slowest(draws):
    """Bulk effective size of the slowest of the quantities of draws (chain, draw, x)."""
    return min(mo.mcmc.bulk_ess(draws[..., k]) for k in range(draws.shape[-1]))


def timed(draw):
    """Return the least seconds of some calls, and what the last one gave."""
    seconds = []
    for turn in range(TURNS):
        began = time.perf_counter()
        found = draw(turn)
        seconds.append(time.perf_counter() - began)
    return min(seconds), found


def ours(name, kernel, chains, draws):
    """Continue chains that have warmed up."""
    warm = mo.sample(0, kernel, log_density, jnp.zeros(SIZE), draws=draws, chains=chains, burn_in=WARM)
    seconds, found = timed(lambda turn: mo.sample(1 + turn, kernel, log_density, warm, draws=draws))
    return row("Gaussian", f"motes, {name}", chains, draws, seconds, slowest(np.asarray(found.positions)))


def row(problem, who, chains, draws, seconds, effective):
    return problem, who, chains, draws, seconds, float(effective), float(effective / seconds)


def blackjaxs(name, chains, draws):
    """Run blackjax as its documentation does: window adaptation for NUTS, the optimal scale for the random walk; a scan under vmap."""
    import blackjax

    if name == "NUTS":
        adapt = blackjax.window_adaptation(blackjax.nuts, log_density)
        (state, parameters), _ = adapt.run(jax.random.key(0), jnp.zeros(SIZE), 1_000)
        kernel = blackjax.nuts(log_density, **parameters).step
        start = state.position
    else:
        factor = jnp.asarray(2.38 / SIZE**0.5 * np.linalg.cholesky(COV), jnp.float32)
        kernel = blackjax.additive_step_random_walk(log_density, lambda key, _: factor @ jax.random.normal(key, (SIZE,))).step
        start = jnp.zeros(SIZE)
    init = (blackjax.nuts if name == "NUTS" else blackjax.rmh).init

    @jax.jit
    def run(key):
        def one(key):
            keys = jax.random.split(key, draws + 500)
            states = jax.lax.scan(lambda state, key: (kernel(key, state)[0],) * 2, init(start, log_density), keys)[1]
            return states.position[500:]

        return jax.vmap(one)(jax.random.split(key, chains))

    jax.block_until_ready(run(jax.random.key(9)))
    seconds, found = timed(lambda turn: jax.block_until_ready(run(jax.random.key(turn))))
    # its 500 first draws are left out of the draws, and of the time in proportion
    return row("Gaussian", f"blackjax, {name}", chains, draws, seconds * draws / (draws + 500), slowest(np.asarray(found)))


def emcees(walkers, draws):
    """Run emcee's affine-invariant ensemble, vectorized over walkers in NumPy; effective draws by its own autocorrelation time."""
    import emcee

    precision = np.linalg.inv(COV)

    def each(points):
        return -0.5 * np.einsum("ni,ij,nj->n", points, precision, points)

    sampler = emcee.EnsembleSampler(walkers, SIZE, each, vectorize=True)
    state = sampler.run_mcmc(np.random.default_rng(0).normal(size=(walkers, SIZE)), 2_000)
    sampler.reset()
    began = time.perf_counter()
    sampler.run_mcmc(state, draws)
    seconds = time.perf_counter() - began
    effective = walkers * draws / np.max(sampler.get_autocorr_time(quiet=True))
    return row("Gaussian", "emcee, stretch", walkers, draws, seconds, effective)


def coal():
    """Count effective draws of the number of changes and of each year's rate at four years."""
    sys.path.insert(0, str(ROOT / "examples" / "coal"))
    from model import problem, spans

    counts = np.random.default_rng(1851).poisson([3.1] * 40 + [1.0] * 55 + [0.6] * 17)
    density, kernel, start = problem(counts)
    warm = mo.sample(0, kernel, density, start, draws=4_000, chains=8, burn_in=2_000)
    seconds, found = timed(lambda turn: mo.sample(1 + turn, kernel, density, warm, draws=4_000))
    rates = jax.vmap(jax.vmap(lambda c: c.x[spans(c.model)][jnp.array([10, 40, 60, 100])]))(found.positions)
    number = np.asarray(found.positions.model).sum(axis=-1)[..., None]
    return row("coal", "motes, reversible jump and Gibbs", 8, 4_000, seconds, slowest(np.concatenate([number, np.asarray(rates)], axis=-1)))


def attempted(what, who):
    """Run a measurement, or say why it could not be."""
    try:
        return what()
    except ImportError as reason:
        return "Gaussian", f"{who}: {reason}", None, None, None, None, None


def main():
    """Measure and write the table."""
    walk = mo.mcmc.Adaptive(mo.mcmc.RandomWalkMetropolis(), steps=WARM)
    rows = [
        ours("random walk", walk, 4, 20_000),
        ours("random walk", walk, 64, 4_000),
        ours("NUTS", mo.mcmc.Adaptive(mo.mcmc.NUTS(), steps=2_000), 4, 2_000),
        ours("HMC of 5 leaps", mo.mcmc.Adaptive(mo.mcmc.HMC(num_steps=5), steps=2_000), 4, 4_000),
        blackjaxs("random walk", 4, 20_000),
        blackjaxs("random walk", 64, 4_000),
        blackjaxs("NUTS", 4, 2_000),
        attempted(lambda: emcees(64, 4_000), "emcee"),
        coal(),
        ("coal", "blackjax, emcee: no moves between models of different size", None, None, None, None, None),
    ]
    write_page("CHAINS", "Effective draws per second", told(__doc__), mo.io.Table(COLUMNS, tuple(rows)))


if __name__ == "__main__":
    main()
