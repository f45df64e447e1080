"""One example of every kernel in motes.mcmc, each for a position of two numbers, and how to find kernels without one."""

import importlib
import inspect
import pkgutil

import jax.numpy as jnp

import motes as mo
import motes.mcmc
from motes.mcmc.interface import Kernel

mcmc = mo.mcmc


def classes():
    """Every concrete kernel class of the package, by name."""
    found = {}
    for module in pkgutil.iter_modules(motes.mcmc.__path__):
        for value in vars(importlib.import_module(f"motes.mcmc.{module.name}")).values():
            kernel = inspect.isclass(value) and issubclass(value, Kernel) and not inspect.isabstract(value)
            if kernel and value.__module__.endswith(module.name):
                found[value.__name__] = value
    return found


def examples():
    """Kernels for a vector of two numbers; those of other positions are tested in files of their own."""
    lopsided = mo.AdditiveGaussian(lambda x, u, t: 0.7 * x + 0.3, jnp.array([[0.8, 0.2], [0.2, 0.5]]))
    by_range = mo.AdditiveGaussian(lambda x, u, t: x, lambda x, u, t: jnp.eye(2) * (0.2 + 0.3 * x[0] ** 2))
    walk = mcmc.RandomWalkMetropolis(0.7)
    return {
        "RandomWalkMetropolis": walk,
        "RandomWalkMetropolis, factor": mcmc.RandomWalkMetropolis(jnp.array([[0.5, 0.0], [0.4, 0.9]])),
        "IndependenceMetropolis": mcmc.IndependenceMetropolis(mo.StudentT(jnp.array([1.5, 1.0]), 4.0)),
        "MetropolisHastings": mcmc.MetropolisHastings(by_range),
        "MultipleTry": mcmc.MultipleTry(by_range, 4),
        "MultipleTry, plain": mcmc.MultipleTry(lopsided, 3, weight="plain"),
        "MALA": mcmc.MALA(0.6),
        "HMC": mcmc.HMC(4, 0.3),
        "NUTS": mcmc.NUTS(0.5, max_tree_depth=3),
        "Adaptive": mcmc.Adaptive(walk, steps=1),
        "Cycle": mcmc.Cycle([mcmc.Block(0, mcmc.RandomWalkMetropolis(1.2)), mcmc.Block((1,), mcmc.RandomWalkMetropolis(0.4))]),
        "Block": mcmc.Block(1, mcmc.RandomWalkMetropolis(0.8)),
        "Mix": mcmc.Mix([walk, mcmc.MetropolisHastings(lopsided)], [1, 3]),
        "Repeat": mcmc.Repeat(walk, 3),
        "Reparametrized": mcmc.Reparametrized(walk, lambda x: jnp.array([jnp.sinh(x[0]), x[1] * jnp.exp(x[0])]),
                                              lambda z: jnp.array([jnp.arcsinh(z[0]), z[1] * jnp.exp(-jnp.arcsinh(z[0]))])),
    }


ELSEWHERE = {"Gibbs": "test_gibbs.py", "DiscreteGibbs": "test_discrete_gibbs.py", "ParallelTempering": "test_discrete_gibbs.py",
             "ReversibleJump": "test_reversible_jump.py", "GeneralizedSampler": "test_generalized.py",
             "PseudoMarginal": "../parameters/test_parameters.py"}  # fmt: skip
