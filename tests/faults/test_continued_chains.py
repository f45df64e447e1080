"""Chains go on with the density that they had, and with no other; what a kernel does to the form of a state is told in words."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import motes as mo
from motes import mcmc
from motes.mcmc import continuing


def normal(x):
    return -0.5 * jnp.sum(x**2)


def shifted(x):
    return normal(x) - 500.0


def narrower(x):
    return 2.0 * normal(x) + 3.0


def wrong_at_some(x):
    return jnp.where(x[0] > -9.0, jnp.nan, normal(x))


KERNELS = {
    "RandomWalkMetropolis": mcmc.RandomWalkMetropolis(1.5),
    "Adaptive": mcmc.Adaptive(mcmc.RandomWalkMetropolis(1.5), steps=50),
    "Cycle": mcmc.Cycle([mcmc.RandomWalkMetropolis(1.5), mcmc.RandomWalkMetropolis(0.5)]),
}


def drawn(kernel, density, init, seed=0, draws=60):
    return mo.sample(seed, kernel, density, init, draws=draws, chains=2, burn_in=60)


@pytest.mark.filterwarnings("ignore::motes.MotesWarning")
@pytest.mark.parametrize("name", KERNELS)
def test_another_density_is_refused(name, tmp_path):
    kernel = KERNELS[name]
    first = drawn(kernel, normal, jnp.zeros(1))
    loaded = mo.Chains.load(first.save(tmp_path / "chains.npz"), kernel, normal, jnp.zeros(1))
    for chains in (first, loaded):
        for density in (shifted, narrower, wrong_at_some):
            with pytest.raises(mo.MotesError, match="sample log_density: expected that of the chains, which ended at .* in chain"):
                drawn(kernel, density, chains)
        again = drawn(kernel, lambda x: normal(x), chains)
        assert 0.2 < np.mean(list(again.acceptance.values())) < 0.95
        np.testing.assert_array_equal(again.positions, drawn(kernel, normal, first).positions)


@pytest.mark.filterwarnings("ignore::motes.MotesWarning")
def test_trusting_what_was_stored_is_found(monkeypatch):
    """The twin: values that are not looked at again hold the chains still."""
    first = drawn(KERNELS["RandomWalkMetropolis"], normal, jnp.zeros(1))
    monkeypatch.setattr(continuing, "check_same", lambda *args: None)
    assert drawn(KERNELS["RandomWalkMetropolis"], shifted, first).acceptance["RandomWalkMetropolis"] < 0.01


def posterior(ys):
    def model(theta):
        sensor = mo.AdditiveGaussian(lambda x, u, t: x + theta, [[1.0]])
        return mo.StateSpaceModel(mo.Gaussian([0.0], [[1.0]]), mo.LinearGaussian([[0.9]], [[1.0]]), sensor)

    return mo.parameters.Posterior(mo.Gaussian([0.0], [[1.0]]), model, mo.ParticleFilter(20), ys)


@pytest.mark.night
@pytest.mark.filterwarnings("ignore::motes.MotesWarning")
def test_estimates_may_differ_by_their_noise():
    few, many = np.zeros((8, 1)), np.full((40, 1), 3.0)
    kernel = mcmc.PseudoMarginal(mcmc.RandomWalkMetropolis(0.5))
    first = mo.sample(0, kernel, posterior(few), jnp.zeros(1), draws=20, chains=2, burn_in=0)
    again = mo.sample(0, kernel, posterior(few), first, draws=20, chains=2)
    assert again.positions.shape == (2, 20, 1)
    with pytest.raises(mo.MotesError, match="sample log_density: expected that of the chains"):
        mo.sample(0, kernel, posterior(many), first, draws=20, chains=2)


def test_leaps_come_first():
    assert mcmc.HMC(8).num_steps == 8 and mcmc.HMC(8) == mcmc.HMC(num_steps=8) and float(mcmc.HMC(8).step_size) == 0.1
    with pytest.raises(mo.MotesError, match="HMC num_steps: expected a whole number of at least 1, got 0.3"):
        mcmc.HMC(0.3)


def test_types_that_change_are_told():
    """Positions of one type, points of an orbit of another."""
    told = r"GeneralizedSampler step: position: expected int32\[\], as at the start, got float32\[\]\. Give results"
    with pytest.raises(mo.MotesError, match=told):
        sampler = mcmc.GeneralizedSampler(
            phi=lambda x: jnp.array([True]),
            q=lambda i, x: jnp.zeros(1),
            psi=lambda m, x: mcmc.Orbit(jnp.zeros(2, int), jnp.array([0.0, 1.0]), jnp.zeros(2), jnp.int32(x)),
        )
        mo.sample(0, sampler, lambda x: 0.0 * x, jnp.int32(0), draws=10, chains=2, burn_in=0)

    with pytest.raises(mo.MotesError, match="sample kernel: expected a kernel that JAX knows as a tree, got Unknown"):
        mo.sample(0, type("Unknown", (mcmc.Kernel,), {"step": None})(), normal, jnp.zeros(1), draws=10)

    @jax.tree_util.register_static
    class Widening(mcmc.Kernel):
        def step(self, key, log_density, state, t):
            return mcmc.State(jnp.stack([state.position] * 2), state.log_density), mcmc.Info.of_one(1.0)

    with pytest.raises(mo.MotesError, match=r"Widening step: position: expected float32\[1\], as at the start, got float32\[2, 1\]"):
        mo.sample(0, Widening(), normal, jnp.zeros(1), draws=10, chains=2, burn_in=0)
