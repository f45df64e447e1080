"""Filters on the native engine: the results of JAX, the same bits in every way of running, and a quiet way out where it cannot run."""

import os
import re
import subprocess
import sys
from importlib.util import find_spec

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from native_tools import needs_compiler

import motes as mo
from tiers import each

T = 0.5
A = np.eye(6) + T * np.eye(6, k=2) + T * T / 2 * np.eye(6, k=4)
NAMES = ("px", "py", "vx", "vy", "ax", "ay")


def bearing(x, u, t):
    return jnp.array([jnp.hypot(x[0], x[1]), jnp.arctan2(x[1], x[0])])


def turn(x, u, t):
    angle = 0.1 * jnp.tanh(x[0] / 1000)
    rotation = jnp.array([[jnp.cos(angle), -jnp.sin(angle)], [jnp.sin(angle), jnp.cos(angle)]])
    return (jnp.asarray(A, x.dtype) @ x).at[2:4].set(rotation @ x[2:4])


Q = np.diag([1, 1, 1, 1, 0.01, 0.01])
CROSSED = Q + 0.05 * np.eye(6, k=2) + 0.05 * np.eye(6, k=-2)
INITIAL = mo.Gaussian([300.0, 300, 5, -5, 0, 0], np.diag([400.0, 400, 16, 16, 0.04, 0.04]))
SENSOR = mo.AdditiveGaussian(bearing, np.array([[100, 0.01], [0.01, 1e-4]]), angles=(1,))
RADAR = mo.StateSpaceModel(INITIAL, mo.LinearGaussian(A, Q), SENSOR, NAMES)
KNOTS, BUMPS = jnp.linspace(0, 600, 61), jnp.asarray(np.random.default_rng(7).normal(size=61), jnp.float32)
MODELS = {
    "linear dynamics": RADAR,
    "correlated noises": mo.StateSpaceModel(INITIAL, mo.LinearGaussian(A, CROSSED), SENSOR, NAMES),
    "turning": mo.StateSpaceModel(INITIAL, mo.AdditiveGaussian(turn, CROSSED), SENSOR, NAMES),
    "range-dependent noise": mo.StateSpaceModel(
        INITIAL, mo.LinearGaussian(A, Q),
        mo.AdditiveGaussian(bearing, lambda x, u, t: jnp.diag(jnp.array([100.0, 1e-4]) * (1 + x[0] ** 2 / 1e6)), angles=(1,)), NAMES),
    "outliers": mo.StateSpaceModel(INITIAL, mo.LinearGaussian(A, Q),
                                   mo.AdditiveNoise(bearing, mo.StudentT(np.array([10.0, 0.01]), 4.0), angles=(1,)), NAMES),
    "substeps": mo.StateSpaceModel(
        INITIAL,
        mo.AdditiveGaussian(lambda x, u, t: jax.lax.fori_loop(0, 5, lambda i, x: x + T / 5 * (jnp.eye(6, k=2) @ jnp.sin(x)), x), Q),
        mo.AdditiveGaussian(lambda x, u, t: bearing(x, u, t) + jnp.array([10.0, 0]) * jnp.interp(x[0], KNOTS, BUMPS), SENSOR.Q), NAMES),
    "measured and hidden": mo.StateSpaceModel(INITIAL, mo.LinearGaussian(A, Q), mo.LinearGaussian(np.eye(2, 6) + np.eye(2, 6, k=2),
                                                                                                  np.diag([9.0, 4.0])), NAMES),
}  # fmt: skip
YS = np.array(mo.simulate(3, RADAR, 12)[1])
YS[4, 0] = np.nan
YS[7] = np.nan
FILTERS = {"bootstrap": mo.ParticleFilter, "marginalized": mo.MarginalizedParticleFilter}


def runs(filter, model, ys=YS, key=5, **options):
    with mo.engine("jax"):
        one = mo.run(key, filter, model, ys, **options)
    with mo.engine("native"):
        return one, mo.run(key, filter, model, ys, **options)


