"""Finds every filter and smoother of the library (and the skeleton of CONTRIBUTING) and makes one of each to test."""

import dataclasses
import importlib
import importlib.util
import inspect
import pkgutil
import typing
from pathlib import Path

import jax
import jax.numpy as jnp

import motes.filters
import motes.smoothers
from motes.filters.interface import Filter
from motes.filters.particle import ParticleFilter
from motes.gaussian.sigma_points import Cubature
from motes.smoothers.interface import Smoother

MAPS = "LandmarkFilter"
"""Asks for a model with landmarks: `test_map_contract.py` asks it the same rules."""
SKELETON = Path(__file__).parents[2] / "docs" / "skeleton_filter.py"

PARAMETERS = {"n": 300, "mixands": 8, "lower": (-14.0, -12.0), "upper": (14.0, 12.0), "nodes": (33, 31),
         "function": lambda before, after, u, t: after, "size": 2, "rule": Cubature(), "filter": ParticleFilter(n=304),
         "fresh": lambda key, y, u, t: 1.5 * jax.random.normal(key, (2,)), "memory": jnp.zeros((), jnp.int32),
         "learn": lambda key, memory, law, y, u, t: memory + 1, "sizes": (100, 300), "widths": (0.5, 0.5)}  # fmt: skip
"""Values for parameters that have no default; a new filter whose parameter is not listed here says so by failing."""


def _modules():
    for room in (motes.filters, motes.smoothers):
        for module in pkgutil.iter_modules(room.__path__):
            yield importlib.import_module(f"{room.__name__}.{module.name}")
    spec = importlib.util.spec_from_file_location("skeleton_filter", SKELETON)
    skeleton = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(skeleton)
    yield skeleton


def _classes(kind):
    found = {}
    for module in _modules():
        for value in vars(module).values():
            own = inspect.isclass(value) and issubclass(value, kind) and value.__module__ == module.__name__
            if own and not inspect.isabstract(value):
                found[value.__name__] = value
    return found


def filter_classes():
    """Every concrete filter class that takes a model without landmarks, by name."""
    return {name: cls for name, cls in _classes(Filter).items() if name != MAPS}


def smoother_classes():
    """Every concrete smoother class, by name."""
    return _classes(Smoother)


def example(cls, **changes):
    """One filter or smoother of a class, with the required parameters filled in."""
    needed = [f.name for f in dataclasses.fields(cls) if f.default is dataclasses.MISSING and f.default_factory is dataclasses.MISSING]
    parameters = {name: PARAMETERS[name] for name in needed}
    return cls(**{**parameters, **changes})


def kind_of(filter):
    """The kind of law that a filter says it keeps, and whether it looks ahead: what the loop sees of it."""
    return typing.get_type_hints(type(filter).init)["return"], filter.look_ahead


def first_of_kinds(filters, kind=kind_of):
    """Names of filters, one of each kind."""
    found = {}
    for name, filter in filters.items():
        found.setdefault(kind(filter), name)
    return set(found.values())


SHARED = {"EnsembleKalmanFilter", "GaussianFilter", "GaussianParticleFilter", "GaussianSumParticleFilter", "CostReferenceParticleFilter",
          "InteractingMultipleModel", "JumpMarkovFilter", "AuxiliaryParticleFilter", "PaRIS", "Adapting", "AdaptiveSize",
          "Distributed"}  # fmt: skip


def is_variant(name):
    """Whether an example is a second one of its class."""
    return ", " in name


def shares_stages(name):
    """Whether all stages of an example are made of what others have, too: some questions it is asked by night alone."""
    return is_variant(name) or name in SHARED


def examples():
    """Filters to test: one of each class, and the variants that take other paths through a class."""
    import motes as mo

    found = {name: example(cls) for name, cls in filter_classes().items()}
    found["PaRIS"] = example(mo.smoothers.PaRIS, n=100)  # whose cost is that of n^2
    proposal = mo.AdditiveGaussian(lambda x, uy, t: 0.8 * x, [[1.5, 0.2], [0.2, 1.0]])
    found["ParticleFilter, proposal"] = mo.ParticleFilter(n=300, proposal=proposal)
    found["ParticleFilter, extended Kalman"] = mo.ParticleFilter(n=300, proposal=mo.ExtendedKalmanProposal())
    found["ParticleFilter, SIR stratified"] = mo.ParticleFilter(n=300, scheme=mo.resampling.Stratified(), policy=mo.resampling.Always())
    found["ParticleFilter, SIS"] = mo.ParticleFilter(n=300, policy=mo.resampling.Never())
    found["MarginalizedParticleFilter, one state"] = mo.MarginalizedParticleFilter(n=300, linear=("b",))
    found["RegularizedParticleFilter, metropolis"] = mo.RegularizedParticleFilter(n=300, form="metropolis")
    # on a linear model no state is nonlinear unless declared
    found["KalmanParticleKernelFilter"] = mo.KalmanParticleKernelFilter(n=300, nonlinear=("a", "b"), every=2)
    found["KalmanParticleKernelFilter, common kernel"] = mo.KalmanParticleKernelFilter(
        n=300,
        nonlinear=("b",),
        width=0.5,
        every=3,
        kernels=mo.resampling.CommonKernel(guard=0.01),
        slope="jacobian",
        policy=mo.resampling.Always(),
    )
    # one mode leaves nothing to chance unless a state is drawn
    found["JumpMarkovFilter"] = mo.JumpMarkovFilter(n=300, sampled=("b",))
    found["GaussianParticleFilter, moved draws"] = mo.GaussianParticleFilter(n=300, redraw=False)
    found["GaussianSumParticleFilter, II"] = mo.GaussianSumParticleFilter(n=100, mixands=8, form="II")
    found["CostReferenceParticleFilter, local"] = mo.CostReferenceParticleFilter(
        n=300, q=1, phi=mo.resampling.InverseCost(), forgetting=0.5, scale=(0.7, 0.5), adaptive=True, selection="local"
    )
    found["EnsembleKalmanFilter, stochastic"] = mo.EnsembleKalmanFilter(n=300, form="stochastic", inflation=1.02)
    found["MarginalizedParticleFilter, none"] = mo.MarginalizedParticleFilter(n=300, linear=())
    return found
