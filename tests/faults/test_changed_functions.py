"""A model built anew from a function whose globals, attributes or tables have changed runs with the new numbers, whatever was read how."""

import dataclasses
import functools
import gc
import sys
import types
import weakref

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import motes as mo
from contract.discovery import examples
from motes.filters import pair as pairs
from motes.filters import run as running
from motes.filters.pair import pair
from motes.models.canonical import canonical
from motes.tracing import identity
from motes.tracing.reading import Reading
from tiers import each

GAIN, TABLE, SETTINGS, FIXED = 0.5, np.array([0.5, 2.0]), {"gains": [1.0, {"first": 0.5}]}, jnp.array([0.5])
MODULE = types.ModuleType("settings_of_a_test")
MODULE.GAIN, MODULE.deep = 0.5, types.SimpleNamespace(er=types.SimpleNamespace(gain=0.5))
sys.modules[MODULE.__name__] = MODULE


def set_gain(value):
    global GAIN
    GAIN = value


def set_fixed(value):
    global FIXED
    FIXED = jnp.array([value])


class Part:
    """An object with a gain in every place."""

    shared = 0.5
    __slots__ = ("__dict__", "slot")

    def __init__(self):
        self.deep, self.table, self.slot = types.SimpleNamespace(er=types.SimpleNamespace(gain=0.5)), np.array([0.5]), 0.5

    @property
    def told(self):
        return self.deep.er.gain

    def by_attribute(self, x, u, t):
        return self.deep.er.gain * x

    def by_table(self, x, u, t):
        return self.table[0] * x

    def by_class(self, x, u, t):
        return self.shared * x

    def by_slot(self, x, u, t):
        return self.slot * x

    def by_property(self, x, u, t):
        return self.told * x

    __call__ = by_attribute


@dataclasses.dataclass
class Gain:
    """Compared by value, and without a hash."""

    gain: float = 0.5

    def __call__(self, x, u, t):
        return self.gain * x


def helper(x):
    return GAIN * x


jitted = jax.jit(helper)


def body(carry, _):
    return GAIN * carry, None


def of_settings(settings, x, u, t):
    return settings["gain"] * x


def by_default(x, u, t, settings={"gain": 0.5}):  # noqa: B006
    return settings["gain"] * x


def by_own_attribute(x, u, t):
    return by_own_attribute.gain * x


by_own_attribute.gain = 0.5


def by_import(x, u, t):
    from settings_of_a_test import GAIN as imported

    return imported * x


def by_name(x, u, t):
    return getattr(MODULE, "GA" + "IN") * x


@functools.wraps(helper)
def wrapped(*args):
    return helper(args[0])


def nested(x, u, t):
    def inner():
        return [GAIN * part for part in (x,)]

    return inner()[0]


part, bare, bound, cell = Part(), Gain(), {"gain": 0.5}, [0.5]
CASES = {
    "global": (lambda x, u, t: GAIN * x, set_gain),
    "nested function": (nested, set_gain),
    "helper": (lambda x, u, t: helper(x), set_gain),
    "jitted helper": (lambda x, u, t: jitted(x), set_gain),
    "jitted": (jax.jit(lambda x, u, t: GAIN * x), set_gain),
    "body of a loop": (lambda x, u, t: jax.lax.scan(body, x, None, length=1)[0], set_gain),
    "wrapped": (wrapped, set_gain),
    "mapped": (lambda x, u, t: jax.vmap(helper)(x), set_gain),
    "callback": (lambda x, u, t: jax.pure_callback(lambda v: v, jax.ShapeDtypeStruct((1,), x.dtype), GAIN * x), set_gain),
    "table": (lambda x, u, t: TABLE[0] * x, lambda value: TABLE.__setitem__(0, value)),
    "array of JAX": (lambda x, u, t: FIXED * x, set_fixed),
    "containers": (lambda x, u, t: SETTINGS["gains"][1]["first"] * x, lambda value: SETTINGS["gains"][1].update(first=value)),
    "module": (lambda x, u, t: MODULE.GAIN * x, lambda value: setattr(MODULE, "GAIN", value)),
    "deep in a module": (lambda x, u, t: MODULE.deep.er.gain * x, lambda value: setattr(MODULE.deep.er, "gain", value)),
    "import": (by_import, lambda value: setattr(MODULE, "GAIN", value)),
    "computed name": (by_name, lambda value: setattr(MODULE, "GAIN", value)),
    "default": (by_default, lambda value: by_default.__defaults__[0].update(gain=value)),
    "own attribute": (by_own_attribute, lambda value: setattr(by_own_attribute, "gain", value)),
    "cell": ((lambda cell: lambda x, u, t: cell[0] * x)(cell), lambda value: cell.__setitem__(0, value)),
    "partial": (functools.partial(of_settings, bound), lambda value: bound.update(gain=value)),
    "method": (part.by_attribute, lambda value: setattr(part.deep.er, "gain", value)),
    "method, table": (part.by_table, lambda value: part.table.__setitem__(0, value)),
    "method, class": (part.by_class, lambda value: setattr(Part, "shared", value)),
    "method, slot": (part.by_slot, lambda value: setattr(part, "slot", value)),
    "method, property": (part.by_property, lambda value: setattr(part.deep.er, "gain", value)),
    "callable": (part, lambda value: setattr(part.deep.er, "gain", value)),
    "callable without hash": (bare, lambda value: setattr(bare, "gain", value)),
}
YS = np.zeros((2, 1))


