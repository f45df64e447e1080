"""Planted faults are found and named, and healthy runs are left in peace."""

import jax
import numpy as np
import pytest

import motes as mo
from tiers import each


def model(q=1.0, r=0.5):
    return mo.StateSpaceModel(
        mo.Gaussian([0.3, 0.0], [[1.0, 0.0], [0.0, 1.0]]),
        mo.LinearGaussian([[1.0, 1.0], [0.0, 0.95]], [[0.3 * q, 0.0], [0.0, 0.2 * q]]),
        mo.LinearGaussian([[1.0, 0.0]], [[r]]),
        ("place", "speed"),
    )


XS, YS = (np.array(part) for part in mo.simulate(6, model(), 120))
HEALTHY = {
    "Kalman": mo.KalmanFilter(),
    "particles": mo.ParticleFilter(n=5000),
    "marginalized": mo.MarginalizedParticleFilter(n=3000, linear=("speed",)),
    "Gaussian particles": mo.GaussianParticleFilter(n=5000),
}


@pytest.mark.parametrize("filter", each(HEALTHY, {"Gaussian particles"}))
def test_nothing_is_found_in_a_healthy_run(filter):
    for seed in range(3):
        xs, ys = mo.simulate(seed + 20, model(), 120)
        found = mo.diagnose(mo.run(seed, filter, model(), ys, keep=mo.keep.laws), xs)
        # one rare measurement leaves few particles for a step, which is told, and does no harm
        assert found.trusted and {finding.name for finding in found.findings} <= {"degenerate paths", "starvation"}, str(found)


def test_many_runs_are_judged_one_by_one():
    many = jax.vmap(lambda key: mo.run(key, mo.KalmanFilter(), model(), YS[:4]))(jax.random.split(jax.random.key(0), 3))
    with pytest.raises(mo.MotesError, match="diagnose history: expected one run, got 3 runs. Judge one by one: the first is ") as told:
        mo.diagnose(many)
    first = str(told.value).partition("the first is ")[2].removesuffix(".")
    assert first == "jax.tree.map(lambda leaf: leaf[0], history)" and mo.diagnose(jax.tree.map(lambda leaf: leaf[0], many)) is not None


def test_a_lost_filter_says_so():
    """The speed changes by 40 while the model believes in hardly any process noise: every particle is left behind."""
    ys = YS.copy()
    ys[60:] += 40 * np.arange(60)[:, None]
    for filter in (mo.ParticleFilter(n=500, on_collapse="predict"), mo.KalmanFilter(on_collapse="predict")):
        found = mo.diagnose(mo.run(1, filter, model(q=1e-3), ys))
        assert not found.trusted and "lost" in found
        assert "first step 6" in str(found) and "More process noise" in str(found)


def test_collapse_is_named():
    ys = YS.copy()
    ys[7] = 1e7
    found = mo.diagnose(mo.run(1, mo.ParticleFilter(n=500, on_collapse="predict"), model(), ys))
    assert "collapse" in found and "at step 7 no particle explained" in str(found)


def test_one_outlier_is_no_loss():
    ys = YS.copy()
    ys[7] += 12.0
    found = mo.diagnose(mo.run(1, mo.KalmanFilter(), model(), ys))
    assert "lost" not in found and "collapse" not in found


def test_starvation_and_heavy_weights():
    """Noise of the sensor far below the spread of the prediction."""
    _, ys = mo.simulate(3, model(r=1e-7), 60)
    history = mo.run(
        1, mo.ParticleFilter(n=300, policy=mo.resampling.Always(), on_collapse="predict"), model(r=1e-7), ys, keep=mo.keep.laws
    )
    found = mo.diagnose(history)
    assert not found.trusted
    assert "starvation" in found or "lost" in found
    assert "degenerate paths" in found


def test_claims_that_are_too_small_or_too_large():
    for scale, name in ((0.1, "overconfident"), (8.0, "cautious")):
        history = mo.run(1, mo.KalmanFilter(), model(q=scale, r=0.5 * scale), YS)
        assert name in mo.diagnose(history, XS)
    bold = mo.diagnose(mo.run(1, mo.KalmanFilter(), model(q=0.1, r=0.05), YS))
    assert "large innovations" in bold and "more particles" not in str(bold)
    for filter in (mo.KalmanFilter(), mo.ParticleFilter(n=500)):
        timid = mo.diagnose(mo.run(1, filter, model(q=8.0, r=4.0), YS))
        assert "small innovations" in timid and timid.trusted


def test_likelihoods_that_are_no_numbers():
    import jax.numpy as jnp

    base = model()
    sensor = mo.AdditiveGaussian(lambda x, u, t: jnp.sqrt(x[:1] + 1.5), [[0.5]])
    odd = mo.StateSpaceModel(base.initial, base.dynamics, sensor, base.names)
    found = mo.diagnose(mo.run(1, mo.ParticleFilter(n=500), odd, np.ones((4, 1))))
    assert "invalid" in found and "likelihood that is not a number" in str(found)
    sensor = mo.AdditiveGaussian(lambda x, u, t: jnp.sqrt(x[:1] - 100), [[0.5]])
    nowhere = mo.StateSpaceModel(base.initial, base.dynamics, sensor, base.names)
    with pytest.raises(mo.CollapseError, match="500 of them are not numbers: look for roots"):
        mo.run(1, mo.ParticleFilter(n=500), nowhere, np.ones((4, 1)))


def test_bad_input_is_named():
    with pytest.raises(mo.MotesError, match="diagnose history: expected what mo.run gave, got Gaussian"):
        mo.diagnose(mo.Gaussian([0.0], [[1.0]]))
