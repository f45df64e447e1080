"""What every filter must do, whatever its method. Filters are discovered; see discovery.py."""

import dataclasses
from itertools import product

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from discovery import example, examples, filter_classes, is_variant, shares_stages

import motes as mo
from models import linear
from motes.core import random, record
from motes.filters import run as running
from motes.filters.run import Engine
from tiers import each

FILTERS = examples()
STEPS = 12


CLASSES = {name: filter for name, filter in FILTERS.items() if not is_variant(name)}
"""One filter of each class: for what variants cannot differ in, since it takes long to compile."""
WITH_A_LIKELIHOOD = {name: filter for name, filter in CLASSES.items() if filter.has_evidence}
VARIANTS = set(FILTERS) - set(CLASSES)
LAWS = {name: FILTERS[name] for name in (
    "KalmanFilter", "SquareRootKalmanFilter", "ParticleFilter", "MarginalizedParticleFilter", "KalmanParticleKernelFilter",
    "CostReferenceParticleFilter", "JumpMarkovFilter")}  # fmt: skip
"""One filter for each kind of law: for how the loop carries a law on."""
SHARED = {name for name in FILTERS if shares_stages(name)}
WITHOUT_PARTICLES = {name for name in FILTERS if name.endswith(("KalmanFilter", "GaussHermiteFilter", "PointMassFilter", "common kernel"))}
"""Filters of which the native engine has nothing."""
ALL_BUT_ONE = set(FILTERS) - {"ParticleFilter"}


def each_of(filters, night=(), native=False):
    """Ask a question of filters, of those named by night; with the native engine of those that have stages in it, or of all."""
    return pytest.mark.parametrize("filter", _cases(filters, night, native))


def each_and(name, filters, settings):
    """Ask it with each setting of another argument; of those that a setting names, by night."""
    cases = [pytest.param(*case.values, value, id=f"{value}-{case.id}", marks=case.marks)
             for value, night in settings.items() for case in _cases(filters, night, False)]  # fmt: skip
    return pytest.mark.parametrize(("filter", name), cases)


def each_in_both_precisions(filters, night=(), double_by_night=(), native=False):
    """Ask it in float32 and float64; in float64 of those of the second list by night, and never with the native engine."""
    single, double = _cases(filters, night, native), _cases(filters, {*night, *double_by_night}, False, pytest.mark.jax)
    cases = [pytest.param(*case.values, precision, id=f"{precision}-{case.id}", marks=case.marks)
             for precision, some in (("float32", single), ("float64", double)) for case in some]  # fmt: skip
    return pytest.mark.parametrize(("filter", "precision"), cases, indirect=["precision"])


def _cases(filters, night, native, *marks):
    jax_alone = WITHOUT_PARTICLES | (set() if native else SHARED)
    return [pytest.param(*case.values, id=case.id, marks=[*case.marks, *marks, *[pytest.mark.jax] * (case.id in jax_alone)])
            for case in each(filters, night)]  # fmt: skip


def data(model, steps=STEPS, seed=5):
    return np.array(mo.simulate(seed, model, steps)[1])


def same_bits(a, b):
    left, right = jax.tree.leaves(a), jax.tree.leaves(b)
    assert len(left) == len(right)
    return all(np.array_equal(np.asarray(x), np.asarray(y), equal_nan=True) for x, y in zip(left, right, strict=True))


def likelihood(of):
    """Log likelihood of a history or stream; nothing for a filter that has none, which must refuse to tell one."""
    if getattr(of, "filter", of).has_evidence:
        return of.log_likelihood
    with pytest.raises(mo.MotesError, match="log_likelihood: expected a filter with a likelihood"):
        _ = of.log_likelihood
    return jnp.zeros(())


def test_every_filter_is_found_and_documented():
    assert len(filter_classes()) >= 6
    for cls in filter_classes().values():
        assert cls.__doc__ and cls.__module__ and all(cls.guide)
        assert getattr(mo, cls.__name__, cls) is cls


