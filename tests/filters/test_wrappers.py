"""Filters around filters: they find their way back, they learn, and they can be put around each other."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import motes as mo
from tiers import each

STEPS, JUMP = 120, 60
WALK = mo.StateSpaceModel(
    mo.Gaussian(jnp.zeros(2), jnp.eye(2)), mo.LinearGaussian(jnp.eye(2), 0.05 * jnp.eye(2)), mo.LinearGaussian(jnp.eye(2), 0.2 * jnp.eye(2))
)


def kidnapped():
    """A walk that is carried away in the middle."""
    xs, ys = (np.array(drawn) for drawn in mo.simulate(2, WALK, STEPS))
    xs[JUMP:] += 40.0
    ys[JUMP:] += 40.0
    return xs, ys


XS, YS = kidnapped()


def near(key, y, u, t):
    return jnp.where(jnp.isnan(y), 0, y) + jax.random.normal(key, (2,))


INNER = mo.ParticleFilter(n=300, on_collapse="predict")


def test_a_kidnapped_filter_comes_back():
    plain, found = mo.run(1, INNER, WALK, YS), mo.run(1, mo.Recovering(INNER, near), WALK, YS)
    assert np.linalg.norm(np.asarray(plain.mean)[-1] - XS[-1]) > 10
    assert np.linalg.norm(np.asarray(found.mean)[-1] - XS[-1]) < 1.5
    share = np.asarray(found.info.recovered)
    assert share[:JUMP].max() == 0 and share[JUMP : JUMP + 40].max() > 0.1 and share[-10:].max() == 0


def test_it_changes_nothing_while_all_is_well():
    calm = YS[:JUMP]
    assert np.array_equal(mo.run(1, mo.Recovering(INNER, near), WALK, calm).mean, mo.run(1, INNER, WALK, calm).mean)


def test_a_start_that_never_was_right_is_told_by_what_is_usual():
    """The slow mean alone begins with the evidence of the wrong place."""
    usual = lambda y, u, t: -jnp.sum(~jnp.isnan(y)) * 0.5 * jnp.log(2 * jnp.pi * jnp.e * 0.3)  # noqa: E731
    shifted = YS[:30] + 15.0
    shifted[5, 0] = np.nan
    off = {}
    for name, filter in (("slow mean", mo.Recovering(INNER, near)), ("usual", mo.Recovering(INNER, near, usual=usual))):
        off[name] = np.linalg.norm(np.asarray(mo.run(1, filter, WALK, shifted).mean) - XS[:30] - 15.0, axis=1)
    assert off["usual"][20:].max() < 1.5 < 3 < off["slow mean"][15]


def biased(memory):
    sensor = mo.AdditiveGaussian(lambda x, u, t: x + u["memory"]["bias"], 0.2 * jnp.eye(2))
    model = mo.StateSpaceModel(mo.Gaussian(jnp.zeros(2), 0.01 * jnp.eye(2)), mo.LinearGaussian(0.5 * jnp.eye(2), 0.05 * jnp.eye(2)), sensor)
    learn = lambda key, memory, law, y, u, t: {"bias": memory["bias"] + 0.1 * (y - law.mean() - memory["bias"])}  # noqa: E731
    return model, mo.Adapting(memory, {"bias": jnp.zeros(2)}, learn)


TRUE_BIAS = np.array([3.0, -1.0])


def measured_with_bias():
    free = mo.StateSpaceModel(
        mo.Gaussian(jnp.zeros(2), 0.01 * jnp.eye(2)), mo.LinearGaussian(0.5 * jnp.eye(2), 0.05 * jnp.eye(2)), WALK.sensor
    )
    return np.asarray(mo.simulate(4, free, STEPS)[1]) + TRUE_BIAS


@pytest.mark.parametrize("inner", [mo.KalmanFilter(), mo.ParticleFilter(n=400)], ids=lambda inner: type(inner).__name__)
def test_a_bias_is_learned(inner):
    model, filter = biased(inner)
    history = mo.run(1, filter, model, measured_with_bias())
    assert np.abs(np.asarray(history.state.beside["bias"]) - TRUE_BIAS).max() < 0.6


BOTH = {"recovering around adapting": lambda: mo.Recovering(biased(INNER)[1], near),
        "adapting around recovering": lambda: biased(mo.Recovering(INNER, near))[1]}  # fmt: skip


@pytest.mark.optimized
@pytest.mark.parametrize("order", each(list(BOTH), {"adapting around recovering"}))
def test_wrappers_compose_and_go_on(order, tmp_path):
    """Cut and continued to the bit; a stream up to rounding, since what a model reads of the memory is fused otherwise."""
    model, filter = biased(INNER)[0], BOTH[order]()
    ys = measured_with_bias()[:30]
    ys[10:] += 30.0
    ys[20] = np.nan
    whole = mo.run(3, filter, model, ys)
    stream, means = mo.stream(3, filter, model), []
    for t, y in enumerate(ys):
        if t:
            stream.predict()
        stream.update(y)
        means.append(np.asarray(stream.mean))
        if t == 15:
            stream.save(tmp_path / "stream.npz")
            stream = type(stream).load(tmp_path / "stream.npz", filter, model)
    np.testing.assert_allclose(np.stack(means), whole.mean, rtol=1e-4, atol=1e-4)
    mo.run(3, filter, model, ys[:12]).save(tmp_path / "begun.npz")
    rest = mo.run(3, filter, model, ys[12:], after=mo.History.load(tmp_path / "begun.npz"))
    assert np.array_equal(rest.mean, whole.mean[12:])


def test_a_study_compares_wrapped_filters():
    experiment = mo.Experiment(WALK, {"plain": INNER, "recovering": mo.Recovering(INNER, near)}, steps=10, runs=3)
    result = mo.study(experiment)
    assert np.array_equal(result.estimates[0], result.estimates[1])


def recovered_by(fresh):
    return mo.run(0, mo.Recovering(INNER, fresh), WALK, YS[:3])


def learned_by(memory, learn):
    return mo.run(0, mo.Adapting(INNER, memory, learn), WALK, YS[:3])


@pytest.mark.parametrize(("make", "words"), [
    (lambda: mo.Recovering(3, near), "Recovering filter: expected a filter"),
    (lambda: mo.Recovering(INNER, 3), "Recovering fresh: expected a function"),
    (lambda: mo.Recovering(INNER, near, slow=0.2), "Recovering slow, fast: expected 0 < slow < fast"),
    (lambda: mo.Recovering(INNER, near, margin=0.5), "Recovering margin: expected a number of at least 1"),
    (lambda: mo.Recovering(INNER, near, usual=3), "Recovering usual: expected a function"),
    (lambda: mo.run(0, mo.Recovering(INNER, near, usual=lambda y, u, t: y), WALK, YS[:3]), "Recovering usual: expected one number"),
    (lambda: mo.Adapting(INNER, 0.0, None), "Adapting learn: expected a function"),
    (lambda: mo.run(0, mo.Recovering(mo.KalmanFilter(), near), WALK, YS[:3]), "Recovering filter: expected one whose law is a Cloud"),
    (lambda: mo.Recovering(INNER, near, slow="a"), "Recovering slow: expected a number above 0"),
    (lambda: recovered_by(lambda key, y, u, t: jnp.zeros(3)), r"Recovering fresh: expected a state \(2,\)"),
    (lambda: recovered_by(lambda key: key), r"Recovering fresh\(key, y, u, t\): .* 4 arguments"),
    (lambda: recovered_by(lambda key, y, u, t: {}[1]), "Recovering fresh.* KeyError at .*test_wrappers.py"),
    (lambda: mo.Adapting(INNER, {"bias": "x"}, near), "Adapting memory: expected a tree of arrays of numbers, got str"),
    (lambda: learned_by(0, lambda key, m, law, y, u, t: m + 0.5), "Adapting learn: .*int32.* got float32"),
    (lambda: learned_by(jnp.zeros(2), lambda key, m, law, y, u, t: m[:1]), "Adapting learn: expected a memory"),
    (lambda: learned_by(jnp.zeros(2), lambda key: key), r"Adapting learn\(key.* 6 arguments"),
])  # fmt: skip
def test_what_cannot_be_is_refused(make, words):
    with pytest.raises(mo.MotesError, match=words):
        make()


WIDE = mo.StateSpaceModel(mo.Gaussian(jnp.zeros(2), 400 * jnp.eye(2)), WALK.dynamics, WALK.sensor)
SIZES = (100, 800, 6_000)
SIZED = mo.AdaptiveSize(mo.ParticleFilter(n=1), SIZES, widths=(0.5, 0.5))


def test_the_number_of_particles_follows_the_spread_of_the_law():
    _, ys = mo.simulate(1, WIDE, 20)
    ys = np.array(ys)
    ys[8:14] = np.nan
    place = lambda law: {**mo.keep.moments(law), "size": law.beside[0]}  # noqa: E731
    history = mo.run(2, SIZED, WIDE, ys, keep=place)
    sizes = np.asarray(history.kept["size"])
    assert sizes[0] == 2 and sizes[7] < 2 and sizes[13] >= sizes[7]
    exact = mo.run(2, mo.KalmanFilter(), WIDE, ys)
    spread = np.sqrt(np.diagonal(np.asarray(exact.cov), axis1=1, axis2=2))
    assert np.abs((np.asarray(history.mean) - np.asarray(exact.mean)) / spread).max() < 1.0
    assert abs(float(history.log_likelihood) - float(exact.log_likelihood)) < 1.5


AROUND = {
    "alone": SIZED,
    "around recovering": mo.AdaptiveSize(mo.Recovering(INNER, near), SIZES[:2], widths=(0.5, 0.5)),
    "within recovering": mo.Recovering(mo.AdaptiveSize(INNER, SIZES[:2], widths=(0.5, 0.5)), near),
}


@pytest.mark.parametrize("name", each(list(AROUND), {"alone", "around recovering"}))
def test_sizes_change_in_a_stream_as_in_a_run(name):
    filter = AROUND[name]
    ys = YS[JUMP - 10 : JUMP + 10].copy() - YS[JUMP - 10]
    ys[5] = np.nan
    whole = mo.run(3, filter, WIDE, ys)
    stream = mo.stream(3, filter, WIDE)
    for t, y in enumerate(ys):
        if t:
            stream.predict()
        stream.update(y)
        np.testing.assert_allclose(stream.mean, whole.mean[t], rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize(("make", "words"), [
    (lambda: mo.AdaptiveSize(mo.KalmanFilter(), (1, 2), (1.0,)), "AdaptiveSize filter: expected one with a number of particles n"),
    (lambda: mo.AdaptiveSize(INNER, (300, 200), (1.0,)), "AdaptiveSize sizes: expected numbers that increase"),
    (lambda: mo.AdaptiveSize(mo.Distributed(INNER, 2), (21, 60), (1.0,)), "AdaptiveSize sizes: expected numbers .* such as 22, got 21"),
    (lambda: mo.AdaptiveSize(INNER, (200, 300), (1.0, 0.0)), "AdaptiveSize widths: expected a width above 0"),
    (lambda: mo.AdaptiveSize(INNER, (200, 300), (1.0, 1.0), error=2.0), "AdaptiveSize error: expected a number between 0 and 1"),
    (lambda: mo.AdaptiveSize(INNER, 300, (1.0,)), "AdaptiveSize sizes: expected some numbers"),
    (lambda: mo.AdaptiveSize(INNER, (), (1.0,)), "AdaptiveSize sizes: expected some numbers"),
    (lambda: mo.AdaptiveSize(INNER, (200, 300), 0.5), "AdaptiveSize widths: expected some numbers"),
    (lambda: mo.AdaptiveSize(INNER, (200, 300), ("a", 0.5)), "AdaptiveSize widths: expected a width above 0"),
    (lambda: mo.AdaptiveSize(INNER, (200, 300), (np.inf, np.inf)), "AdaptiveSize widths: expected a finite width"),
    (lambda: mo.AdaptiveSize(INNER, (200, 300), (1.0, 1.0), error="a"), "AdaptiveSize error: expected a number above 0"),
    (lambda: mo.run(0, mo.AdaptiveSize(INNER, (200, 300), (1.0,)), WALK, YS[:2]), "AdaptiveSize widths: expected one for each of 2 states"),
])  # fmt: skip
def test_sizes_that_cannot_be_are_refused(make, words):
    with pytest.raises(mo.MotesError, match=words):
        make()
