"""Native kernels in double precision: functions, random numbers, programs and filters, all the numbers of JAX or of exact arithmetic."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import test_filters
import test_math
import test_translate
from native_tools import by_jax, natively, needs_compiler, ulps
from scipy import special

import motes as mo
from motes.core import engine, logspace, random
from motes.core.record import replace
from motes.laws.cloud import Cloud, weighted_moments
from motes.native import compile
from motes.native.rules import Untranslatable
from motes.resampling.policy import resample
from tiers import but_one_in, each

pytestmark = [needs_compiler, pytest.mark.usefixtures("double")]

OF_LIBRARIES = {
    "exp": (np.exp, None), "expm1": (np.expm1, 709), "log": (np.log, None), "log1p": (np.log1p, None), "sin": (np.sin, 1e6),
    "cos": (np.cos, 1e6), "tan": (np.tan, 1e6), "asin": (np.arcsin, 1), "acos": (np.arccos, 1), "atan": (np.arctan, None),
    "sinh": (np.sinh, 709), "cosh": (np.cosh, 709), "tanh": (np.tanh, None), "sqrt": (np.sqrt, None), "cbrt": (np.cbrt, None),
    "logistic": (lambda x: 1 / (1 + np.exp(-x)), 700), "rsqrt": (lambda x: 1 / np.sqrt(x), None), "floor": (np.floor, None),
    "round": (np.round, None), "sign": (np.sign, None),
}  # fmt: skip
"""Functions that NumPy has in extended precision, and how far to go."""
MOST = {"tan": 4, "tanh": 3, "asin": 4, "sinh": 4, "cosh": 4, "logistic": 3, "cbrt": 4}
WIDE = np.concatenate([np.linspace(-700, 700, 40_001), np.geomspace(1e-300, 1e300, 20_000), -np.geomspace(1e-300, 1e300, 20_000)])
POINTS = np.concatenate([WIDE, np.linspace(-1, 1, 50_001), test_math.EDGES])
ANGLES = np.concatenate([np.arange(-640_000, 640_000, 11) * (np.pi / 2), [1e5 * np.pi, 52174 * np.pi / 2]])


@pytest.mark.parametrize("name", each(list(OF_LIBRARIES), but_one_in(OF_LIBRARIES, 3)))
def test_functions_of_one_number(name):
    """Against extended precision, on all sides of where formulas change, and beside whole quarters of a turn."""
    exact, far = OF_LIBRARIES[name]
    points = np.concatenate([POINTS, ANGLES]) if name in ("sin", "cos", "tan") else POINTS
    points = points[~(np.abs(points) > (far or np.inf)) | np.isnan(points)]
    if name in ("rsqrt", "sqrt", "log"):
        points = np.abs(points)
    if name == "exp":
        points = points[~(points < -708)]  # results too small to be normal are zero
    (ours,) = natively(lambda x: [test_math.FUNCTIONS[name][0](x)], points[None])
    with np.errstate(all="ignore"):
        assert ulps(ours[0], exact(points.astype(np.longdouble))).max() <= MOST.get(name, 2)


def test_functions_of_two_numbers():
    both = np.random.default_rng(0).standard_cauchy((2, 100_000))
    edges = (0.0, -0.0, 1, -1, np.inf, -np.inf)
    both[:, :36] = np.array([[a, b] for a in edges for b in edges]).T
    both[:, 36:40] = np.array([[1e17, 0.7], [1.2e300, 1e308], [-1e22, np.pi], [1e308, 1e308]]).T
    cases = {
        "atan2": (lambda z: jnp.arctan2(z[:1], z[1:]), np.arctan2, 3), "rem": (lambda z: jax.lax.rem(z[:1], z[1:]), np.fmod, 0),
        "mod": (lambda z: jnp.mod(z[:1], z[1:]), None, 0), "inverse error function": (lambda z: jax.lax.erf_inv(z[:1] / 9),
                                   lambda y, x: special.erfinv(y.astype(float) / 9), 6),
    }  # fmt: skip
    for name, (function, exact, most) in cases.items():
        (ours,) = natively(lambda z, f=function: [jnp.concatenate([f(z), z[1:]])], both)
        with np.errstate(all="ignore"):
            wanted = np.asarray(function(jnp.asarray(both))[0]) if exact is None else exact(*both.astype(np.longdouble))
        assert ulps(ours[0], wanted).max() <= most, name


def test_whole_numbers_saturate():
    points = np.array([[0.5, -0.5, 3e9, -3e9, np.nan, np.inf, -np.inf, 7.9, 1e18, 1e19, -1e19]])
    for kind in (jnp.int32, jnp.int64):
        (ours,) = natively(lambda x, kind=kind: [x.astype(kind).astype(float)], points)
        assert np.array_equal(ours[0], np.asarray(jnp.asarray(points[0]).astype(kind).astype(float)))


def test_normal_numbers():
    """Same words on both engines, and the normal quantile of 64 bits, out to the last one."""
    for rows, n in ((1, 1024), (7, 30_001)):
        key = random.child(random.as_key(rows), 3)
        with engine.using("jax"):
            wanted = np.asarray(random.normal(key, (rows, n), jnp.float64))
            words = np.asarray(random._words(jax.random.key_data(key), (rows, n)))
        with engine.using("native"):
            ours = np.asarray(random.normal(key, (rows, n), jnp.float64))
        assert ours.dtype == np.float64 and ulps(ours, wanted).max() <= 8  # each within 4 of the exact one, whatever a JAX fuses
        bits = (words[0].astype(np.uint64) << np.uint64(32) | words[1]).view(np.int64)
        assert np.allclose(ours, np.sqrt(2) * special.erfinv(bits * 2.0**-63), rtol=1e-14, atol=1e-14)
    far = 1 - np.geomspace(2.0**-53, 1, 5000)
    whole = (far * 2.0**63).astype(np.int64).view(np.uint64)
    ours = random._to_normal_of_64(jnp.asarray(whole >> np.uint64(32), jnp.uint32), jnp.asarray(whole & np.uint64(0xFFFFFFFF), jnp.uint32))
    assert np.allclose(ours, -special.ndtri(0.5 * (1 - far)), rtol=1e-13, atol=1e-14)


def test_uniform_numbers_in_a_kernel_are_those_of_jax():
    key = random.as_key(5)
    (ours,) = natively(lambda x: [x * 0 + random.uniform(key, x.shape, jnp.float64)], np.zeros((3, 5000)))
    assert np.array_equal(ours, np.asarray(random.uniform(key, (3, 5000), jnp.float64)))


PROGRAMS = {name: program for name, program in test_translate.PROGRAMS.items() if name != "bits"} | {
    "bits": test_translate.over(lambda x: jax.lax.bitcast_convert_type(jax.lax.bitcast_convert_type(x, jnp.int64) & -4096, jnp.float64)),
    "long whole numbers": test_translate.over(
        lambda x: x + ((1e12 * x).astype(jnp.int64) // 7 >> 3) % 1000 + jnp.argmax(x) + (jnp.abs(1e15 * x).astype(int) << 5) % 97
    ),
    "table of single precision": test_translate.over(lambda x: test_translate.HEIGHTS[(3 * x[0]).astype(int), 2].astype(jnp.float32) + x),
}


@pytest.mark.parametrize("name", each(list(PROGRAMS), but_one_in(PROGRAMS, 4)))
def test_same_numbers_as_jax(name):
    X = test_translate.X.astype(np.float64) * (1 + 1e-9)  # not numbers of single precision
    ours, wanted = natively(PROGRAMS[name], X)[0], by_jax(PROGRAMS[name], X)[0]
    assert ours.dtype == wanted.dtype == np.float64 and np.array_equal(np.isnan(ours), np.isnan(wanted))
    tolerance = 3e-13 if name in ("exponential", "interpolated", "determinant") else 1e-14
    assert np.allclose(ours, wanted, rtol=tolerance, atol=tolerance, equal_nan=True)


@pytest.mark.skipif(not compile.compiler() or "g++" not in compile.compiler()[0], reason="asks g++ what it did")
@pytest.mark.parametrize("name", each([name for name in test_translate.PROGRAMS if name != "bits"], lambda name: name != "table"))
def test_loops_over_particles_are_vectorized(name, monkeypatch, tmp_path):
    test_translate.test_loops_over_particles_are_vectorized(name, monkeypatch, tmp_path)


def test_random_numbers_of_another_precision_are_refused():
    with pytest.raises(Untranslatable, match="float32"):
        natively(lambda X: [X + random.normal(random.as_key(0), X.shape, jnp.float32)], np.zeros((2, 3000)))


@pytest.mark.parametrize("n", each([300, 5000], {"300"}))
def test_weights_ancestors_moments(n):
    """Every kernel without a model, to the digits of double precision."""
    generator = np.random.default_rng(n)
    weights = jax.nn.log_softmax(jnp.asarray(3 * generator.normal(size=n)))
    points, likelihood = jnp.asarray(generator.normal(size=(4, n)) + 1e6), jnp.asarray(generator.normal(size=n))
    found = {}
    for name in ("jax", "native"):
        with engine.using(name):
            law = replace(Cloud.equal(points), log_weights=weights)
            law = resample(random.as_key(4), mo.resampling.Systematic(), mo.resampling.Always(), law)
            joint = logspace.joint_weights(weights, likelihood, jnp.inf)
            found[name] = [*weighted_moments(weights, points), law.particles, law.log_weights, *joint]
    for ours, wanted in zip(found["native"], found["jax"], strict=True):
        assert ours.dtype == jnp.float64 and np.allclose(ours, wanted, rtol=1e-9, atol=1e-9)


DYNAMICS = {name: test_filters.MODELS[name].dynamics for name in ("linear dynamics", "turning", "substeps")}


def model_of(name):
    initial = mo.Gaussian([300.0, 300, 5, -5, 0, 0], np.diag([400.0, 400, 16, 16, 0.04, 0.04]))
    sensor = mo.AdditiveGaussian(test_filters.bearing, np.array([[100, 0.01], [0.01, 1e-4]]), angles=(1,))
    return mo.StateSpaceModel(initial, DYNAMICS[name], sensor)


@pytest.mark.parametrize("kind", test_filters.FILTERS)
@pytest.mark.parametrize("name", each(list(DYNAMICS), {"turning", "substeps"}))
def test_histories_of_filters(kind, name):
    """Roundings of double precision choose no other ancestor here: all the numbers of JAX, and those of a run in parts."""
    filter, model = test_filters.FILTERS[kind](n=3000), model_of(name)
    with mo.engine("jax"):
        wanted = mo.run(5, filter, model, test_filters.YS)
    ours = mo.run(5, filter, model, test_filters.YS)
    assert wanted.engine == "jax" and ours.engine == "native" and ours.mean.dtype == np.float64
    for field in ("mean", "cov", "log_evidence", "ess"):
        assert np.allclose(getattr(ours, field), getattr(wanted, field), rtol=1e-8, atol=1e-8), field
    stream = mo.stream(5, filter, model)
    stream.update(test_filters.YS[0])
    for y in test_filters.YS[1:]:
        stream.predict()
        stream.update(y)
    assert np.array_equal(stream.mean, ours.mean[-1]) and np.array_equal(stream.cov, ours.cov[-1])


def test_explanation():
    said = mo.explain(mo.ParticleFilter(n=3000), model_of("linear dynamics"))
    assert "fused" in str(said) and "float64" not in str(said)
