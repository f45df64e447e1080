"""Filters in elements: the same bits on any number of devices, little between these, as good as one filter of all particles."""

import json
import os
import subprocess
import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import motes as mo
from motes.core import random
from motes.core.devices import Crew
from motes.laws.elements import ElementCloud, ElementMarginalCloud, masses
from motes.resampling.allotment import allotted, ends_of, parents_of
from motes.resampling.schemes import Systematic
from quick import known
from tiers import each

pytestmark = pytest.mark.filterwarnings("ignore::motes.core.checks.MotesWarning")

FLAGS = ("--xla_force_host_platform_device_count=8", "--xla_backend_optimization_level=0", "--xla_cpu_parallel_codegen_split_count=1",
         "--xla_llvm_disable_expensive_passes=true")  # fmt: skip
"""Eight devices, quickly compiled."""
EXCHANGES = {"Proportional": mo.Proportional(), "Ring": mo.Ring(0.1), "Butterfly": mo.Butterfly(0.25), "Apart": mo.Apart()}
BOTH = [(name, exchange) for name in ("particle", "marginalized") for exchange in EXCHANGES]
GRID = {
    "by day": [["particle", 64, "Proportional", [8]], ["bytes", 65_536], ["chains"], ["messages"]],
    "derivatives": [["derivatives", "Ring"], ["derivatives", "Proportional"], ["derivatives", "Butterfly"]],
    **{f"{name}, {exchange}": [[name, 1_024, exchange, [2, 4, 8]]] for name, exchange in BOTH},
    # from 1 000 particles of an element on, native kernels work
    **{f"native {name}, {exchange}": [[name, 16_384, exchange, [2, 4, 8]]] for name, exchange in BOTH},
    "look-ahead": [["proposal", 1_024, "Proportional", [2, 8]], ["proposal", 1_024, "Ring", [2, 8]]],
}
GROWTH = mo.textbook.growth()
YS = mo.simulate(0, GROWTH, 12)[1]


def on_devices(cases):
    """What the program with eight devices says."""
    program = Path(__file__).with_name("elements_on_devices.py")
    done = subprocess.run([sys.executable, str(program), json.dumps(cases)], capture_output=True, text=True, timeout=1_800,
                          env=os.environ | {"XLA_FLAGS": " ".join(known(FLAGS)), "JAX_PLATFORMS": "cpu"}, check=False)  # fmt: skip
    assert done.returncode == 0, done.stderr[-2_000:]
    return json.loads(done.stdout.splitlines()[-1])


@pytest.mark.parametrize("cases", each(GRID, night=lambda name: name != "by day"))
def test_devices_change_no_bit_and_exchange_little(cases):
    for case, answer in zip(cases, on_devices(cases), strict=True):
        if case[0] != "bytes":
            assert answer == [], case
            continue
        n, elements, particle = case[1], 8, 6 * 4
        strips = 2 * 16 * int(n**0.5) * (particle + 4)
        assert answer["own"] == strips
        assert answer["all"] <= strips + 24 * elements
        assert answer["largest"] < n * particle / elements and answer["whole blocks"] == 1


@pytest.mark.parametrize("exchange", EXCHANGES.values(), ids=EXCHANGES)
def test_no_particle_is_lost_or_doubled_by_an_exchange(exchange):
    """The law is a cloud whose ancestors are of all particles."""
    filter = mo.Distributed(mo.ParticleFilter(n=64, policy=mo.resampling.Never()), 4, exchange)
    law = mo.run(0, filter, GROWTH, YS[:4], keep=mo.keep.laws).law
    assert isinstance(law, ElementCloud) and law.particles.shape == (4, 1, 64)
    assert np.array_equal(np.sort(law.ancestors, axis=1), np.broadcast_to(np.arange(64), (4, 64)))
    np.testing.assert_allclose(np.exp(law.log_weights).sum(axis=1), 1, rtol=1e-5)
    moved = np.mean(np.asarray(law.ancestors)[2] != np.arange(64))
    assert (moved == 0) == isinstance(exchange, (mo.Proportional, mo.Apart))