@needs_compiler
@pytest.mark.parametrize("kind", FILTERS)
@pytest.mark.parametrize("name", each(list(MODELS), set(MODELS) - {"substeps"}))
def test_results_of_jax_without_resampling(kind, name):
    """Nothing is chaotic without resampling: every number of the history agrees."""
    filter = FILTERS[kind](n=1500, policy=mo.resampling.Never(), on_collapse="predict")
    wanted, ours = runs(filter, MODELS[name])
    assert wanted.engine == "jax" and ours.engine == "native"
    spread = np.sqrt(np.diagonal(wanted.cov, axis1=1, axis2=2)) + 1e-3
    assert np.abs((ours.mean - wanted.mean) / spread).max() < 2e-3
    assert np.abs((ours.cov - wanted.cov) / spread[:, :, None] / spread[:, None]).max() < 5e-3
    assert np.allclose(ours.log_evidence, wanted.log_evidence, atol=2e-3)
    assert np.allclose(ours.ess, wanted.ess, rtol=5e-3)
    for field in ("lowest", "highest"):
        assert np.allclose(getattr(ours.info, field), getattr(wanted.info, field), rtol=1e-3, atol=2e-3)


@needs_compiler
@pytest.mark.parametrize(
    "policy",
    each(
        [mo.resampling.Always(), mo.resampling.ESS(0.5), mo.resampling.Entropy(0.7)],
        {str(mo.resampling.Always()), str(mo.resampling.Entropy(0.7))},
    ),
)
@pytest.mark.parametrize("kind", each(list(FILTERS), {"bootstrap"}))
def test_likelihood_of_jax_with_resampling(kind, policy):
    """After resampling a rounding here and there gives another ancestor: results agree within Monte Carlo error, at first to rounding."""
    filter = FILTERS[kind](n=20_000, policy=policy)
    pairs = [runs(filter, RADAR, key=key) for key in range(8)]
    # the log likelihood of a step spreads by at most 0.09 (bootstrap) and 0.037 (marginalized): 5.5 times that of a difference of means
    limit = {"bootstrap": 0.25, "marginalized": 0.1}[kind]
    assert np.abs(np.mean([ours.log_evidence - wanted.log_evidence for wanted, ours in pairs], axis=0)).max() < limit
    wanted, ours = pairs[0]
    assert np.allclose(ours.ess, wanted.ess, rtol=0.3) and np.allclose(ours.ess[:2], wanted.ess[:2], rtol=2e-3)
    assert np.abs(ours.mean[0] - wanted.mean[0]).max() < 1e-3


@needs_compiler
@pytest.mark.parametrize("model", each(["linear dynamics", "turning"], {"linear dynamics"}))
@pytest.mark.parametrize("kind", each(list(FILTERS), {"bootstrap"}))
def test_same_bits_however_it_runs(kind, model):
    filter, model = FILTERS[kind](n=7000), MODELS[model]
    with mo.engine("native"):
        whole = mo.run(5, filter, model, YS)
        stream = mo.stream(5, filter, model)
        stream.update(YS[0])
        for y in YS[1:]:
            stream.predict()
            stream.update(y)
        last = stream.mean, stream.cov
        keys = jax.random.split(jax.random.key(9), 3)
        many = jax.vmap(lambda key: mo.run(key, filter, model, YS).mean)(keys)
        each = [mo.run(key, filter, model, YS).mean for key in keys]
        scaled = jax.vmap(lambda ys: mo.run(5, filter, model, ys).mean)(np.stack([YS + 0.5, YS]))
    assert np.array_equal(last[0], whole.mean[-1]) and np.array_equal(last[1], whole.cov[-1])
    assert np.array_equal(many, each) and np.array_equal(scaled[1], whole.mean)
    assert whole.engine == "native" and not np.array_equal(scaled[0], scaled[1])


@pytest.mark.night
@needs_compiler
@pytest.mark.parametrize("kind", each(list(FILTERS), {"marginalized"}))
def test_gradients_are_those_of_jax(kind):
    filter = FILTERS[kind](n=600, policy=mo.resampling.Never())

    def score(scale):
        model = mo.StateSpaceModel(INITIAL, mo.LinearGaussian(A, scale * Q), SENSOR, NAMES)
        return mo.run(5, filter, model, YS[:4]).log_likelihood

    wanted = jax.value_and_grad(score)(1.3)
    with mo.engine("native"):
        ours = jax.value_and_grad(score)(1.3)
    assert np.allclose(ours, wanted, rtol=2e-3) and abs(wanted[1]) > 0.01


