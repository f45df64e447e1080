"""Measurements that are no vectors say the same as vectors that hold the same numbers, in every way a filter can be driven."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from discovery import example, examples, shares_stages

import motes as mo
from motes.testing.models import linear
from tiers import each

STEPS, WIDE = 10, 4
XS, YS = (np.asarray(drawn) for drawn in mo.simulate(5, linear((0, 1)), STEPS))
YS = np.round(np.clip(XS + 0.5 * np.random.default_rng(3).normal(size=XS.shape), -12, 12), 1).astype(np.float32)
GAP, OTHER = 4, 7


def as_set(ys):
    """Four rows, one of which holds the measurement; which one says nothing."""
    found = np.full((len(ys), WIDE, 2), np.nan, np.float32)
    found[np.arange(len(ys)), np.arange(len(ys)) % WIDE] = ys
    return found


def as_frame(ys):
    """Two pixels of a picture, in tenths."""
    found = np.random.default_rng(0).integers(0, 255, (len(ys), 5, 4, 3)).astype(np.uint8)
    found[:, 1, 2, 0], found[:, 4, 0, 2] = np.round(ys.T * 10 + 128)
    return found


FORMS = {
    "vector": (lambda ys: ys, lambda value: value),
    "sensors": (lambda ys: {"one": ys[:, :1], "two": ys[:, 1]}, lambda value: jnp.stack([value["one"][0], value["two"]])),
    "set": (as_set, lambda value: jnp.nansum(value, axis=0)),
    "frame": (as_frame, lambda value: (jnp.stack([value[1, 2, 0], value[4, 0, 2]]).astype(jnp.float32) - 128) / 10),
}
OTHERS = [name for name in FORMS if name != "vector"]


def model(form, **more):
    """A model whose density sees the numbers of a measurement in some form."""
    read = FORMS[form][1]
    density = lambda value, x, u, t: -0.5 * jnp.sum(((read(value) - x) / 0.5) ** 2)  # noqa: E731
    return mo.StateSpaceModel(linear().initial, linear().dynamics, mo.Custom(log_prob=density, partial=True, **more), ("a", "b"))


def rows(form, ys=YS):
    return FORMS[form][0](ys)


def taking():
    """Filters that take a density alone."""
    found = {}
    for name, filter in examples().items():
        try:
            jax.eval_shape(lambda filter=filter: mo.run(0, filter, model("vector"), YS[:2]))
            found[name] = filter
        except mo.MotesError:
            continue
    return found


TAKING = taking()


def test_filters_that_weigh_by_a_density_are_among_them():
    names = {"ParticleFilter", "AuxiliaryParticleFilter", "RegularizedParticleFilter", "GaussianParticleFilter",
             "GaussianSumParticleFilter", "PointMassFilter", "PaRIS"}  # fmt: skip
    assert names <= set(TAKING) and "KalmanFilter" not in TAKING


@pytest.mark.parametrize("case", each(
    {f"{name}-{form}": (name, form) for name in TAKING for form in OTHERS},
    lambda case: shares_stages(case.rpartition("-")[0]) or not case.endswith("-sensors") and not case.startswith("ParticleFilter-")))
def test_every_filter_finds_what_it_finds_of_vectors(case):
    name, form = case
    found, wanted = (mo.run(3, TAKING[name], model(one), rows(one)) for one in (form, "vector"))
    np.testing.assert_allclose(found.mean, wanted.mean, rtol=1e-3, atol=1e-3)
    np.testing.assert_allclose(found.info.log_evidence, wanted.info.log_evidence, rtol=1e-3, atol=1e-3)


FILTER = example(mo.ParticleFilter)


def steps_of(form):
    """The measurements one by one, two of them missing."""
    whole = rows(form)
    one_by_one = [jax.tree.map(lambda leaf, t=t: leaf[t], whole) for t in range(STEPS)]
    return [None if t in (GAP, OTHER) else one for t, one in enumerate(one_by_one)]


@pytest.mark.parametrize("form", FORMS)
def test_nothing_measured_is_a_prediction(form):
    listed = steps_of(form)
    if form == "vector":
        listed = [[np.nan, np.nan] if one is None else one for one in listed]
    history = mo.run(3, FILTER, model(form), listed)
    without = YS.copy()
    without[[GAP, OTHER]] = np.nan
    np.testing.assert_allclose(history.mean, mo.run(3, FILTER, model("vector"), without).mean, rtol=1e-3, atol=1e-3)
    assert np.flatnonzero(np.asarray(history.info.log_evidence) == 0).tolist() == [GAP, OTHER]


@pytest.mark.optimized
@pytest.mark.parametrize("form", each(OTHERS, {"set"}))
@pytest.mark.parametrize("filter", [FILTER, pytest.param(mo.AuxiliaryParticleFilter(n=300), marks=pytest.mark.night)],
                         ids=lambda filter: type(filter).__name__)  # fmt: skip
def test_streams_and_pieces_give_the_same_bits(form, filter, tmp_path):
    given, listed = model(form), steps_of(form)
    whole = mo.run(3, filter, given, listed)
    stream, means = mo.stream(3, filter, given), []
    for t, one in enumerate(listed):
        if t:
            stream.predict()
        stream.update(one)
        means.append(np.asarray(stream.mean))
        if t == 5:
            stream.save(tmp_path / "stream.npz")
            stream = type(stream).load(tmp_path / "stream.npz", filter, given)
    assert np.array_equal(np.stack(means), whole.mean)
    begun = mo.run(3, filter, given, listed[:5])
    begun.save(tmp_path / "begun.npz")
    rest = mo.run(3, filter, given, listed[5:], after=mo.History.load(tmp_path / "begun.npz"))
    assert np.array_equal(rest.mean, whole.mean[5:])


@pytest.mark.parametrize("form", OTHERS)
def test_many_runs_at_once(form):
    given, ys = model(form), rows(form)
    keys = jax.random.split(jax.random.key(0), 3)
    together = jax.vmap(lambda key: mo.run(key, FILTER, given, ys).mean)(keys)
    np.testing.assert_allclose(together[1], mo.run(keys[1], FILTER, given, ys).mean, rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize("form", OTHERS)
def test_the_native_engine_agrees(form):
    found = {}
    for name in ("jax", "native"):
        with mo.engine(name):
            found[name] = mo.run(3, FILTER, model(form), rows(form)).mean
    np.testing.assert_allclose(found["native"], found["jax"], rtol=1e-3, atol=1e-3)


def test_a_model_draws_what_it_measures_and_studies_take_it():
    def draw(key, x, u, t):
        seen = x + 0.5 * jax.random.normal(key, (2,))
        return {"one": seen[:1], "two": seen[1]}

    given = model("sensors", sample=draw)
    _, ys = mo.simulate(0, given, 6)
    assert ys["one"].shape == (6, 1) and ys["two"].shape == (6,)
    result = mo.study(mo.Experiment(given, {"few": mo.ParticleFilter(n=50), "more": mo.ParticleFilter(n=300)}, steps=6, runs=3))
    assert np.isfinite(result.estimates).all()


def test_a_digest_is_made_once_and_particles_at_once_or_one_by_one_agree():
    seen = []

    def digest(value, u, t):
        seen.append(1)
        return FORMS["frame"][1](value)

    def at_once(v, X, u, t):
        return -0.5 * jnp.sum(((v[:, None] - X) / 0.5) ** 2, axis=0)

    ys = rows("frame")
    wanted = mo.run(3, FILTER, model("frame"), ys).mean
    for density, batched in ((lambda v, x, u, t: -0.5 * jnp.sum(((v - x) / 0.5) ** 2), False), (at_once, True)):
        sensor = mo.Custom(log_prob=density, digest=digest, batched=batched)
        found = mo.run(3, FILTER, mo.StateSpaceModel(linear().initial, linear().dynamics, sensor, ("a", "b")), ys).mean
        np.testing.assert_allclose(found, wanted, rtol=1e-4, atol=1e-4)
    assert len(seen) < 20


def test_states_that_a_density_does_not_see_go_to_a_kalman_filter():
    """Named, or found by tracing once the form of a measurement is known."""
    steady = mo.textbook.constant_velocity()
    xs, _ = mo.simulate(0, steady, 30)
    ys = as_frame(np.clip(np.asarray(xs)[:, :2], -12, 12))
    read = FORMS["frame"][1]
    named = mo.Custom(log_prob=lambda value, p, u, t: -0.5 * jnp.sum((read(value) - p) ** 2), states=("px", "py"))
    found = mo.Custom(log_prob=lambda value, x, u, t: -0.5 * jnp.sum((read(value) - x[:2]) ** 2))
    models = [mo.StateSpaceModel(steady.initial, steady.dynamics, sensor, steady.names) for sensor in (named, found)]
    histories = [mo.run(1, mo.MarginalizedParticleFilter(n=500), one, ys) for one in models]
    assert all(type(history.state).__name__ == "MarginalCloud" and history.state.particles.shape == (2, 500) for history in histories)
    np.testing.assert_allclose(histories[0].mean, histories[1].mean, rtol=1e-3, atol=1e-3)
    assert mo.structure(models[0]).linear == (2, 3)


CUSTOM = mo.Custom(log_prob=lambda value, x, u, t: -0.5 * jnp.sum((value - x) ** 2))
WHOLE = mo.StateSpaceModel(linear().initial, linear().dynamics, CUSTOM, ("a", "b"))
REFUSED = {
    "ys: expected shape \\(t, y\\), as LinearGaussian measures, got an array of shape \\(10, 4, 2\\)":
        lambda: mo.run(0, mo.KalmanFilter(), linear(), rows("set")),
    "ys: expected shape \\(t, y\\), as LinearGaussian measures, got a dict": lambda: mo.run(0, FILTER, linear(), rows("sensors")),
    "row 0 partly NaN. Say partial=True": lambda: mo.run(0, FILTER, WHOLE, rows("set")),
    "first axes \\['10', '9'\\]": lambda: mo.run(0, FILTER, model("sensors"), {"one": YS[:, :1], "two": YS[:9, 1]}),
    "measurements of one form": lambda: mo.run(0, FILTER, model("set"), [np.zeros((4, 2)), np.zeros((3, 2))]),
    "what Custom measures, NaN where it measured nothing, got None": lambda: mo.stream(0, FILTER, model("set")).update(None),
    "Custom states: expected among the states a, b, got 'c'": lambda: model("set", states=("c",)),
    "Custom states: expected a tuple": lambda: model("set", states="a"),
    "Custom digest: expected a function": lambda: model("set", digest=3),
    "ys\\['one'\\]: expected finite numbers": lambda: mo.run(0, FILTER, model("sensors"), {"one": YS[:, :1] + np.inf, "two": YS[:, 1]}),
}


@pytest.mark.parametrize("words", REFUSED)
def test_what_cannot_be_is_refused_in_one_line(words):
    with pytest.raises(mo.MotesError, match=words):
        REFUSED[words]()


def test_a_stream_refuses_another_form():
    stream = mo.stream(0, FILTER, model("set"))
    stream.update(rows("set")[0])
    stream.predict()
    with pytest.raises(mo.MotesError, match=r"y: expected the form of the first one, float32\[4, 2\], got float32\[3, 2\]"):
        stream.update(rows("set")[0][:3])
