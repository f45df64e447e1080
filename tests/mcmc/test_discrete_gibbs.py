"""Gibbs steps of coordinates that have a few values, and replicas that exchange positions, against enumeration."""

from itertools import product

import jax.numpy as jnp
import numpy as np
import pytest

import motes as mo

mcmc = mo.mcmc
FAR = 4.9
"""Standard errors: 1e-6 two-sided."""
VALUES = (-1.0, 0.5, 2.0)
TABLE = np.random.default_rng(5).normal(0, 1.2, (3, 3, 3))
TABLE[0, 1, 2] = -np.inf


def log_density(x):
    return jnp.asarray(TABLE, jnp.float32)[tuple(jnp.argmin(jnp.abs(x[k] - jnp.array(VALUES))) for k in range(3))]


def far_from(chains, points, probabilities):
    """Largest difference between shares of draws and probabilities, in standard errors of the chains."""
    found = []
    for point, probability in zip(points, probabilities, strict=True):
        here = 1.0 * (np.asarray(chains.positions) == point).all(axis=-1)
        found.append(abs(here.mean() - probability) / mcmc.standard_error(here))
    return max(found)


def test_frequencies_equal_enumeration():
    chains = mo.sample(0, mcmc.DiscreteGibbs(VALUES), log_density, jnp.full(3, 2.0), draws=4_000, burn_in=100)
    points = np.array(list(product(VALUES, repeat=3)))
    weights = np.exp(TABLE.ravel()) / np.exp(TABLE).sum()
    likely = weights > 0.01
    assert likely.sum() > 15 and far_from(chains, points[likely], weights[likely]) < FAR
    assert not (np.asarray(chains.positions) == points[5]).all(axis=-1).any()
    np.testing.assert_allclose(chains.log_density[0, -1], log_density(chains.positions[0, -1]), rtol=1e-6)


def test_whole_numbers_and_named_parts():
    def coupled(at):
        return at["level"] * (0.3 * at["spins"][0] + 0.2 * at["spins"][1]) - 0.5 * at["level"] ** 2

    kernel = mcmc.within_gibbs({"level": mcmc.RandomWalkMetropolis(2.0), "spins": mcmc.DiscreteGibbs((-1, 1))})
    start = {"level": 0.0, "spins": jnp.ones(2, jnp.int32)}
    chains = mo.sample(1, kernel, coupled, start, draws=2_000, burn_in=100)
    # the level summed over: exp(s^2 / 2) with s = .5 or .1
    exact = np.exp([0.125, 0.005])
    alike = 1.0 * (np.asarray(chains.positions["spins"]).prod(axis=-1) > 0)
    assert chains.positions["spins"].dtype == jnp.int32
    assert abs(alike.mean() - exact[0] / exact.sum()) < FAR * mcmc.standard_error(alike)


def test_what_cannot_be_a_value_is_refused():
    for values in ((1.0,), (1.0, 1.0), (0.0, np.nan), ((0, 1), (1, 0))):
        with pytest.raises(mo.MotesError, match="DiscreteGibbs values: expected two or more different numbers"):
            mcmc.DiscreteGibbs(values)
    for start in (jnp.zeros(3), jnp.array([2, 2, -1])):
        with pytest.raises(mo.MotesError, match="DiscreteGibbs position: expected coordinates that are one of"):
            mo.sample(0, mcmc.DiscreteGibbs(VALUES), log_density, start)


def locked(x):
    """Six coordinates that are all alike but once in 1e5, more often 1 than -1."""
    return 8.0 * jnp.sum(x[1:] * x[:-1]) + 0.1 * jnp.sum(x)


def test_replicas_cross_where_one_chain_sticks():
    """The share of 1, 0.77, by a kernel that alone never leaves the side on which it starts."""
    points = np.array(list(product((-1.0, 1.0), repeat=6)))
    weights = np.exp(8.0 * (points[:, 1:] * points[:, :-1]).sum(axis=1) + 0.1 * points.sum(axis=1))
    share = weights[points[:, 0] > 0].sum() / weights.sum()
    kernel = mcmc.DiscreteGibbs((-1, 1))
    tempered = mcmc.ParallelTempering(kernel, (1.0, 0.4, 0.16, 0.06, 0.02))
    alone, replicas = (mo.sample(2, each, locked, -jnp.ones(6), draws=3_000, burn_in=300) for each in (kernel, tempered))
    assert (np.asarray(alone.positions) < 0).all()
    up = 1.0 * (np.asarray(replicas.positions)[..., 0] > 0)
    assert abs(up.mean() - share) < FAR * mcmc.standard_error(up) < 0.25
    assert list(replicas.acceptance) == ["DiscreteGibbs", "exchange 1 and 0.4", "exchange 0.4 and 0.16", "exchange 0.16 and 0.06",
                                         "exchange 0.06 and 0.02"]  # fmt: skip
    assert min(list(replicas.acceptance.values())[1:]) > 0.25
    assert np.allclose(replicas.log_density[:, -1], [locked(x) for x in replicas.positions[:, -1]], atol=1e-4)


@pytest.mark.night
def test_replicas_go_on_where_they_were(tmp_path):
    kernel = mcmc.ParallelTempering(mcmc.RandomWalkMetropolis(1.0), (1.0, 0.5, 0.1))
    whole = mo.sample(3, kernel, lambda x: -0.5 * x @ x, jnp.zeros(2), draws=60, chains=2, burn_in=0)
    first = mo.sample(3, kernel, lambda x: -0.5 * x @ x, jnp.zeros(2), draws=20, chains=2, burn_in=0)
    first.save(tmp_path / "chains.npz")
    back = mo.Chains.load(tmp_path / "chains.npz", kernel, lambda x: -0.5 * x @ x)
    second = mo.sample(3, kernel, lambda x: -0.5 * x @ x, back, draws=40)
    assert np.array_equal(mcmc.joined([back, second]).positions, whole.positions)


def test_replicas_belong_to_one_density():
    kernel = mcmc.ParallelTempering(mcmc.RandomWalkMetropolis(1.0), (1.0, 0.5))
    inside = (lambda k: mcmc.Block(0, k), lambda k: mcmc.ParallelTempering(k, (1.0, 0.1)),
              lambda k: mcmc.Block(0, mcmc.Repeat(mcmc.Mix([k, mcmc.RandomWalkMetropolis(1.0)]), 2)))  # fmt: skip
    for wrapped in inside:
        with pytest.raises(mo.MotesError, match="kernel: expected a kernel whose density may change"):
            wrapped(kernel)
    for exponents in ((1.0,), (0.9, 0.5), (1.0, 0.5, 0.5), (1.0, 0.0)):
        with pytest.raises(mo.MotesError, match="ParallelTempering exponents: expected two or more numbers that fall from 1 towards 0"):
            mcmc.ParallelTempering(mcmc.RandomWalkMetropolis(1.0), exponents)
