"""A filter is made ready for a model once for each compiled program."""

import importlib
import inspect
import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import motes as mo
from motes.models import structure
from motes.tracing.identity import Beside

sys.path.append(str(Path(__file__).parents[1] / "contract"))
from discovery import example, filter_classes  # noqa: E402


class Counted:
    """Counts the calls of a function."""

    def __init__(self, function):
        self.function, self.calls = function, 0

    def __call__(self, *args, **named):
        self.calls += 1
        return self.function(*args, **named)


def fresh(name, R=((1.0, 0.2), (0.2, 1.5))):
    """A linear model for which nothing was compiled, if nobody else uses the name."""
    initial, dynamics = mo.Gaussian([1.0, -0.5], [[2.0, 0.4], [0.4, 1.0]]), mo.LinearGaussian([[0.9, 0.3], [-0.1, 0.7]], 0.3 * np.eye(2))
    return mo.StateSpaceModel(initial, dynamics, mo.LinearGaussian([[1.0, 0.2], [0.3, -1.0]], R), ("a", name))


@pytest.fixture
def counted(monkeypatch):
    """Counters of the preparations of a class of filters, and of what tracing asks to discover structure."""
    found = Counted(structure.dependence)
    monkeypatch.setattr(structure, "dependence", found)

    def count(cls):
        prepare, made = cls.prepare, []
        monkeypatch.setattr(cls, "prepare", lambda *args: (made.append(1), prepare(*args))[1])
        return made, found

    return count


@pytest.mark.parametrize("cls", [pytest.param(cls, id=name) for name, cls in filter_classes().items()])
def test_a_run_prepares_once(cls, counted):
    filter = example(cls, **({"nonlinear": ("a",)} if "nonlinear" in inspect.signature(cls).parameters else {}))
    model, ys = fresh(f"once {cls.__name__}"), jnp.ones((5, 2))
    made, found = counted(cls)
    filter.prepare(model, None)
    once = found.calls
    made.clear()
    jax.eval_shape(lambda ys: mo.run(0, filter, model, ys).mean, ys)
    assert len(made) == 1
    assert found.calls == 2 * once


def test_a_program_of_a_stream_prepares_once(counted):
    made, _ = counted(mo.KalmanFilter)
    stream = mo.stream(0, mo.KalmanFilter(), fresh("streamed"))
    # to start and to take in; whole steps; to move where the law is asked for between
    for count, asked in ((2, 2), (3, 3), (3, 4), (4, 4)):
        stream.update(np.ones(2))
        assert len(made) == count
        stream.predict()
        if asked > count:
            stream.mean  # noqa: B018
        assert len(made) == asked


def test_programs_of_smc_squared_prepare_once(counted):
    smc_squared = importlib.import_module("motes.parameters.smc_squared")
    made, _ = counted(mo.KalmanFilter)

    def model(theta):
        return fresh("squared", jnp.exp(theta[0]) * jnp.eye(2))

    posterior = mo.parameters.Posterior(mo.Gaussian([0.0], [[1.0]]), model, mo.KalmanFilter(), np.ones((3, 2)))
    key, t, beside = jax.random.key(0), jnp.int32(1), Beside(posterior)
    keys = jax.random.split(key, 4)
    state = jax.eval_shape(smc_squared._begun, posterior, jnp.zeros((4, 1)), keys, beside)
    assert len(made) == 1
    jax.eval_shape(smc_squared._taken_in, posterior, state, jnp.zeros(4), t, beside)
    assert len(made) == 2
    walk = mo.mcmc.RandomWalkMetropolis(1.0)
    jax.eval_shape(smc_squared._once, key, posterior, state, walk, t, beside)
    assert len(made) == 3