def test_the_comb_is_that_of_systematic_resampling():
    """With the same uniform number, elements give the children that one filter gives, also where some have no mass."""
    weights = np.random.default_rng(0).gamma(0.3, size=4_096)
    weights[1_024:1_536] = 0
    log_weights = jnp.log(jnp.asarray(weights / weights.sum(), jnp.float32))
    cut = log_weights.reshape(8, 512)
    found = masses(cut)
    for u in (0.0, 0.37, 0.999):
        shares = allotted(found.sums.weights, jnp.float32(u), 4_096)
        ends = ends_of(Crew(8, 1), cut, found.log, shares, jnp.float32(u)).reshape(-1)
        parents = np.asarray(parents_of(ends, 0, 4_096))
        whole = np.asarray(Systematic().at(jnp.float32(u), log_weights, 4_096))
        counts, alone = (np.bincount(found, minlength=4_096) for found in (parents, whole))
        assert np.mean(parents != whole) < 0.01 and np.abs(counts - alone).max() <= 1
        assert weights[parents].min() > 0 and np.all(np.diff(parents) >= 0)
        with mo.engine("native"):
            native = masses(cut)
            np.testing.assert_allclose(native.log, found.log, rtol=1e-5)
            ends = ends_of(Crew(8, 1), cut, native.log, allotted(native.sums.weights, jnp.float32(u), 4_096), jnp.float32(u)).reshape(-1)
            assert np.mean(np.asarray(parents_of(ends, 0, 4_096)) != parents) < 0.01


def test_an_element_without_mass_gets_no_child():
    """Also the last one, where the sizes of those before it do not sum up to n in float32."""
    masses = np.random.default_rng(0).dirichlet(np.ones(5), 4_000) @ np.eye(5, 8)[:, [0, 1, 5, 2, 3, 4, 6, 7]]
    u = np.random.default_rng(1).random(4_000, np.float32)
    start = jax.vmap(lambda mass, u: allotted(mass, u, 2**23).start)(jnp.asarray(masses, jnp.float32), u)
    assert np.all(np.diff(start, axis=1)[:, [2, 6, 7]] == 0) and np.all(start[:, 0] == 0) and np.all(start[:, -1] == 2**23)


def test_moments_are_those_of_the_whole_cloud():
    history = mo.run(0, mo.Distributed(mo.ParticleFilter(n=256), 4), GROWTH, YS, keep=mo.keep.laws)
    plain = jax.tree.map(lambda leaf: leaf[-1], history.law).plain
    np.testing.assert_allclose(history.mean[-1], plain.mean(), rtol=1e-4)
    np.testing.assert_allclose(history.cov[-1], plain.cov(), rtol=1e-3)


@pytest.mark.night
def test_angles_are_gathered_over_all_elements():
    step, sensor = (mo.AdditiveGaussian(f, 0.1 * jnp.eye(1), (0,)) for f in (lambda x, u, t: x + 0.1, lambda x, u, t: x))
    turning = mo.StateSpaceModel(mo.Gaussian(jnp.array([3.1]), jnp.eye(1)), step, sensor)
    ys = mo.simulate(0, turning, 11)[1]
    plain, found = (mo.run(0, filter, turning, ys) for filter in (mo.ParticleFilter(n=256), mo.Distributed(mo.ParticleFilter(n=256), 4)))
    apart = np.asarray(found.mean - plain.mean)
    assert np.abs((apart + np.pi) % (2 * np.pi) - np.pi).max() < 0.3


@pytest.mark.night
def test_particles_carry_their_gaussians_along():
    radar = mo.textbook.radar_tracking()
    ys = mo.simulate(0, radar, 4)[1]
    plain, found = (mo.run(0, filter, radar, ys) for filter in (mo.MarginalizedParticleFilter(n=512),
                    mo.Distributed(mo.MarginalizedParticleFilter(n=512), 2, mo.Ring(0.25))))  # fmt: skip
    assert isinstance(found.state, ElementMarginalCloud) and found.state.kalman.center.shape == plain.state.kalman.center.shape
    np.testing.assert_allclose(found.mean, plain.mean, atol=4 * np.sqrt(np.asarray(plain.cov).max()))


