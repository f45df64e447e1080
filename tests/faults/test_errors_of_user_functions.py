"""What goes wrong in a user's function is told in one line: the function, its file and line, and what to write instead."""

import math
import random
import sys
import threading
import time

import jax.numpy as jnp
import numpy as np
import pytest

import motes as mo
from contract.discovery import examples

EYE, YS = np.eye(2), np.zeros((3, 2))


def linear():
    return mo.LinearGaussian(EYE, EYE)


def model(f, part="dynamics", initial=None):
    parts = {"initial": mo.Gaussian([0.0, 0.0], EYE), "dynamics": linear(), "sensor": linear(), "names": ("a", "b")}
    return mo.StateSpaceModel(**(parts | {part: f if isinstance(f, mo.Custom) else mo.AdditiveGaussian(f, EYE)}))


def with_math(x, u, t):
    return jnp.array([math.hypot(x[0], x[1]), x[1]])


def with_numpy(x, u, t):
    return np.sin(x)


def with_if(x, u, t):
    if x[0] > 0:
        return x
    return -x


def two_arguments(x, u):
    return x


def with_inputs(x, u, t):
    return x + u[0]


def with_float(x, u, t):
    return float(x[0]) * x


def with_index(x, u, t):
    return x * [1.0, 2.0, 3.0][t]


def with_mask(x, u, t):
    return x[x > 0]


def in_place(x, u, t):
    x[0] = 1.0
    return x


def no_return(x, u, t):
    x + 1  # noqa: B018


def own_error(x, u, t):
    raise RuntimeError("not today")


def by_helper(x, u, t):
    return with_if(x, u, t)


CASES = {
    "math": (with_math, "Write jnp.hypot for math.hypot."),
    "NumPy": (with_numpy, "Write jnp.sin for np.sin."),
    "if": (with_if, "write jnp.where(condition, a, b) for `if`"),
    "two arguments": (two_arguments, "got two_arguments(x, u) at two_arguments, "),
    "missing inputs": (with_inputs, "It reads inputs, and there are none: give inputs=."),
    "float": (with_float, "no float() or int()."),
    "index": (with_index, "Write jnp.asarray(table)[i]"),
    "mask": (with_mask, "Write jnp.where(mask, a, b) for an index by a mask."),
    "in place": (in_place, "Write x = x.at[i].set(value) for x[i] = value."),
    "no return": (no_return, "Does it end in return?"),
    "its own": (own_error, "RuntimeError at own_error"),
    "helper": (by_helper, "at with_if, "),
}


def refused(call):
    with pytest.raises(mo.MotesError) as error:
        call()
    text = str(error.value)
    assert "\n" not in text and len(text) <= 500 and error.value.__cause__ is None
    assert error.value.__suppress_context__ or error.value.__context__ is None
    return text


@pytest.mark.parametrize("name", CASES)
def test_told_in_one_line(name):
    f, cure = CASES[name]
    alone = mo.stream(0, mo.ParticleFilter(5), model(f))
    calls = [lambda: mo.simulate(0, model(f), 3), lambda: mo.structure(model(f)), lambda: alone.update([0.0, 0.0])]
    calls += [lambda each=each: mo.run(0, each, model(f), YS) for each in examples().values() if not each.adds_inputs]
    for call in calls:
        text = refused(call)
        assert text.startswith("dynamics f(x, u, t): expected a ") and cure in text, text
        assert "test_errors_of_user_functions.py, line " in text, text
    assert refused(lambda: mo.run(0, mo.ParticleFilter(5), model(f, "sensor"), YS)).startswith("sensor f(x, u, t): expected a ")


GENERATOR, PLAIN = np.random.default_rng(0), random.Random(0)


def of_numpy(x, u, t):
    return x + np.random.normal(size=2)  # noqa: NPY002


def of_a_generator(x, u, t):
    return x + GENERATOR.normal(size=2)


def of_python(x, u, t):
    return x + random.gauss()


def of_an_object(x, u, t):
    return x + PLAIN.random()