@pytest.mark.night
@needs_compiler
def test_collapse_is_seen():
    ys = YS.copy()
    ys[3] = [1e7, 0.0]
    for policy in ("predict", "inflate"):
        wanted, ours = runs(mo.ParticleFilter(n=1000, on_collapse=policy), RADAR, ys)
        assert np.array_equal(ours.info.collapsed, wanted.info.collapsed) and bool(ours.info.collapsed[3])
        assert np.isfinite(ours.mean).all()
    with mo.engine("native"), pytest.raises(mo.CollapseError, match="step 3"):
        mo.run(5, mo.ParticleFilter(n=1000), RADAR, ys)


@needs_compiler
def test_likelihoods_that_are_no_numbers_get_no_weight():
    sensor = mo.AdditiveGaussian(lambda x, u, t: jnp.where(x[:1] > 0, x[:1], jnp.nan), [[1.0]])
    model = mo.StateSpaceModel(mo.Gaussian([0.5], [[1.0]]), mo.LinearGaussian([[0.9]], [[1.0]]), sensor)
    wanted, ours = runs(mo.ParticleFilter(n=5000, policy=mo.resampling.Never()), model, np.ones((4, 1)))
    assert np.array_equal(ours.info.invalid, wanted.info.invalid) and int(ours.info.invalid[0]) > 1000
    assert np.allclose(ours.mean, wanted.mean, atol=1e-4)


@needs_compiler
def test_what_runs_is_explained():
    with mo.engine("jax"):
        text = str(mo.explain(mo.ParticleFilter(n=1000), RADAR))
    assert "move" in text and "native, fused" in text and "engine in force   jax\nby default:" in text
    assert "engine in force   auto\n  move" in str(mo.explain(mo.ParticleFilter(n=1000), RADAR))
    stages = dict(mo.explain(mo.ParticleFilter(n=1000, scheme=mo.resampling.Stratified()), RADAR).stages)
    assert stages["move"] == "native kernels around JAX: Stratified resampling" and stages["weigh"].startswith("native, fused")
    stages = dict(mo.explain(mo.ParticleFilter(n=1000, scheme=mo.resampling.StopGradient()), RADAR).stages)
    assert stages["move"] == "native kernels around JAX: StopGradient resampling"
    looping = mo.AdditiveGaussian(lambda x, u, t: jax.lax.while_loop(lambda z: z[0] < 0, lambda z: z + 1, x)[:1], [[1.0]])
    stages = dict(mo.explain(mo.ParticleFilter(n=1000), mo.StateSpaceModel(INITIAL, mo.LinearGaussian(A, Q), looping)).stages)
    line = test_what_runs_is_explained.__code__.co_firstlineno
    assert re.search(r"while: .* \(test_filters.py, line (\d+)\)$", stages["weigh"]), stages["weigh"]
    assert line < int(re.search(r"line (\d+)", stages["weigh"]).group(1)) < line + 20
    assert "fewer than" in str(mo.explain(mo.ParticleFilter(n=10), RADAR))
    assert "no stage" in str(mo.explain(mo.KalmanFilter(), MODELS["measured and hidden"]))


@needs_compiler
@needs_compiler
def test_a_sampler_of_the_users_own():
    """With a key for each particle, split at will: the numbers of JAX."""

    def jumping(key, x, u, t):
        first, second = jax.random.split(key)
        return A @ x + jnp.where(jax.random.bernoulli(first, 0.1), 5.0, 1.0) * jax.random.normal(second, (6,))

    model = mo.StateSpaceModel(INITIAL, mo.Custom(sample=jumping), SENSOR, NAMES)
    wanted, ours = runs(mo.ParticleFilter(n=2000, policy=mo.resampling.Never()), model)
    assert ours.engine == "native" and np.allclose(ours.mean, wanted.mean, rtol=1e-3, atol=1e-2)


