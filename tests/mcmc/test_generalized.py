"""The generalized Markov sampler has Gibbs, Metropolis-Hastings and reversible jump as special cases."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

import motes as mo
from motes.core import random
from motes.core.checks import MotesError

mcmc = mo.mcmc
COV = jnp.array([[1.0, 0.6], [0.6, 0.5]])
LAW = mo.Gaussian(jnp.array([1.0, -1.0]), COV)


def draw_first(key, x):
    return 1.0 + COV[0, 1] / COV[1, 1] * (x[1] + 1) + jnp.sqrt(COV[0, 0] - COV[0, 1] ** 2 / COV[1, 1]) * jax.random.normal(key)


def draw_second(key, x):
    return -1.0 + COV[0, 1] / COV[0, 0] * (x[0] - 1) + jnp.sqrt(COV[1, 1] - COV[0, 1] ** 2 / COV[0, 0]) * jax.random.normal(key)


def test_gibbs_draw_for_draw():
    """Phi(x) = {0, 1}, Q leads from each coordinate to the next, R draws that coordinate from its law given the other."""

    def r(key, m, x):
        key = random.step_key(key, 0)
        return m, jnp.where(m == 0, x.at[0].set(draw_first(key, x)), x.at[1].set(draw_second(key, x)))

    sampler = mcmc.GeneralizedSampler(lambda x: jnp.ones(2, bool), lambda i, x: jnp.where(jnp.arange(2) == (i + 1) % 2, 0.0, -jnp.inf),
                                      r=r, start=1)  # fmt: skip
    state = sampler.init(random.as_key(0), LAW.log_prob, jnp.zeros(2))
    x = jnp.zeros(2)
    for t in range(20):
        key = random.step_key(random.as_key(5), t)
        state, _ = sampler.step(key, LAW.log_prob, state, t)
        # the sampler as everybody writes it, with the same keys
        drawn = random.step_key(random.child(key, random.UPDATE), 0)
        x = x.at[0].set(draw_first(drawn, x)) if t % 2 == 0 else x.at[1].set(draw_second(drawn, x))
        np.testing.assert_array_equal(np.asarray(state.position), np.asarray(x))


def pairs(log_density, proposal_log_prob):
    """Metropolis-Hastings as a generalized sampler: points are pairs (x, y); type 0 draws y given x, type 1 swaps them."""

    def joint(z):
        return log_density(z[0]) + proposal_log_prob(z[1], z[0])

    def swap(m, z):
        both = jnp.stack([z, z[::-1]])
        return mcmc.Orbit(jnp.array([1, 1]), both, jnp.zeros(2), 0)

    return joint, swap


def test_metropolis_hastings_in_law():
    """The R step of type 1 on the orbit {(x, y), (y, x)} is the acceptance of Metropolis-Hastings."""
    sd = 1.3

    def target(x):
        return jnp.logaddexp(jnp.log(0.7) - 0.5 * (x + 1) ** 2, jnp.log(0.3) - 2 * (x - 2) ** 2 + jnp.log(2.0))

    def proposed(y, x):
        # not symmetric
        return -0.5 * ((y - 0.5 * x) / sd) ** 2

    joint, swap = pairs(target, proposed)
    swaps = mcmc.GeneralizedSampler(lambda z: jnp.array([False, True]), lambda i, z: jnp.array([-jnp.inf, 0.0]), swap, "metropolis", 1)

    def refresh(key, m, z):
        return jnp.int32(0), jnp.stack([z[0], 0.5 * z[0] + sd * jax.random.normal(key)])

    fresh = mcmc.GeneralizedSampler(lambda z: jnp.array([True, False]), lambda i, z: jnp.array([0.0, -jnp.inf]), r=refresh)

    def start(key):
        component = jax.random.uniform(random.child(key, 3)) < 0.7
        noise = jax.random.normal(random.child(key, 4))
        x = jnp.where(component, -1 + noise, 2 + 0.5 * noise)
        return jnp.stack([x, 0.5 * x + sd * jax.random.normal(random.child(key, 5))])

    one = mo.sample(0, mcmc.Repeat(mcmc.Cycle([swaps, fresh]), 20), joint, start, draws=1, chains=5_000, burn_in=0)
    fresh_x = np.asarray(jax.vmap(start)(jax.vmap(lambda k: random.step_key(random.as_key(9), k))(jnp.arange(20_000))))[:, 0]
    assert stats.ks_2samp(np.asarray(one.positions)[:, 0, 0], fresh_x).pvalue > 1e-6
    # and it accepts as often as Metropolis-Hastings
    proposal = mo.AdditiveGaussian(lambda x, u, t: 0.5 * x, sd**2 * jnp.eye(1))
    metropolis = mcmc.Repeat(mcmc.MetropolisHastings(proposal), 20)
    other = mo.sample(0, metropolis, lambda x: target(x[0]), lambda key: start(key)[:1], draws=1, chains=5_000, burn_in=0)
    moved = [np.asarray(chains.positions)[:, 0, ...].reshape(5_000, -1)[:, 0] for chains in (one, other)]
    assert stats.ks_2samp(*moved).pvalue > 1e-6


@pytest.mark.parametrize("r", ["gibbs", "metropolis"])
def test_reversible_jump_in_law(r):
    """One number or two: (1, a) and (2, (b, c)) with a = b + c, u = b / (b + c) and the Jacobian a; u lives on with a as an auxiliary."""
    shares = jnp.log(jnp.array([0.35, 0.65]))

    def log_density(p):
        a, b = p["x"]
        # model 0: a ~ Gamma(3), u ~ U(0, 1); model 1: b ~ Gamma(2), c ~ Gamma(2)
        one = shares[0] + 2 * jnp.log(a) - a - jnp.log(2.0) + jnp.where((b > 0) & (b < 1), 0.0, -jnp.inf)
        two = shares[1] + jnp.log(a) + jnp.log(b) - a - b
        return jnp.where(p["model"] == 0, one, two)

    def orbit(m, p):
        x, model = p["x"], p["model"]
        split = jnp.stack([x[0] * x[1], x[0] * (1 - x[1])])
        merged = jnp.stack([x[0] + x[1], x[0] / (x[0] + x[1])])
        there = jnp.where(model == 0, split, merged)
        log_jacobian = jnp.where(model == 0, jnp.log(x[0]), -jnp.log(x[0] + x[1]))
        points = {"x": jnp.stack([x, there]), "model": jnp.stack([model, 1 - model])}
        return mcmc.Orbit(jnp.zeros(2, jnp.int32), points, jnp.stack([0.0, log_jacobian]), 0)

    jump = mcmc.GeneralizedSampler(lambda p: jnp.ones(1, bool), lambda i, p: jnp.zeros(1), orbit, r)

    def start(key):
        g = jax.random.gamma(random.child(key, 3), jnp.array([3.0, 2.0, 2.0]))
        model = (jax.random.uniform(random.child(key, 4)) < 0.65).astype(jnp.int32)
        one = jnp.stack([g[0], jax.random.uniform(random.child(key, 5))])
        return {"x": jnp.where(model == 0, one, g[1:]), "model": model}

    kernel = mcmc.Cycle([jump, mcmc.Block("x", mcmc.RandomWalkMetropolis(0.4))])
    safe = lambda p: jnp.where(jnp.all(p["x"] > 0), log_density(jax.tree.map(jnp.abs, p)), -jnp.inf)  # noqa: E731
    chains = mo.sample(0, mcmc.Repeat(kernel, 25), safe, start, draws=1, chains=5_000, burn_in=0)
    model, x = np.asarray(chains.positions["model"])[:, 0], np.asarray(chains.positions["x"])[:, 0]
    assert stats.binomtest(int(model.sum()), 5_000, 0.65).pvalue > 1e-6
    assert stats.kstest(x[model == 0, 0], stats.gamma(3).cdf).pvalue > 1e-6
    assert stats.kstest(x[model == 1, 1], stats.gamma(2).cdf).pvalue > 1e-6


def test_probabilities_that_q_leaves_as_they_are():
    Q = np.array([[0.1, 0.6, 0.3], [0.5, 0.2, 0.3], [0.25, 0.25, 0.5]])
    sampler = mcmc.GeneralizedSampler(lambda x: jnp.ones(3, bool), lambda i, x: jnp.log(jnp.asarray(Q))[i], r=lambda key, m, x: (m, x))
    q = np.exp(np.asarray(sampler.log_stationary(jnp.zeros(1))))
    np.testing.assert_allclose(q @ Q, q, atol=1e-6)
    cycle = lambda i, x: jnp.where(jnp.arange(3) == (i + 1) % 2, 0.0, -jnp.inf)  # noqa: E731
    cyclic = mcmc.GeneralizedSampler(lambda x: jnp.array([True, True, False]), cycle, r=lambda key, m, x: (m, x))
    np.testing.assert_allclose(np.exp(np.asarray(cyclic.log_stationary(jnp.zeros(1)))), [0.5, 0.5, 0.0], atol=1e-6)


def test_refusals():
    def flip(m, x):
        return mcmc.Orbit(jnp.array([0, 0]), jnp.stack([x, -x]), jnp.zeros(2), 0)

    def drift(m, x):
        return mcmc.Orbit(jnp.array([0, 0]), jnp.stack([x, x + 1]), jnp.zeros(2), 0)

    one, sure = (lambda x: jnp.ones(1, bool)), (lambda i, x: jnp.zeros(1))
    density = lambda x: -0.5 * jnp.sum(x**2)  # noqa: E731
    mo.sample(0, mcmc.GeneralizedSampler(one, sure, flip), density, jnp.ones(1), draws=1)
    with pytest.raises(MotesError, match=r"psi\(0, x\): expected the same pairs from each of its pairs"):
        mo.sample(0, mcmc.GeneralizedSampler(one, sure, drift), density, jnp.ones(1), draws=1)
    with pytest.raises(MotesError, match=r"q\(0, x\): expected logs of probabilities on phi\(x\) that sum to 1, got a sum of 0.5"):
        mo.sample(0, mcmc.GeneralizedSampler(one, lambda i, x: jnp.log(0.5) * jnp.ones(1), flip), density, jnp.ones(1), draws=1)
    with pytest.raises(MotesError, match="GeneralizedSampler psi: expected a function that gives orbits"):
        mcmc.GeneralizedSampler(one, sure)
    with pytest.raises(MotesError, match="GeneralizedSampler r: expected one of"):
        mcmc.GeneralizedSampler(one, sure, flip, "magic")
