"""Seeds of any size give streams of their own; noise laws of another size than their function are refused; laws of two functions work."""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import motes as mo
from contract.discovery import examples
from motes.core import random
from motes.laws import conditional, law
from tiers import each

SEEDS = (0, 1, 5, 2**31, 2**31 + 5, 2**32 - 1, 2**32, 2**32 + 1, 2**63 - 1, 2**64 - 1, 2**64, 2**64 + 1, 2**65, 3**200, -1, -5,
         -(2**32), -(2**64), np.random.SeedSequence(7).entropy, np.random.SeedSequence().entropy)  # fmt: skip


def streams():
    return {tuple(np.asarray(random.normal(random.as_key(seed), (8,), jnp.float32)).tolist()) for seed in SEEDS}


def test_every_seed_has_its_own_stream(monkeypatch):
    assert len(streams()) == len(set(SEEDS))
    for seed in SEEDS:
        assert np.array_equal(jax.random.key_data(random.as_key(seed)), random.key_or_data(seed))
    for seed in (0, 1, 2**31 - 1, np.int32(7), np.uint64(7)):
        assert random.as_key(seed) == jax.random.key(int(seed), impl="threefry2x32")
    # the twin: the lower 32 bits alone
    monkeypatch.setattr(random, "_seed_words", lambda seed: np.array([0, seed & 0xFFFFFFFF], np.uint32))
    assert len(streams()) < len(set(SEEDS))


def test_seeds_are_alike_in_both_precisions():
    with jax.enable_x64(True):
        wide = [np.asarray(jax.random.key_data(random.as_key(seed))) for seed in SEEDS]
    np.testing.assert_array_equal(wide, [jax.random.key_data(random.as_key(seed)) for seed in SEEDS])


def model(noise=None, sensor_noise=None, initial=None):
    eye = np.eye(2)
    return mo.StateSpaceModel(
        mo.Gaussian([0.0, 0.0], eye) if initial is None else initial,
        mo.LinearGaussian(0.9 * eye, 0.3 * eye) if noise is None else mo.AdditiveNoise(lambda x, u, t: 0.9 * x, noise),
        mo.LinearGaussian(eye, eye) if sensor_noise is None else mo.AdditiveNoise(lambda x, u, t: x, sensor_noise),
        ("a", "b"),
    )


LAWS = {
    "StudentT": lambda size: mo.StudentT(np.ones(size), 5.0),
    "Laplace": lambda size: mo.Laplace(np.ones(size)),
    "Uniform": lambda size: mo.Uniform(-np.ones(size), np.ones(size)),
    "Gaussian": lambda size: mo.Gaussian(np.zeros(size), np.eye(size)),
    "Mixture": lambda size: mo.Mixture.of([0.5, 0.5], np.zeros((size, 2)), np.stack([np.eye(size)] * 2, -1)),
}


@pytest.mark.parametrize("name", each(list(LAWS), {"Mixture", "Gaussian"}))
def test_noises_of_another_size_are_refused(name):
    filters = examples() if name == "Laplace" else {"": mo.KalmanParticleKernelFilter(20, nonlinear=("a", "b"))}
    for size in (1, 3):
        noise = LAWS[name](size)
        refused = rf"law: expected a law of 2 components, as its function returns, got {name} of {size}\. Give one"
        for wrong in (model(noise), model(None, noise)):
            for filter in filters.values():
                with pytest.raises(mo.MotesError, match=refused):
                    mo.run(0, filter, wrong, np.zeros((3, 2)))
            with pytest.raises(mo.MotesError, match=refused):
                mo.simulate(0, wrong, 3)
        part = mo.AdditiveNoise(lambda x, u, t: x, noise)
        X, y = jnp.zeros((2, 5)), jnp.ones(2)
        for call, args in ((part.log_prob, (y, X, None, 0)), (part.sample, (random.as_key(0), X, None, 0)), (part.given, (y, None, 0))):
            with pytest.raises(mo.MotesError, match=refused):
                call(*args)
    part = mo.AdditiveNoise(lambda x, u, t: x, LAWS[name](2))
    assert part.log_prob(jnp.ones(2), jnp.zeros((2, 5)), None, 0).shape == (5,)
    with pytest.raises(mo.MotesError, match="value given to AdditiveNoise: expected 2 components, as it predicts, got 1"):
        part.log_prob(jnp.ones(1), jnp.zeros((2, 5)), None, 0)


