"""Every kernel leaves the posterior as it is: Geweke's joint-distribution test, in parallel."""

from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from kernels import ELSEWHERE, classes, examples

import motes as mo
from motes.core import random
from tiers import each

mcmc = mo.mcmc
WORLDS, ROUNDS = 6_000, 8
FAR = 4.9
"""Standard errors: 1e-6 two-sided."""


def prior(key, n):
    """Asymmetric, with two modes: 0.7 N((-1, 0.5), .) + 0.3 N((1.5, -0.5), .)."""
    return TWO_MODES.sample(key, n)


TWO_MODES = mo.Mixture.of(jnp.array([0.7, 0.3]), jnp.array([[-1.0, 1.5], [0.5, -0.5]]),
                          jnp.stack([jnp.array([[0.5, 0.2], [0.2, 0.3]]), jnp.array([[0.3, -0.1], [-0.1, 0.4]])], axis=-1))  # fmt: skip


def measured(key, x):
    """One measurement of each of x (2, n): x0 + x1^2 + skewed noise."""
    return x[0] + 0.5 * x[1] ** 2 + 0.8 * random.normal(key, x.shape[1:], x.dtype)


def log_likelihood(x, y):
    return -0.5 * ((y - x[0] - 0.5 * x[1] ** 2) / 0.8) ** 2


def functions(x, y):
    """Ten functions of parameters and measurement whose means are compared, (10, n)."""
    a, b = x
    return np.stack([a, b, a**2, b**2, a * b, y, a * y, np.abs(a), (a > 0) * 1.0, np.tanh(y) * b])


def furthest(x, y):
    """Largest difference to draws made directly, in standard errors."""
    fresh = prior(random.as_key(901), 4 * WORLDS)
    direct = functions(np.asarray(fresh), np.asarray(measured(random.as_key(902), fresh)))
    reached = functions(np.asarray(x), np.asarray(y))
    error = np.sqrt(direct.var(axis=1) / direct.shape[1] + reached.var(axis=1) / reached.shape[1])
    return np.abs((direct.mean(axis=1) - reached.mean(axis=1)) / error).max()


def joint(kernel, seed=0):
    """Draw parameters and measurements, then alternate: a step of the kernel given the measurement, a new measurement given the rest."""

    def world(key, x, y):
        def density(y):
            return lambda x: TWO_MODES.log_prob(x) + log_likelihood(x, y)

        def again(held, t):
            x, y, kernel_state = held
            step = random.step_key(key, t)
            state = mcmc.State(x, density(y)(x), kernel_state)
            # long after all learning
            state, _ = kernel.step(random.child(step, random.FILTER), density(y), state, t + 10_000)
            y = measured(random.child(step, random.WORLD), state.position[:, None])[0]
            return (state.position, y, state.kernel_state), None

        kernel_state = kernel.init_kernel_state(density(y), x)
        return jax.lax.scan(again, (x, y, kernel_state), jnp.arange(ROUNDS))[0][:2]

    key = random.as_key(seed)
    x = prior(random.child(key, 0), WORLDS)
    y = measured(random.child(key, 1), x)
    keys = jax.vmap(lambda k: random.step_key(key, k))(jnp.arange(WORLDS))
    x, y = jax.jit(jax.vmap(world))(keys, x.T, y)
    return x.T, y


BY_NIGHT = {"RandomWalkMetropolis, factor", "MetropolisHastings", "MultipleTry, plain", "MALA", "NUTS", "Block", "Mix", "Repeat"}
"""Kernels that others contain, or that are moved by the same steps."""


@pytest.mark.parametrize("name", each(list(examples()), BY_NIGHT))
def test_joint_distribution(name):
    assert furthest(*joint(examples()[name])) < FAR


def test_every_kernel_has_an_example():
    assert {name.split(",")[0] for name in examples()} | set(ELSEWHERE) == set(classes())
    for file in ELSEWHERE.values():
        assert (Path(__file__).parent / file).exists()


class WithoutBackward(mcmc.MetropolisHastings):
    """Forgets the density of the way back."""

    def proposed(self, key, x, t):
        new, _ = super().proposed(key, x, t)
        return new, 0.0


def test_a_wrong_kernel_is_seen():
    assert furthest(*joint(WithoutBackward(mo.AdditiveGaussian(lambda x, u, t: 0.7 * x + 0.3, jnp.eye(2))))) > 2 * FAR


@pytest.mark.night
def test_multiple_try_of_one_is_metropolis_hastings():
    proposal = examples()["MetropolisHastings"].proposal
    one, other = (mo.sample(3, kernel, TWO_MODES.log_prob, jnp.zeros(2), draws=200, chains=3, burn_in=0)
                  for kernel in (mcmc.MetropolisHastings(proposal), mcmc.MultipleTry(proposal, 1)))  # fmt: skip
    np.testing.assert_allclose(one.positions, other.positions, rtol=2e-5, atol=2e-5)
    assert len(np.unique(np.asarray(one.positions))) > 100


def test_multiple_try_without_x_among_the_reference_points_is_seen(monkeypatch):
    from motes.mcmc import multiple_try

    whole = jnp.concatenate

    def without_x(parts, axis=0):
        # the classic error: k fresh reference points
        return whole([parts[0], parts[0][:, :1]], axis=1)

    monkeypatch.setattr(multiple_try.jnp, "concatenate", without_x)
    monkeypatch.setattr(multiple_try.jnp, "append", lambda known, one: whole([known, known[:1]]))
    try:
        found = furthest(*joint(mcmc.MultipleTry(examples()["MultipleTry"].proposal, 2)))
    finally:
        monkeypatch.undo()
    assert found > 2 * FAR
