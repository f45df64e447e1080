"""The models of the examples, against exact answers and without data."""

import runpy
from itertools import combinations

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.special import gammaln

import motes as mo
from examples_of import EXAMPLES, importable


@pytest.fixture(scope="module")
def coal():
    with importable("coal") as folder:
        return {**runpy.run_path(str(folder / "exact.py")), **runpy.run_path(str(folder / "model.py"))}


def test_dynamic_program_equals_enumeration(coal):
    counts, most = np.array([3, 4, 2, 0, 1, 0, 0, 5]), 3
    log_prior = coal["log_prior"](most)
    number, first = np.zeros(most + 1), np.zeros(7)
    for k in range(most + 1):
        every = list(combinations(range(7), k))
        for places in every:
            log_p = log_prior[k] - np.log(len(every))
            for piece in np.split(counts, np.array(places, int) + 1):
                log_p += gammaln(piece.sum() + 1) - (piece.sum() + 1) * np.log(len(piece) + 1) - gammaln(piece + 1.0).sum()
            number[k] += np.exp(log_p)
            if k:
                first[places[0]] += np.exp(log_p)
    found, found_first = coal["exact"](counts, log_prior)
    np.testing.assert_allclose(found, number / number.sum(), rtol=1e-10)
    np.testing.assert_allclose(found_first, first / number.sum(), rtol=1e-10)


@pytest.mark.night
@pytest.mark.parametrize("recorded", [False, pytest.param(True, marks=[pytest.mark.optimized, pytest.mark.night])])
def test_changes_of_yearly_counts_equal_the_exact_ones(coal, recorded):
    if recorded:
        counts = mo.data.coal().values[:, 0]
    else:
        counts = np.random.default_rng(2).poisson([4.0] * 14 + [1.0] * 16 + [2.5] * 10)
    log_density, kernel, start = coal["problem"](counts)
    chains = mo.sample(1, mo.mcmc.Repeat(kernel, 4), log_density, start, draws=800, chains=12, burn_in=400)
    number, first = coal["exact"](counts, coal["log_prior"]())
    model = np.asarray(chains.positions.model)
    for k in np.flatnonzero(number > 0.01):
        share = 1.0 * (model.sum(axis=-1) == k)
        assert abs(share.mean() - number[k]) < 4.9 * mo.mcmc.standard_error(share), k
    place = model.argmax(axis=-1)
    for early in np.quantile(np.repeat(np.arange(first.size), np.round(1e4 * first).astype(int)), [0.25, 0.5, 0.75]):
        share = 1.0 * (model.any(axis=-1) & (place <= early))
        assert abs(share.mean() - first[: int(early) + 1].sum()) < 4.9 * mo.mcmc.standard_error(share)


@pytest.mark.night
def test_a_mixture_without_data_has_uniformly_many_components():
    galaxies = runpy.run_path(str(EXAMPLES / "galaxies" / "run.py"))
    log_density, kernel, start = galaxies["problem"](np.zeros(0))
    chains = mo.sample(0, mo.mcmc.Repeat(kernel, 20), log_density, start, draws=300, chains=16, burn_in=100)
    for k in range(1, 11):
        share = 1.0 * (np.asarray(chains.positions.model) == k)
        assert abs(share.mean() - 0.1) < 4.9 * mo.mcmc.standard_error(share) + 1e-3


@pytest.mark.night
def test_sinusoids_are_counted():
    sinusoids = runpy.run_path(str(EXAMPLES / "sinusoids" / "run.py"))
    log_density, kernel, start = sinusoids["problem"](sinusoids["signal"]())
    chains = mo.sample(0, mo.mcmc.Repeat(kernel, 5), log_density, start, draws=500, chains=8, burn_in=500)
    counts = np.asarray(chains.positions.model)
    assert np.bincount(counts.ravel()).argmax() == 3
    found = np.sort(np.asarray(chains.positions.x)[counts == 3][:, :3], axis=1).mean(axis=0)
    np.testing.assert_allclose(found, [w for w, _, _ in sinusoids["WAVES"]], atol=0.03)
    # the evidence of one sinusoid by brute force over its frequency, beside the share of one to none
    assert np.isfinite(float(log_density(mo.mcmc.Configuration(jnp.int32(1), jnp.zeros(6).at[0].set(1.0)))))


@pytest.mark.night
def test_volatility_by_grid_and_by_particles_is_the_same_density():
    pound = runpy.run_path(str(EXAMPLES / "pound" / "run.py"))
    h = np.cumsum(np.random.default_rng(0).normal(size=80) * 0.2)
    ys = (np.exp(h / 2) * np.random.default_rng(1).normal(size=80))[:, None]
    ways = pound["ways"](ys, 2_000, 200)
    for theta in (pound["START"], jnp.array([0.2, 1.5, -1.0])):
        exact = float(ways["grid"][1](theta))
        assert abs(float(ways["PMMH"][1](theta)) - exact) < 0.5