@needs_compiler
def test_models_that_do_not_translate_run_all_the_same():
    """A loop whose turns are not known: JAX moves, native kernels resample and weigh; without resampling nothing differs."""

    def slowed(x, u, t):
        return jax.lax.while_loop(lambda x: jnp.hypot(x[2], x[3]) > 20, lambda x: x.at[2:4].multiply(0.9), jnp.asarray(A, x.dtype) @ x)

    step = mo.AdditiveGaussian(slowed, Q)
    wanted, ours = runs(mo.ParticleFilter(n=2000, policy=mo.resampling.Never()), mo.StateSpaceModel(INITIAL, step, SENSOR, NAMES))
    assert ours.engine == "native in part" and np.allclose(ours.mean, wanted.mean, rtol=1e-3, atol=1e-2)


def test_unknown_engines_are_refused(monkeypatch):
    with pytest.raises(mo.MotesError, match="engine: expected one of 'auto', 'jax', 'native', got 'cuda'"), mo.engine("cuda"):
        pass
    monkeypatch.setenv("MOTES_ENGINE", "fast")
    with pytest.raises(mo.MotesError, match="MOTES_ENGINE: expected one of 'auto', 'jax', 'native', got 'fast'"):
        mo.run(0, mo.ParticleFilter(n=300), RADAR, YS[:2])


WITHOUT = """
import motes as mo, numpy as np
model = mo.StateSpaceModel(mo.Gaussian([0.0], [[1.0]]), mo.LinearGaussian([[0.9]], [[1.0]]), mo.LinearGaussian([[1.0]], [[1.0]]))
filter = mo.ParticleFilter(n=1000)
print(mo.run(0, filter, model, np.zeros((3, 1))).engine)
print(mo.explain(filter, model))
"""


@needs_compiler
@pytest.mark.parametrize("filter, wanted", [
    (mo.ParticleFilter(n=1000), "native"), pytest.param(mo.MarginalizedParticleFilter(n=1000), "native", marks=pytest.mark.night),
    (mo.ParticleFilter(n=1000, scheme=mo.resampling.Stratified()), "native in part"), (mo.KalmanFilter(), "jax"),
    pytest.param(mo.ParticleFilter(n=999), "jax", marks=pytest.mark.night),
    pytest.param(mo.AuxiliaryParticleFilter(n=1000), "native in part", marks=pytest.mark.night),
])  # fmt: skip
def test_the_engine_is_chosen_by_what_is_run(filter, wanted):
    """The same for a stream; and the numbers are those of the engine that was chosen."""
    model = MODELS["measured and hidden"]
    found = mo.run(5, filter, model, YS[:5])
    assert found.engine == wanted
    stream = mo.stream(5, filter, model)
    stream.update(YS[0])
    for y in YS[1:5]:
        stream.predict()
        stream.update(y)
    assert np.array_equal(stream.mean, found.mean[-1]) and np.array_equal(stream.cov, found.cov[-1])
    if wanted != "native in part":
        with mo.engine(wanted):
            assert np.array_equal(mo.run(5, filter, model, YS[:5]).mean, found.mean)


@pytest.mark.parametrize("compiler, reason", [
    ("", "no C++ compiler"), pytest.param("false", "the C++ compiler refused", marks=pytest.mark.night)])  # fmt: skip
def test_without_a_compiler_jax_does_the_work(compiler, reason, tmp_path):
    if not compiler and find_spec("ziglang"):
        pytest.skip("there is a compiler: the package ziglang")
    path = "" if not compiler else os.path.dirname(subprocess.run(["which", "false"], capture_output=True, text=True).stdout)
    surroundings = os.environ | {"PATH": path, "CXX": compiler, "MOTES_ENGINE": "native", "XDG_CACHE_HOME": str(tmp_path)}
    done = subprocess.run([sys.executable, "-c", WITHOUT], capture_output=True, text=True, timeout=120, env=surroundings)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("jax\n") and reason in done.stdout


@needs_compiler
def test_zeros_in_a_matrix_of_dynamics_shorten_the_kernel():
    def operations(A):
        model = mo.StateSpaceModel(mo.Gaussian(jnp.zeros(3), jnp.eye(3)), mo.LinearGaussian(A, jnp.eye(3)),
                                   mo.AdditiveGaussian(lambda x, u, t: jnp.sin(x[:1]), [[0.1]]))  # fmt: skip
        stages = dict(mo.explain(mo.ParticleFilter(n=2000), model).stages)
        return int(stages["move"].split()[2])

    assert operations(np.tri(3)) < operations(np.ones((3, 3)))
    assert operations(np.eye(3)) < operations(np.tri(3))
