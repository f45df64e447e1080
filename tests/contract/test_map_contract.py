"""The contract of the filter that makes maps, on a model with landmarks that nobody numbers."""

from functools import lru_cache

import jax.numpy as jnp
import numpy as np
import pytest

import motes as mo
from motes.core.record import replace
from motes.testing.rules import RULES, asked
from motes.testing.session import GAP, STEPS, Session

pytestmark = pytest.mark.jax
PLACES = [[4.0, 1.0], [-3.0, 6.0]]
FILTERS = {"with the sightings": mo.LandmarkFilter(n=200), "blind": mo.LandmarkFilter(n=200, proposal=False)}
BY_DAY = {"form", "value", "stream", "cut", "checkpoint"}
"""Rules that are asked by day."""


def expected(x, place, u, t):
    return place - x[:1]


def born(x, z):
    return mo.Gaussian(z + x[:1], 0.25 * jnp.eye(2))


def model(scale=1.0):
    dynamics = mo.LinearGaussian(scale * jnp.array([[1.0, 0.3], [0.0, 0.9]]), jnp.diag(jnp.array([0.04, 0.02])))
    return mo.MapModel(mo.Gaussian([0.0, 0.2], jnp.diag(jnp.array([0.01, 0.04]))), dynamics, expected, 0.25 * jnp.eye(2),
                       birth=born, landmarks=2, linear=("b",), names=("a", "b"), limit=30.0)


class MapSession(Session):
    """A session whose measurements are sets of sightings."""

    def __init__(self, filter):
        self.filter, self.own, self.model = replace(filter, on_collapse="predict"), False, model()
        self.truth, self.gappy = self.drawn(5, self.model, 2 * STEPS)
        self.ys = self.gappy[:STEPS].copy()
        self.gappy[GAP] = np.nan

    @staticmethod
    def drawn(key, model, steps):
        xs, ys = mo.simulate(key, model.among(PLACES), steps)
        return np.array(xs), np.array(ys.value["z"])

    @property
    def other(self):
        return model(0.9), self.drawn(6, model(0.9), STEPS)[1]


@lru_cache(maxsize=2)
def session(name, precision):
    return MapSession(FILTERS[name])


@pytest.mark.parametrize(("rule", "name", "precision"), [
    pytest.param(rule, name, precision, id=f"{rule.ask.__name__}-{precision}-{name}",
                 marks=[*[pytest.mark.night] * (rule.ask.__name__ not in BY_DAY or precision == "float64" or name == "blind"),
                        *[pytest.mark.optimized] * rule.exact])
    for name in FILTERS for precision in ("float32", "float64") for rule in RULES
], indirect=["precision"])  # fmt: skip
def test_it_keeps_the_contract(rule, name, precision):
    outcome = asked(rule, session(name, precision))
    assert outcome.finding is None, str(outcome.finding)