def built(f, **changes):
    parts = {"initial": mo.Gaussian([1.0], [[1e-6]]), "dynamics": mo.AdditiveGaussian(f, [[1e-6]])}
    parts["sensor"] = mo.LinearGaussian([[1.0]], [[1e6]])
    return mo.StateSpaceModel(**(parts | changes))


def known(f):
    return canonical(built(f), None).dynamics.f


@pytest.fixture(autouse=True)
def put_back():
    yield
    for _, change in CASES.values():
        change(0.5)


@pytest.mark.parametrize("name", each(list(CASES), {"jitted helper", "body of a loop", "mapped", "callable without hash"}))
def test_what_has_changed_is_told_apart(name):
    f, change = CASES[name]
    before = known(f)
    assert name == "computed name" or name == "callback" or known(f) == before
    change(0.25)
    after = known(f)
    assert after != before and np.isclose(after(jnp.ones(1), None, 0), 0.25)
    change(0.5)
    assert name == "callback" or known(f) == before


RUN = ("global", "jitted helper", "body of a loop", "module", "method", "callable without hash", "computed name")


@pytest.mark.parametrize("name", each(RUN, {"body of a loop", "jitted helper", "callable without hash", "computed name"}))
def test_a_rebuilt_model_runs_the_new_numbers(name):
    f, change = CASES[name]
    for gain in (0.5, 0.25, 0.5):
        change(gain)
        mean = mo.run(0, mo.UnscentedKalmanFilter(), built(f), YS).mean
        assert np.allclose(mean[:, 0], [1.0, gain], atol=1e-3)
        alone = mo.stream(0, mo.UnscentedKalmanFilter(), built(f))
        alone.update(0.0)
        alone.predict()
        assert np.allclose(alone.mean, gain, atol=1e-3)
        assert np.allclose(mo.simulate(0, built(f), 2)[0][1], gain, atol=0.05)


@pytest.mark.parametrize("name", each(RUN, {"body of a loop", "jitted helper", "callable without hash", "computed name"}))
def test_a_model_that_stays_runs_the_new_numbers(name):
    """What is remembered of a filter and a model does not outlive what its functions read."""
    f, change = CASES[name]
    filter, model = mo.UnscentedKalmanFilter(), built(f)
    for gain in (0.5, 0.5, 0.25, 0.5):
        change(gain)
        assert np.allclose(mo.run(0, filter, model, YS).mean[:, 0], [1.0, gain], atol=1e-3)


def test_functions_looked_at_once_are_found(monkeypatch):
    """The twin: a reading that sees nothing gives old numbers."""
    f = lambda x, u, t: GAIN * x  # noqa: E731
    monkeypatch.setattr(identity, "Reading", lambda value: types.SimpleNamespace(text="", helpers=set()))
    before = known(f)
    set_gain(0.25)
    assert known(f) == before


def keys(filter, model, monkeypatch, **rest):
    """What decides whether code compiled for a run is used again."""

    class Seen(Exception):
        pass

    def see(key, *args):
        form, kept = args[0], args[4]
        raise Seen((form.structure, (form.beside, kept)))

    monkeypatch.setattr(running, "_run", see)
    with pytest.raises(Seen) as found:
        mo.run(0, filter, model, np.zeros((3, 2)), **rest)
    return found.value.args[0]