@each_in_both_precisions(FILTERS, double_by_night=VARIANTS)
def test_law_keeps_its_form(filter, precision):
    model = linear()
    engine = Engine(random.as_key(0), filter, model)
    y = jnp.asarray(data(model)[0])
    begun = jax.eval_shape(lambda y: engine.begin(y, None)[0], y)
    stepped = jax.eval_shape(lambda c, y: engine.step(c, y, None)[0], begun, y)
    assert jax.tree.structure(begun) == jax.tree.structure(stepped)
    assert [(x.shape, x.dtype) for x in jax.tree.leaves(begun)] == [(x.shape, x.dtype) for x in jax.tree.leaves(stepped)]
    assert all(x.dtype == precision for x in jax.tree.leaves(stepped.state) if jnp.issubdtype(x.dtype, jnp.floating))


@each_in_both_precisions(CLASSES, double_by_night=SHARED)
def test_law_answers(filter, precision):
    state = mo.run(1, filter, linear(), data(linear())).state
    assert state.mean().shape == (2,) and state.cov().shape == (2, 2)
    points = np.asarray(jax.jit(lambda state: state.sample(jax.random.key(0), 40_000))(state))
    assert points.shape == (2, 40_000)
    spread = np.sqrt(np.diag(np.asarray(state.cov())))
    # five standard errors of 40 000 draws
    assert np.all(np.abs(points.mean(axis=1) - np.asarray(state.mean())) < 5 * spread / 200 + 1e-6)
    assert np.allclose(np.cov(points), np.asarray(state.cov()), atol=0.05 * spread.max() ** 2)


@each_of({name: example(cls) for name, cls in filter_classes().items()}, SHARED)
def test_eager_equals_jitted(filter, double):
    model = linear()
    ys = data(model, 2)
    history = mo.run(7, filter, model, ys)
    engine = Engine(random.as_key(7), filter, model)
    with jax.disable_jit():
        carry, _ = engine.begin(jnp.asarray(ys[0]), None)
        for y in ys[1:]:
            carry, _ = engine.step(carry, jnp.asarray(y), None)
    assert np.allclose(carry.state.mean(), history.mean[-1], rtol=1e-9, atol=1e-9)
    assert np.allclose(carry.evidence.value(), likelihood(history), rtol=1e-9)


@pytest.mark.optimized
@each_in_both_precisions(FILTERS, SHARED, ALL_BUT_ONE, native=True)
def test_stream_draws_the_same_bits_as_run(filter, precision):
    model = linear()
    ys = data(model)
    ys[4] = np.nan
    ys[6, 0] = np.nan
    history = mo.run(3, filter, model, ys)
    stream = mo.stream(3, filter, model)
    means = []
    for t, y in enumerate(ys):
        if t:
            stream.predict()
        if not np.isnan(y).all():
            stream.update(y)
        elif filter.look_ahead:
            stream.update(y)
        means.append(np.asarray(stream.mean))
    assert same_bits(history.mean, np.stack(means))
    assert same_bits(history.state, stream.state)
    assert same_bits(likelihood(history), likelihood(stream))