def test_it_can_be_wrapped():
    near = lambda key, y, u, t: jnp.sqrt(jnp.abs(20 * y))  # noqa: E731
    history = mo.run(0, mo.Recovering(mo.Distributed(mo.ParticleFilter(n=64), 4), near), GROWTH, YS)
    assert np.all(np.isfinite(history.mean))


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (lambda: mo.Distributed(3), "Distributed filter: expected a filter"),
        (lambda: mo.Distributed(mo.KalmanFilter()), "Distributed filter: expected one that moves and weighs a cloud .*KalmanFilter"),
        (lambda: mo.Distributed(mo.ParticleFilter(n=100), 8), "Distributed elements: expected a divisor of the filter's n=100, got 8"),
        (lambda: mo.Distributed(mo.ParticleFilter(n=100), 0), "Distributed elements: expected a whole number"),
        (lambda: mo.Distributed(mo.ParticleFilter(n=80), exchange="ring"), "Distributed exchange: expected an exchange such as"),
        (lambda: mo.Distributed(mo.ParticleFilter(n=60), 6, mo.Butterfly()), "Distributed elements: expected a power of two"),
        (lambda: mo.Distributed(mo.ParticleFilter(n=80, scheme=mo.resampling.Residual())), "scheme: expected Systematic, for Proportional"),
        (lambda: mo.Distributed(mo.MarginalizedParticleFilter(n=80, regularization=mo.resampling.Regularization())),
         "Distributed filter: expected one that resamples by scheme and policy, for Proportional"),
        (lambda: mo.Ring(0.6), "Ring share: expected a number above 0"),
        (lambda: mo.Butterfly("a"), "Butterfly share: expected a number above 0"),
        (lambda: mo.devices(0), "devices count: expected a whole number"),
        (lambda: mo.devices(1_000), "devices count: expected at most"),
        (lambda: mo.run(0, mo.Distributed(mo.GaussianSumParticleFilter(n=80, mixands=4), exchange=mo.Ring()), GROWTH, YS),
         "Distributed filter: expected one that moves and weighs a cloud .*whose law is a"),
    ],
)  # fmt: skip
def test_what_it_refuses(build, message):
    with pytest.raises(mo.MotesError, match=message) as reason:
        build()
    assert "\n" not in str(reason.value)


K, SEEDS = 16, 200


def milder_radar():
    model = mo.textbook.radar_tracking()
    return mo.replace(model, sensor=mo.replace(model.sensor, Q=jnp.diag(jnp.array([100.0, 1e-4]))))


def errors_and_evidence(filter, model, keys, xs, ys, rows):
    """Root mean square errors and log likelihoods of many runs."""
    one = lambda key, y: (lambda h: (h.mean, h.log_likelihood))(mo.run(key, filter, model, y, keep=mo.keep.means))  # noqa: E731
    means, evidence = jax.jit(jax.vmap(one))(keys, ys)
    return np.sqrt(np.mean((np.asarray(means) - np.asarray(xs))[..., :rows] ** 2 * rows)), np.asarray(evidence)


@pytest.mark.night
@pytest.mark.parametrize(("model", "n", "steps", "rows"), [(GROWTH, 1_024, 50, 1), (milder_radar(), 2_048, 40, 2)], ids=["growth", "radar"])
def test_elements_are_as_good_as_one_filter(model, n, steps, rows):
    """K = 16: RMSE and spread of the log likelihood beside those of the single filter of as many particles."""
    xs, ys = jax.vmap(lambda key: mo.simulate(key, model, steps))(random.step_keys(jax.random.key(7), SEEDS))
    keys = random.step_keys(jax.random.key(8), SEEDS)
    going_on = mo.ParticleFilter(n=n, on_collapse="predict")
    large = mo.ParticleFilter(n=64 * n, on_collapse="predict")
    best = jax.jit(lambda a: jax.lax.map(lambda a: mo.run(a[0], large, model, a[1], keep=mo.keep.nothing).log_likelihood, a))((keys, ys))

    def asked(filter):
        error, evidence = errors_and_evidence(filter, model, keys, xs, ys, rows)
        return error, np.subtract(*np.percentile(evidence - np.asarray(best), [75, 25]))

    error, spread = asked(going_on)
    for exchange, worse, wider in ((mo.Proportional(), 1.01, 1.3), (mo.Ring(0.1), 1.02, 1.6)):
        found = asked(mo.Distributed(going_on, K, exchange))
        assert found[0] < worse * error and found[1] < wider * spread, (exchange, found[0] / error, found[1] / spread)
    apart = asked(mo.Distributed(going_on, K, mo.Apart()))
    assert apart[0] > error and apart[1] > 1.3 * spread


@pytest.mark.night
@pytest.mark.parametrize("exchange", EXCHANGES.values(), ids=EXCHANGES)
def test_the_likelihood_is_unbiased(exchange):
    """On a linear model, where Kalman's filter knows it."""
    model = mo.textbook.constant_velocity()
    ys = mo.simulate(3, model, 6)[1]
    exact = mo.run(0, mo.KalmanFilter(), model, ys).log_likelihood
    filter = mo.Distributed(mo.ParticleFilter(n=1_024), K, exchange)
    keys = random.step_keys(jax.random.key(5), 400)
    evidence = jax.jit(jax.vmap(lambda key: mo.run(key, filter, model, ys, keep=mo.keep.nothing).log_likelihood))(keys)
    ratio = np.exp(np.asarray(evidence - exact, float))
    assert abs(ratio.mean() - 1) < 3 * ratio.std() / np.sqrt(ratio.size)