def test_every_filter_sees_changes(monkeypatch):
    wide = lambda x, u, t: GAIN * x  # noqa: E731
    names = ("a", "b")
    for name, filter in examples().items():
        found = []
        for gain in (0.5, 0.25, 0.5):
            set_gain(gain)
            eye = np.eye(2)
            model = mo.StateSpaceModel(mo.Gaussian([0.0, 0.0], eye), mo.AdditiveGaussian(wide, eye), mo.LinearGaussian(eye, eye), names)
            found.append(keys(filter, model, monkeypatch))
        assert found[0] != found[1] and found[0] == found[2], name


class OwnSensor(mo.AdditiveGaussian):
    """A conditional of the user's, whose method reads a global."""

    def log_prob(self, value, X, u, t):
        return GAIN * super().log_prob(value, X, u, t)


jax.tree_util.register_pytree_node(
    OwnSensor, lambda self: ((self.Q,), self.f), lambda f, children: object.__new__(OwnSensor)
)


def test_what_is_not_traced_beforehand_is_seen(monkeypatch):
    """Functions of what is kept, and classes of the user's own."""
    eye = np.eye(2)
    model = mo.StateSpaceModel(mo.Gaussian([0.0, 0.0], eye), mo.LinearGaussian(eye, eye), OwnSensor(lambda x, u, t: x, eye))
    plain = dataclasses.replace(model, sensor=mo.LinearGaussian(eye, eye)) if dataclasses.is_dataclass(model) else model
    keep = lambda law: {"mean": GAIN * law.mean()}  # noqa: E731
    for case, rest in ((model, {}), (plain, {"keep": keep})):
        found = []
        for gain in (0.5, 0.25, 0.5):
            set_gain(gain)
            found.append(keys(mo.ParticleFilter(9), case, monkeypatch, **rest)[1])
        assert found[0] != found[1] and found[0] == found[2]


def test_what_is_remembered_of_a_filter_and_a_model():
    """Nothing where what is read is not known, or where a class of the user's is in it; and nothing that outlives the model."""
    filter, y = mo.UnscentedKalmanFilter(), jax.ShapeDtypeStruct((1,), jnp.float32)

    def remembered(f=CASES["global"][0], **changes):
        model = built(f, **changes)
        return pair(filter, model, None, y) is pair(filter, model, None, y), weakref.ref(model)

    assert [remembered(by_name)[0], remembered(sensor=OwnSensor(lambda x, u, t: x, np.eye(1)))[0]] == [False, False]
    same, model = remembered()
    gc.collect()
    assert same and model() is None and not any(there[1]() is None for there in pairs._known.values())


class Target:
    """A log density whose width is an attribute."""

    def __init__(self):
        self.width = 1.0

    def __call__(self, x):
        return -0.5 * jnp.sum(x**2) / self.width**2


def test_chains_see_changes():
    target, draws = Target(), {}
    for width in (1.0, 0.1, 1.0):
        target.width = width
        chains = mo.sample(0, mo.mcmc.RandomWalkMetropolis(width), target, jnp.zeros(1), draws=200, chains=2, burn_in=10)
        draws.setdefault(width, []).append(np.asarray(chains.positions))
    assert np.allclose(0.1 * draws[1.0][0], draws[0.1][0], rtol=1e-3) and np.array_equal(*draws[1.0])


def test_posteriors_see_changes():
    prior, ys = mo.Gaussian([0.0], [[1.0]]), np.ones((3, 1))

    def model(theta):
        return built(lambda x, u, t: GAIN * x + theta, sensor=mo.LinearGaussian([[1.0]], [[0.1]]))

    found = []
    for gain in (0.5, 0.25):
        set_gain(gain)
        posterior = mo.parameters.Posterior(prior, model, mo.KalmanFilter(), ys)
        found.append(mo.parameters.liu_west(0, posterior, 30).log_likelihood)
    assert found[0] != found[1]


def test_reading_tells_what_it_cannot_see():
    iterator, chance = iter([1.0]), np.random.default_rng(0)
    for f in (by_name, lambda x: next(iterator) * x, lambda x: globals()["GAIN"] * x, lambda x: chance.random() * x):
        assert Reading(f).text is None
    assert all(Reading(f).text for name, (f, _) in CASES.items() if name != "computed name")