@pytest.mark.parametrize("f", [of_numpy, of_a_generator, of_python, of_an_object], ids=lambda f: f.__name__)
def test_random_numbers_that_would_be_drawn_once(f):
    own = np.random.default_rng(0)
    for drawing, part in ((f, "dynamics"), (f, "sensor"), (lambda x, u, t: x * own.random(), "dynamics")):
        text = refused(lambda: mo.run(0, mo.ParticleFilter(5), model(drawing, part), YS))  # noqa: B023
        assert text.startswith(f"{part} f(x, u, t): expected a function without random numbers") and ".py, line " in text


def test_random_numbers_of_a_model_that_is_fitted():
    text = refused(lambda: mo.fit(lambda theta: mo.models.local_level(theta["a"] + GENERATOR.random(), 1.0), YS[:, 0], {"a": 1.0}))
    assert text.startswith("fit model_of(parameters): expected a function without random numbers")


def test_numbers_drawn_by_another_thread_are_nothing_of_the_function():
    times = []

    def disturbed(x, u, t):
        times.append(t)
        if len(times) == 1:
            # what another thread would do meanwhile
            GENERATOR.random()
        return x

    mo.structure(model(disturbed))
    assert len(times) > 1


def test_a_thread_that_draws_all_the_time_is_nothing_of_the_function():
    over, interval = threading.Event(), sys.getswitchinterval()

    def draw():
        while not over.is_set():
            np.random.random()  # noqa: NPY002
            random.random()

    def long(x, u, t):
        end = time.perf_counter() + 3 * interval
        while time.perf_counter() < end:
            pass
        return x

    threads = [threading.Thread(target=draw, daemon=True) for _ in range(2)]
    for thread in threads:
        thread.start()
    try:
        mo.structure(model(long))
        assert refused(lambda: mo.structure(model(of_numpy))).startswith("dynamics f(x, u, t): expected a function without random numbers")
    finally:
        over.set()
        for thread in threads:
            thread.join()
    assert sys.getswitchinterval() == interval


def test_the_line_is_the_one_at_fault():
    line = with_if.__code__.co_firstlineno + 1
    assert f'line {line} ("if x[0] > 0:")' in refused(lambda: mo.run(0, mo.ParticleFilter(5), model(by_helper), YS))


def test_every_kind_of_function():
    noise = mo.AdditiveGaussian(lambda x, u, t: x, lambda x, u, t: np.diag(np.exp(x)))
    custom = mo.Custom(sample=lambda key, x, u, t: x if x[0] > 0 else -x)
    density = mo.Custom(log_prob=lambda y, x, u, t: -math.dist(y, x))
    chain = mo.JumpMarkovModel([1.0], lambda u: [[1.0]], model(lambda x, u, t: x))
    mixed = mo.MixedLinearModel(mo.Gaussian([0.0], [[1.0]]), mo.Gaussian([0.0], [[1.0]]), *[lambda x, u, t: (math.sin(x[0]), EYE, EYE)] * 3)
    filter = mo.ParticleFilter(5)
    base = model(lambda x, u, t: x)
    calls = {
        "dynamics Q(x, u, t)": lambda: mo.run(0, filter, mo.StateSpaceModel(base.initial, noise, linear()), YS),
        "dynamics sample(key, x, u, t)": lambda: mo.run(0, filter, model(custom), YS),
        "sensor log_prob(value, x, u, t)": lambda: mo.run(0, filter, model(density, "sensor"), YS),
        "transition(u, t)": lambda: mo.run(0, mo.JumpMarkovFilter(5), chain, YS),
        "particle(x_p, u, t)": lambda: mo.run(0, mo.MarginalizedParticleFilter(5), mixed, YS),
        "ParticleFilter proposal f(x, u, t)": lambda: mo.run(0, mo.ParticleFilter(5, proposal=mo.AdditiveGaussian(with_if, EYE)), base, YS),
        "log_density(position)": lambda: mo.sample(0, mo.mcmc.RandomWalkMetropolis(1.0), lambda x: -math.sqrt(x[0]), jnp.ones(1)),
        "Posterior model(theta)": lambda: mo.parameters.Posterior(mo.Gaussian([0.0], [[1.0]]), lambda theta: None, mo.KalmanFilter(), YS),
    }
    for role, call in calls.items():
        text = refused(call)
        assert text.startswith(f"{role}: expected a ") and "test_errors_of_user_functions.py, line " in text, text
