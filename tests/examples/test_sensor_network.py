"""A network of nodes that see bearings: sums without error are those of one place, and small runs against what was simulated."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import motes as mo
from examples_of import loaded


@pytest.fixture(scope="module")
def run():
    return loaded("sensor_network")


@pytest.fixture(scope="module")
def network(run):
    return run["Network"]()


def test_averages_keep_the_sum_and_agree(run, network):
    assert np.allclose(network.averaging.sum(axis=0), 1) and np.allclose(network.averaging, network.averaging.T)
    found = jnp.asarray(np.random.default_rng(0).normal(size=(12, 4)), jnp.float32)
    exact = run["summed"](found)
    assert jnp.abs(run["agreed"](network, 200)(found) - exact).max() < 1e-3
    assert jnp.abs(run["agreed"](network, 3)(found).sum(axis=0) - exact.sum(axis=0)).max() < 1e-2


def test_bytes_of_the_tree(network):
    parents, hops = network.tree
    assert (hops[parents] == np.maximum(hops - 1, 0)).all() and network.bytes_of_summaries() == 1232
    seen = np.zeros((3, 12), bool)
    seen[:, np.argmax(hops)] = True
    assert network.bytes_of_bearings(seen) == (5 * hops.max(), 55)


def test_summed_increments_hold_a_target(run, network):
    xs, ys = run["worlds"](network, 0, 2, 20)
    means = run["over_runs"](run["ways"](network, 10, 500)["summed increments"], ys)
    assert np.abs(means - means[:, :, :1]).max() < 1.0, "nodes that know the same say the same, but for rounding"
    assert np.sqrt(np.mean(np.sum((means[:, 5:, 0, :2] - np.asarray(xs)[:, 5:, :2]) ** 2, axis=-1))) < 12


@pytest.mark.night
def test_figures_of_the_page(run, network, tmp_path):
    """Figures of the README's table, with room for other compilers."""
    table, found, truth, seen = run["compared"](network, 100, 10, 10_000)
    central, summed, consensus, alone = (row[1] for row in table.rows)
    assert central < 6.5 and summed < 6.5 and consensus < 6.5 and alone > 100 and 6 < seen.sum(axis=-1).mean() < 7.5
    run["picture"](network, table, found, truth).savefig(tmp_path / "network.png")


def test_increments_of_one_linear_sensor_are_its_information(run):
    """What a Kalman filter's measurement adds, H' R^-1 H and H' R^-1 y, whatever the law before."""
    ways = run["together"].__globals__
    H, R = jnp.array([[1.0, 0.5, 0.0, 0.0]]), 4.0 * jnp.eye(1)
    start = mo.Gaussian(jnp.array([1.0, 2.0, 0.0, 0.0]), jnp.diag(jnp.array([9.0, 4.0, 1.0, 1.0])))
    model = mo.StateSpaceModel(start, mo.LinearGaussian(jnp.eye(4), jnp.eye(4)), mo.LinearGaussian(H, R))
    added = jax.jit(lambda law, y: ways["increment"](jax.random.key(0), mo.KalmanFilter(), model, law, y, None, 0))
    vector, matrix = added(start, jnp.array([3.0]))
    assert jnp.abs(matrix - H.T @ H / 4).max() < 1e-4 and jnp.abs(vector - H[0] * 3 / 4).max() < 1e-4
