"""Several runs as one: means, covariances and evidence, and the warning that weights degenerate."""

import jax.numpy as jnp
import numpy as np
import pytest

import motes as mo

pytestmark = pytest.mark.filterwarnings("ignore::motes.core.checks.MotesWarning")
MODEL = mo.textbook.constant_velocity()
YS = mo.simulate(0, MODEL, 8)[1]
RUNS = [mo.run(key, mo.ParticleFilter(n=200, on_collapse="predict"), MODEL, YS) for key in range(3)]


def test_one_run_is_itself():
    alone = mo.run(0, mo.KalmanFilter(), MODEL, YS)
    for by in ("evidence", "average"):
        found = mo.combined([alone], by=by)
        np.testing.assert_allclose(found.mean, alone.mean, rtol=1e-5)
        np.testing.assert_allclose(found.cov, alone.cov, rtol=1e-5)
        np.testing.assert_allclose(found.log_evidence, alone.log_evidence, atol=1e-4)


def test_weights_are_likelihoods_so_far_or_all_alike():
    found, plain = mo.combined(RUNS), mo.combined(RUNS, by="average")
    so_far = np.cumsum([run.log_evidence for run in RUNS], axis=1).T.astype(float)
    weights = np.exp(so_far - so_far.max(axis=1, keepdims=True))
    weights /= weights.sum(axis=1, keepdims=True)
    np.testing.assert_allclose(found.weights, weights, atol=1e-4)
    means = np.stack([run.mean for run in RUNS], axis=1)
    np.testing.assert_allclose(found.mean, np.sum(weights[..., None] * means, axis=1), atol=1e-3)
    np.testing.assert_allclose(plain.mean, means.mean(axis=1), atol=1e-4)
    spread = np.stack([np.cov(means[t].T, bias=True) for t in range(8)])
    np.testing.assert_allclose(plain.cov, np.mean([run.cov for run in RUNS], axis=0) + spread, atol=1e-3)
    assert found.log_likelihood == pytest.approx(np.log(np.mean(np.exp(so_far[-1] - so_far[-1].max()))) + so_far[-1].max(), abs=1e-3)
    assert np.array_equal(found.log_evidence, plain.log_evidence)


def test_degenerate_weights_are_told():
    wrong = mo.replace(MODEL, sensor=mo.LinearGaussian(jnp.eye(2, 4), 100 * jnp.eye(2)))
    runs = [mo.run(0, mo.KalmanFilter(), model, YS) for model in (MODEL, wrong)]
    with pytest.warns(mo.MotesWarning, match="evidence weights degenerate: one of 2 runs has 1.00 of the weight"):
        assert mo.combined(runs).weights[-1, 0] > 0.99


def told(history, log_evidence, **more):
    """A history that says something else of its measurements."""
    return mo.replace(history, info=mo.replace(history.info, log_evidence=jnp.asarray(log_evidence, jnp.float32)), **more)


def test_long_runs_keep_their_digits():
    """After 1e6 nats a float32 has no digits left for a difference of a tenth."""
    runs = [told(RUNS[0], [-1e6, *[-1.0] * 6, last]) for last in (-1.0, -1.1)]
    found = mo.combined(runs)
    np.testing.assert_allclose(found.weights[-1], np.exp([0, -0.1]) / np.exp([0, -0.1]).sum(), rtol=1e-5)
    np.testing.assert_allclose(found.log_evidence[1:7], -1, rtol=1e-5)
    assert found.log_evidence[-1] == pytest.approx(np.log(np.mean(np.exp([-1.0, -1.1]))), rel=1e-5)


def test_where_all_runs_collapse_numbers_stay_numbers():
    found = mo.combined([told(RUNS[k], [-1, -1, -np.inf, -1, -1, -1, -1, -1 - k]) for k in range(2)])
    assert np.all(np.isfinite(found.mean)) and found.log_evidence[2] == -np.inf and found.log_likelihood == -np.inf
    np.testing.assert_allclose(found.weights[2], 0.5, rtol=1e-5)


def test_angles_of_runs_on_two_branches_are_one_direction():
    runs = [mo.replace(RUNS[0], circular=(0,), kept=RUNS[0].kept | {"mean": RUNS[0].mean.at[:, 0].set(angle)})
            for angle in (3.1, -3.1, 3.1 + 2 * np.pi)]  # fmt: skip
    found = mo.combined(runs, by="average")
    assert np.all(np.cos(found.mean[:, 0]) < -0.99) and np.all(found.cov[:, 0, 0] - RUNS[0].cov[:, 0, 0] < 0.01)


@pytest.mark.parametrize(
    ("histories", "by", "message"),
    [
        (lambda: RUNS, "vote", "combined by: expected"),
        (lambda: [], "average", "combined histories: expected at least one, got none"),
        (lambda: RUNS[0], "average", "combined histories: expected a list of what mo.run gave, got History"),
        (lambda: [RUNS[0], mo.replace(RUNS[1], names=("a", "b", "c", "d"))], "average", "same states, got states a, b, c, d"),
        (lambda: [mo.replace(RUNS[0], start=np.zeros(3))], "average", "expected single runs, one after the other, got a batch of 3"),
        (lambda: [3], "average", "combined histories: expected what mo.run gave"),
        (lambda: [RUNS[0], mo.run(0, mo.KalmanFilter(), MODEL, YS[:3])], "average", "combined histories: expected runs over the same"),
        (lambda: [mo.run(0, mo.KalmanFilter(), MODEL, YS[4:], after=mo.run(0, mo.KalmanFilter(), MODEL, YS[:4]))], "average",
         "combined histories: expected runs from step 0 on, got one from step 4"),
    ],
)  # fmt: skip
def test_what_it_refuses(histories, by, message):
    with pytest.raises(mo.MotesError, match=message):
        mo.combined(histories(), by=by)