def test_unchecked_sizes_are_found(monkeypatch):
    """The twin: without the check one number serves for both components."""
    monkeypatch.setattr(conditional, "check_size", lambda *args: None)
    part = mo.AdditiveNoise(lambda x, u, t: x, mo.Laplace([1.0]))
    drawn = np.asarray(part.sample(random.as_key(0), jnp.zeros((2, 5)), None, 0))
    assert np.array_equal(drawn[0], drawn[1])


def test_one_number_of_freedom():
    with pytest.raises(mo.MotesError, match="StudentT df: expected shape"):
        mo.StudentT([1.0, 1.0], [3.0, 30.0])


@dataclass
class Heavy:
    """A number with outliers: nothing but the two functions, and no hash."""

    share: float = 0.1

    def sample(self, key, shape):
        wide = jax.random.uniform(jax.random.fold_in(key, 1), shape) < self.share
        return jax.random.normal(key, shape) * jnp.where(wide, 10.0, 1.0)

    def log_prob(self, x):
        return jnp.logaddexp(jnp.log1p(-self.share) - x**2 / 2, jnp.log(self.share / 10) - x**2 / 200)


class Joint:
    """Two components whose density is joint."""

    def sample(self, key, shape):
        return jax.random.normal(key, (*shape, 2)) @ jnp.array([[1.0, 0.5], [0.0, 1.0]])

    def log_prob(self, x):
        return -0.5 * (x[..., 0] ** 2 + (x[..., 1] - 0.5 * x[..., 0]) ** 2)


def test_laws_of_two_functions_are_understood():
    heavy, joint = law.as_law("law", Heavy()), law.as_law("law", Joint())
    assert (heavy.size, heavy.independent, joint.size, joint.independent) == (1, True, 2, False)
    assert heavy.sample(random.as_key(0), 5).shape == (1, 5) and joint.sample(random.as_key(0), 5).shape == (2, 5)
    assert heavy.log_prob(jnp.ones((1, 5))).shape == joint.log_prob(jnp.ones((2, 5))).shape == (5,)
    assert float(heavy.log_prob(jnp.full((1,), jnp.nan))) == 0
    for of in (heavy.mean, joint.cov):
        with pytest.raises(mo.MotesError, match="law (Heavy|Joint): expected one with a (mean|variance) .*moments are needed here"):
            of()
    with pytest.raises(mo.MotesError, match=r"AdditiveNoise law: expected sample\(key, \(n,\)\) that returns"):
        mo.AdditiveNoise(lambda x, u, t: x, type("Odd", (), {"sample": lambda self, key: 0.0, "log_prob": lambda self, x: x})())


MOMENTS = ("Kalman", "Ensemble", "GaussianSum", "Interacting", "JumpMarkov", "Marginalized", "RaoBlackwellized", "Cubature", "Hermite",
           "proposal", "extended", "Auxiliary", "CostReference", "Skeleton")  # fmt: skip
"""Filters that may ask for moments of noises or initial laws, and then say so."""


@pytest.mark.night
def test_laws_of_two_functions_work_where_a_density_is_enough():
    cases = (model(sensor_noise=Joint()), model(noise=Joint()), model(initial=Joint()))
    works = []
    for name, filter in examples().items():
        for case in cases:
            engine = lambda f=filter, m=case: running(f, m)  # noqa: E731
            try:
                shape = jax.eval_shape(engine).shape
                works.append(name)
                assert shape == (3, 2)
            except mo.MotesError as refusal:
                assert any(word in name for word in (*MOMENTS, "GaussianParticle")), (name, str(refusal))
                assert any(word in str(refusal) for word in ("Joint", "dynamics", "sensor", "initial")), (name, str(refusal))
    for name in ("ParticleFilter", "RegularizedParticleFilter", "PointMassFilter"):
        assert works.count(name) == len(cases), name


def running(filter, model):
    return mo.run(0, filter, model, np.zeros((3, 2))).mean