@pytest.mark.optimized
@each_in_both_precisions(LAWS, double_by_night=ALL_BUT_ONE)
def test_cut_and_continued_equals_uncut(filter, precision):
    model = linear()
    ys = data(model)
    whole = mo.run(3, filter, model, ys)
    first = mo.run(3, filter, model, ys[: STEPS // 2])
    rest = mo.run(3, filter, model, ys[STEPS // 2 :], after=first)
    for pieces in ([first, rest], list(mo.run_in_chunks(3, filter, model, ys, chunk=STEPS // 2))):
        together = mo.joined(pieces)
        # how coarse numbers are is an average over the data of a piece
        assert np.all(together.rounding >= whole.rounding)
        assert same_bits(record.replace(together, rounding=whole.rounding), whole)


@pytest.mark.optimized
@each_of(LAWS)
def test_checkpoint_brings_back_the_same_bits(filter, tmp_path):
    model = linear()
    ys = data(model)
    whole = mo.run(3, filter, model, ys)
    stream = mo.stream(3, filter, model)
    stream.update(ys[0])
    for y in ys[1:6]:
        stream.predict()
        stream.update(y)
    again = mo.Stream.load(stream.save(tmp_path / "checkpoint.npz"), filter, model)
    for y in ys[6:]:
        again.predict()
        again.update(y)
    assert again.t == len(ys) - 1
    assert same_bits(again.state, whole.state)
    assert same_bits(likelihood(again), likelihood(whole))


@each_of(FILTERS, SHARED)
def test_vmap_over_keys(filter):
    model = linear()
    ys = jnp.asarray(data(model))
    keys = jax.random.split(jax.random.key(2), 3)
    together = jax.vmap(lambda key: mo.run(key, filter, model, ys))(keys)
    for i in range(3):
        alone = mo.run(keys[i], filter, model, ys)
        assert np.allclose(together.mean[i], alone.mean, atol=2e-3)
        assert not filter.has_evidence or np.allclose(together.log_likelihood[i], alone.log_likelihood, atol=2e-3)


@each_of(CLASSES, SHARED)
def test_vmap_over_models_and_data(filter):
    ys = jnp.stack([jnp.asarray(data(linear(), seed=seed)) for seed in (1, 2)])
    models = jax.tree.map(lambda *leaves: jnp.stack(leaves), linear(), linear(scale=2.0))

    def result(model, y):
        history = mo.run(4, filter, model, y)
        return likelihood(history), history.mean

    together = jax.vmap(result)(models, ys)
    for found, alone in zip(together, result(linear(scale=2.0), ys[1]), strict=True):
        assert np.allclose(found[1], alone, atol=2e-3)


@pytest.mark.optimized
@each_in_both_precisions(CLASSES, set(CLASSES) - set(LAWS) | SHARED, ALL_BUT_ONE)
def test_nothing_measured_is_predict_only(filter, precision):
    model = linear()
    key = random.as_key(9)
    ys = data(model, 3)
    carry = mo.run(9, filter, model, ys).last
    # the model must be an argument: compilers work closed-over constants out beforehand, with other rounding
    stepped, info = jax.jit(lambda m, c: Engine(key, filter, m).step(c, jnp.full((2,), jnp.nan, c.y.dtype), None))(model, carry)
    predicted = mo.run(9, filter, model, np.full((1, 2), np.nan), after=mo.run(9, filter, model, ys))
    assert same_bits(stepped.state, predicted.state)
    assert float(info.log_evidence) == 0 and not bool(info.collapsed)
    if isinstance(filter, mo.TwoStageFilter) and not filter.look_ahead:
        assert same_bits(jax.jit(lambda m, c: Engine(key, filter, m).move(c, None))(model, carry).state, stepped.state)


@each_of(FILTERS, SHARED)
def test_missing_components_equal_the_marginal_model(filter, double):
    """Patterns of NaN in six components: the update equals that of a model that never had those components (N7)."""
    full = linear(range(6))
    y = np.asarray(data(full, 1)[0])
    patterns = [np.flatnonzero(seen) for seen in product([0, 1], repeat=6)]

    def updated(model, values):
        carry, info = Engine(random.as_key(1), filter, model).begin(values, None)
        return carry.state.mean(), carry.state.cov(), info.log_evidence

    with_nan = np.full((64, 6), np.nan)
    for row, seen in zip(with_nan, patterns, strict=True):
        row[seen] = y[seen]
    results = jax.jit(jax.vmap(lambda values: updated(full, values)))(jnp.asarray(with_nan))
    for count in (1, 4):  # each number of components compiles anew
        rows = [i for i, seen in enumerate(patterns) if len(seen) == count]
        models = jax.tree.map(lambda *leaves: jnp.stack(leaves), *[linear(patterns[i]) for i in rows])
        expected = jax.jit(jax.vmap(updated))(models, jnp.stack([jnp.asarray(y[patterns[i]]) for i in rows]))
        for found, wanted in zip(results, expected, strict=True):
            assert np.allclose(np.asarray(found)[rows], wanted, rtol=1e-5, atol=1e-5)


@each_of(CLASSES)
def test_second_call_does_not_trace_again(filter):
    calls = []

    def f(x, u, t):
        calls.append(1)
        return jnp.array([0.9 * x[0], 0.7 * x[1]])

    base = linear()
    model = mo.StateSpaceModel(base.initial, mo.AdditiveGaussian(f, base.dynamics.Q), base.sensor, ("a", "b"))
    ys = data(base)
    mo.run(1, filter, model, ys)
    count = len(calls)
    assert count > 0
    compiled = running._run._cache_size()
    mo.run(2, filter, model, ys + 0.1)
    mo.run(2, type(filter)(**record.values(filter)), model, ys)
    # a function whose list grew, as f itself lets it, is looked at once more for each run, but not compiled
    assert len(calls) <= count + 2 and running._run._cache_size() == compiled


@each_and("policy", CLASSES, {"predict": (), "inflate": set(CLASSES) - set(LAWS)})
@pytest.mark.parametrize("size", [10.0, 1e3, 1e6])
def test_one_outlier_is_survived(filter, policy, size):
    """N5: after an outlier of many standard deviations everything stays finite and the error comes back under 3 sigma."""
    filter = record.replace(filter, on_collapse=policy)
    model = linear()
    xs, ys = (np.array(a) for a in mo.simulate(8, model, 40))
    ys[15] += size * np.array([1.0, -0.7])
    history = mo.run(2, filter, model, ys)
    assert all(np.isfinite(np.asarray(leaf)).all() for leaf in jax.tree.leaves((history.mean, history.cov)))
    if size > 1e2 and filter.has_evidence:  # a cost is never too high
        assert np.flatnonzero(np.asarray(history.info.collapsed)).tolist() == [15]
    exact = mo.run(2, mo.KalmanFilter(), model, ys[16:]) if size < 1e2 else mo.run(2, mo.KalmanFilter(on_collapse="predict"), model, ys)
    sigma = np.sqrt(np.diagonal(np.asarray(exact.cov)[-1]))
    error = np.asarray(history.mean)[35:] - xs[35:]
    if "SIS" not in repr(filter) and "Never" not in repr(filter):
        assert np.all(np.abs(error).mean(axis=0) < 3 * sigma)


@each_of(WITH_A_LIKELIHOOD)
def test_likelihood_is_that_of_the_kalman_filter(filter):
    """Unbiased: the mean ratio over 100 seeds, level 1e-6; 0.02 more for grids, and for kernels that widen a cloud."""
    filter = example(type(filter))
    model = linear()
    ys = jnp.asarray(data(model))
    exact = mo.run(0, mo.KalmanFilter(), model, ys).log_likelihood
    found = jax.vmap(lambda key: mo.run(key, filter, model, ys).log_likelihood)(jax.random.split(jax.random.key(11), 100))
    ratio = np.exp(np.asarray(found, np.float64) - float(exact))
    assert abs(ratio.mean() - 1) < 4.9 * ratio.std(ddof=1) / 10 + 0.02


@each_of(WITH_A_LIKELIHOOD)
def test_collapse_raises_and_names_the_step(filter):
    model = linear()
    ys = data(model)
    ys[7] += 1e6
    with pytest.raises(mo.CollapseError, match=r"step 7: (all weights vanished: log likelihoods between -.* and -|the innovation lies)"):
        mo.run(2, filter, model, ys)
    stream = mo.stream(2, filter, model)
    stream.update(ys[0])
    for y in ys[1:7]:
        stream.predict()
        stream.update(y)
    stream.predict()
    with pytest.raises(mo.CollapseError, match="step 7"):
        stream.update(ys[7])


def custom_likelihood(values):
    """A model whose log likelihood is given per region of the first state; all filters with weights can run it."""
    base = linear()

    def log_prob(y, x, u, t):
        return jnp.where(t == 2, values(x), -0.5 * jnp.sum((y - x) ** 2))

    return mo.StateSpaceModel(base.initial, base.dynamics, mo.Custom(log_prob=log_prob), ("a", "b"))


MOMENTS_ONLY = ("Kalman", "GaussHermite", "CostReference", "InteractingMultiple", "JumpMarkov", "MarginalizedParticleFilter, one state")
WEIGHTED = {name: f for name, f in FILTERS.items() if not any(word in name for word in MOMENTS_ONLY)}


@each_of(WEIGHTED, VARIANTS, native=True)
@pytest.mark.parametrize(
    ("case", "collapses"),
    [("all zero", True), ("all equal to -1e30", True), ("one infinite", True), ("one not a number", False)],
)
def test_extreme_weights_have_documented_outcomes(filter, case, collapses):
    """N6: never uniform weights in silence; every filter does the same and names the step."""
    values = {
        "all zero": lambda x: -jnp.inf,
        "all equal to -1e30": lambda x: -1e30,
        "one infinite": lambda x: jnp.where(x[0] > 1.0, jnp.inf, -1.0),
        "one not a number": lambda x: jnp.where(x[0] > 1.0, jnp.nan, -1.0),
    }[case]
    model = custom_likelihood(values)
    ys = data(linear(), 6)
    if collapses:
        with pytest.raises(mo.CollapseError, match="step 2"):
            mo.run(0, filter, model, ys)
        return
    history = mo.run(0, filter, model, ys)
    assert int(history.info.invalid[2]) > 0 and int(history.info.invalid[1]) == 0
    assert np.isfinite(np.asarray(history.mean)).all()


@each_of({name: example(cls) for name, cls in filter_classes().items()}, SHARED)
def test_smallest_sizes(filter):
    """N8: one and three particles; one state; more measurements than states; one step."""
    cls = type(filter)
    ys = data(linear(range(3)), 4)
    knobs_of = {field.name for field in dataclasses.fields(cls)}
    counts = [{"n": n} for n in (1, 3)] if "n" in knobs_of else [{}]
    for knobs in counts:
        filter = example(cls, **knobs, on_collapse="predict")
        history = mo.run(0, filter, linear(range(3)), ys)
        assert np.isfinite(np.asarray(history.mean)).all()
    assert mo.run(0, filter, linear(range(3)), ys[:1]).mean.shape == (1, 2)
    sensor = mo.LinearGaussian([[1.0], [0.5]], jnp.eye(2))
    scalar = mo.StateSpaceModel(mo.Gaussian([0.5], [[1.0]]), mo.LinearGaussian([[0.9]], [[0.5]]), sensor)
    grid = {"lower": (-9.0,), "upper": (9.0,), "nodes": (60,)} if "nodes" in knobs_of else {}
    assert mo.run(0, example(cls, **grid), scalar, np.ones((3, 2))).mean.shape == (3, 1)


@each_of(WITH_A_LIKELIHOOD, SHARED)
def test_likelihood_can_be_differentiated(filter, double):
    model = linear()
    ys = jnp.asarray(data(model, 4))

    def loss(scale):
        noisy = mo.LinearGaussian(model.sensor.A, scale * model.sensor.Q)
        return mo.run(0, filter, mo.StateSpaceModel(model.initial, model.dynamics, noisy, ("a", "b")), ys).log_likelihood

    assert np.isfinite(float(jax.grad(loss)(1.3)))


@each_of(FILTERS)
def test_filter_is_a_value(filter):
    again = record.replace(filter)
    assert again == filter and hash(again) == hash(filter) and type(filter).__name__ in repr(filter)
    with pytest.raises(mo.MotesError, match="on_collapse: expected one of 'raise', 'predict', 'inflate', got 'ignore'"):
        type(filter)(**{**record.values(filter), "on_collapse": "ignore"})
