"""Detectors of changes against enumeration of all times of a change, and run lengths against integral equations."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.stats import norm

import motes as mo
from data import refused

BEFORE, CHANGED = 0.0, 1.0
"""Means of normal numbers of variance 1."""


def ratios_of(ys):
    return (CHANGED - BEFORE) * (ys - (CHANGED + BEFORE) / 2)


@pytest.fixture(scope="module")
def ratios():
    found = np.array(ratios_of(np.random.default_rng(0).normal(size=(6, 40)) + 0.5), np.float32)
    found[:, 11:14], found[2, 0] = np.nan, np.nan
    return found


def sums(row):
    """Log likelihood ratios of a change at each step k, given steps up to t: (k, t), minus infinity where k comes later."""
    known, steps = np.nan_to_num(row.astype(np.float64)), len(row)
    return np.array([[known[k : t + 1].sum() if k <= t else -np.inf for t in range(steps)] for k in range(steps)])


def test_cusum_is_the_largest_ratio_over_all_times(ratios):
    found = mo.detect.cusum(ratios, threshold=4.0)
    for row, statistic, onset, alarm, change in zip(ratios, *map(np.asarray, (found.statistic, found.onset, found.alarm, found.change)),
                                                    strict=True):  # fmt: skip
        every = sums(row)
        np.testing.assert_allclose(statistic, np.maximum(every.max(axis=0), 0), atol=2e-5)
        np.testing.assert_allclose(every[onset, np.arange(len(row))], every.max(axis=0), atol=2e-5)
        above = np.flatnonzero(statistic > 4)
        assert alarm == (above[0] if above.size else -1) and change == (onset[alarm] if above.size else -1)
    assert (found.alarm >= 0).any() and (found.alarm < 0).any()


def test_shiryaev_is_the_posterior_by_enumeration(ratios):
    rate = 0.03
    found = mo.detect.shiryaev(ratios, rate, threshold=np.log(9))
    for row, statistic, onset, alarm in zip(ratios, found.statistic, np.asarray(found.onset), found.alarm, strict=True):
        k = np.arange(len(row))
        log_prior = np.log(rate) + k * np.log1p(-rate)
        every = log_prior[:, None] + sums(row)
        none = (k + 1) * np.log1p(-rate)
        expected = np.logaddexp.reduce(every, axis=0)
        np.testing.assert_allclose(jax.nn.sigmoid(statistic), 1 / (1 + np.exp(none - expected)), rtol=2e-5)
        np.testing.assert_allclose(every[onset, k], every.max(axis=0), atol=2e-5)
        above = np.flatnonzero(np.asarray(statistic) > np.log(9))
        assert alarm == (above[0] if above.size else -1)


def test_steps_and_runs_are_the_same(ratios):
    total, odds = jnp.zeros(6), jnp.full(6, -jnp.inf)
    for ratio in ratios.T:
        total, odds = mo.detect.cusum_step(total, ratio), mo.detect.shiryaev_step(odds, ratio, 0.1)
    np.testing.assert_array_equal(mo.detect.cusum(ratios).statistic[:, -1], total)
    np.testing.assert_allclose(mo.detect.shiryaev(ratios, 0.1).statistic[:, -1], odds, rtol=1e-5)
    one = mo.detect.cusum(ratios[1])
    np.testing.assert_array_equal(one.statistic, mo.detect.cusum(ratios).statistic[1])
    assert one.alarm.shape == () and one.alarm == one.change == -1
    mapped = jax.jit(jax.vmap(lambda row, rate: mo.detect.shiryaev(row, rate).statistic))(ratios, jnp.full(6, 0.1))
    np.testing.assert_allclose(mapped, mo.detect.shiryaev(ratios, 0.1).statistic, rtol=1e-5)


def run_length(mean, threshold):
    """Mean number of steps until CUSUM gives the alarm: Page's integral equation by Gauss-Legendre nodes.

    L(z) = 1 + F(-z) L(0) + integral from 0 to the threshold of f(x - z) L(x), with F and f of the ratio.
    """
    x, w = np.polynomial.legendre.leggauss(60)
    x, w = np.append(0.0, (x + 1) * threshold / 2), w * threshold / 2
    gap = CHANGED - BEFORE
    ratio = norm(gap * (mean - (CHANGED + BEFORE) / 2), gap)
    kernel = np.column_stack([ratio.cdf(-x), ratio.pdf(x[1:] - x[:, None]) * w])
    return np.linalg.solve(np.eye(len(x)) - kernel, np.ones(len(x)))[0]


@pytest.mark.parametrize(("mean", "steps"), [(BEFORE, 1000), (CHANGED, 100)])
def test_run_lengths_are_those_of_the_integral_equation(mean, steps):
    """Level 1e-6; all of 4000 runs end."""
    ys = mean + np.random.default_rng(1).normal(size=(4000, steps))
    found = mo.detect.cusum(ratios_of(ys).astype(np.float32), threshold=2.5)
    lengths = np.asarray(found.alarm) + 1
    assert lengths.min() > 0
    assert abs(lengths.mean() - run_length(mean, 2.5)) < 4.9 * lengths.std() / 4000**0.5


def test_shiryaev_is_calibrated():
    """Of the alarms at a posterior probability those are false that it says: level 1e-6, with changes drawn from the prior."""
    rng, rate = np.random.default_rng(2), 0.02
    change = rng.geometric(rate, size=(20_000, 1)) - 1
    ys = rng.normal(size=(20_000, 300)) + (np.arange(300) >= change)
    found = mo.detect.shiryaev(ratios_of(ys).astype(np.float32), rate, threshold=np.log(4))
    alarm = np.asarray(found.alarm)
    sounded = alarm >= 0
    claimed = jax.nn.sigmoid(jnp.take_along_axis(found.statistic, alarm[:, None], axis=-1)[:, 0])
    off = (alarm >= change[:, 0])[sounded] - np.asarray(claimed)[sounded]
    assert sounded.mean() > 0.99 and abs(off.mean()) < 4.9 * off.std() / sounded.sum() ** 0.5


def test_threshold_lets_a_share_of_runs_pass():
    statistics = np.random.default_rng(3).normal(size=(400, 7))
    above = mo.detect.threshold(statistics, 0.05)
    assert (statistics.max(axis=1) > above).sum() == 20
    assert (statistics.max(axis=1) > np.nextafter(above, -np.inf)).sum() == 21


@pytest.mark.parametrize(("call", "words"), [
    (lambda: mo.detect.cusum("many"), ("cusum ratios",)),
    (lambda: mo.detect.cusum(1.0), ("cusum ratios", "(steps,) or (runs, steps)")),
    (lambda: mo.detect.cusum([0.0, np.inf]), ("cusum ratios", "finite", "[1]")),
    (lambda: mo.detect.shiryaev([0.0], 1.0), ("shiryaev rate", "between 0 and 1")),
    (lambda: mo.detect.shiryaev([0.0], "often"), ("shiryaev rate", "often")),
    (lambda: mo.detect.shiryaev_step(0.0, 0.0, 0.0), ("shiryaev_step rate", "between 0 and 1")),
    (lambda: mo.detect.threshold(np.zeros((10, 5)), 0.05), ("threshold statistics", "at least 20 runs", "(10, 5)")),
    (lambda: mo.detect.threshold(np.zeros(10), 0.05), ("threshold statistics", "(runs, steps)")),
    (lambda: mo.detect.threshold(np.zeros((10, 5)), 1.5), ("threshold share", "between 0 and 1")),
])  # fmt: skip
def test_bad_input_is_refused_in_one_line(call, words):
    with pytest.raises(mo.MotesError) as error:
        call()
    refused(error, *words)
