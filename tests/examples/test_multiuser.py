"""Symbols of several users and antennas: chains against enumeration, receivers against the channel that is known; figures by night."""

import importlib

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.stats import t

from examples_of import importable

FAR = 4.9
"""Standard errors: 1e-6 two-sided."""


@pytest.fixture(scope="module")
def example():
    with importable("multiuser"):
        yield {name: importlib.import_module(name) for name in ("rates", "cdma", "mimo", "detection", "channel")}


def probabilities_are_those_of_enumeration(cdma, decibels, words, draws):
    """Compare means of bits by tempered chains: each where it is open, by its batches; and all, by differences between words."""
    _, given = cdma.sent(jax.random.key(7), decibels, words)
    exact = np.asarray(cdma.enumerated(given)[1])
    found = cdma.sampled(jax.random.key(8), given, cdma.TEMPERED, draws)
    off = np.asarray(found.value) - exact
    undecided = np.abs(exact) < 0.9
    z = off[undecided] / np.asarray(found.error)[undecided]
    assert np.abs(z).max() < t.isf(0.5e-6 / z.size, 19)
    # too sure or too open: by how much a mean lies beyond the exact one, on the side of the more probable bit
    for among in (np.abs(exact) < 0.9, (np.abs(exact) >= 0.9) & (np.abs(exact) < 0.999), np.abs(exact) >= 0.999):
        by_word = np.sum(off * np.sign(exact) * among, axis=1)
        assert abs(by_word.mean()) < FAR * by_word.std() / words**0.5 + 1e-7
    return undecided.sum()


def test_probabilities_of_bits_equal_enumeration(example):
    assert probabilities_are_those_of_enumeration(example["cdma"], 4, 100, 1_000) > 50


def test_detectors_of_one_word(example):
    """By hand: all 256 words, and the linear detectors without noise."""
    cdma = example["cdma"]
    bits, given = cdma.sent(jax.random.key(1), 5.0, 3)
    filtered, correlations = np.asarray(given.filtered, float), np.asarray(given.correlations, float)
    for k, (word, mean) in enumerate(zip(*map(np.asarray, cdma.enumerated(given)), strict=True)):
        log_p = [(w @ filtered[k] - 0.5 * w @ correlations[k] @ w) / float(given.variance[k]) for w in np.asarray(cdma.WORDS, float)]
        p = np.exp(np.array(log_p) - max(log_p))
        np.testing.assert_allclose(mean, p / p.sum() @ np.asarray(cdma.WORDS), atol=1e-4)
        assert np.array_equal(word, cdma.WORDS[np.argmax(log_p)])
    bits, given = cdma.sent(jax.random.key(2), 90.0, 20)
    independent = np.linalg.matrix_rank(np.asarray(given.correlations, float), tol=1e-3) == cdma.USERS
    assert independent.sum() > 10
    for estimate in (cdma.decorrelated(given), cdma.least_squares(given)):
        np.testing.assert_allclose(estimate[independent], np.asarray(bits)[independent], atol=1e-2)


def test_bands_know_of_errors_that_come_together(example):
    rates = example["rates"]
    # Wilson's own: 10 of 100
    alone = rates.counted(np.repeat([[1.0], [0.0]], (10, 90), axis=0))
    assert np.allclose(alone, (0.1, 0.0552, 0.1744), atol=2e-3)
    together = rates.counted(np.repeat([[1.0] * 10, [0.0] * 10], (10, 90), axis=0))
    assert np.allclose(together, alone, atol=2e-3)
    none = rates.counted(np.zeros((5, 20)))
    assert none.rate == 0 and abs(none.low) < 1e-12 and abs(none.high - 1.96**2 / (100 + 1.96**2)) < 1e-6
    wrong = np.random.default_rng(0).random((400, 8)) < 0.1
    assert rates.over(wrong, wrong) == (1.0, 0.0) and np.isnan(rates.over(wrong, 0 * wrong)[0])


@pytest.mark.night
def test_receivers_of_a_channel_without_noise(example):
    """Measurements are sums of complex products; nothing is wrong without noise, from the first pilots on."""
    mimo, channel = example["mimo"], example["channel"]
    taps = np.random.default_rng(0).normal(size=(2, 2)) + 1j * np.random.default_rng(1).normal(size=(2, 2))
    x = np.concatenate([taps.real.ravel(), taps.imag.ravel()])
    for seen, pair in zip(mimo.SEEN, mimo.SYMBOLS, strict=True):
        y = taps @ pair
        np.testing.assert_allclose(seen @ x, np.concatenate([y.real, y.imag]), rtol=1e-5)
    assert np.flatnonzero(mimo.known(100) >= 0).tolist() == [0, 1, 40, 41, 80, 81]
    level = jnp.float32(mimo.variance(60.0))
    xs, modes, ys = channel.frame(jax.random.key(3), level)
    given = (xs, ys, jnp.asarray(channel.PILOTS), level)
    assert np.array_equal(mimo.channel_known(*given).argmax(axis=1), modes)
    assert (np.asarray(mimo.decision_directed(*given).argmax(axis=1)) == modes)[channel.PILOTS >= 0].all()


@pytest.mark.optimized
@pytest.mark.night
@pytest.mark.parametrize("decibels", [0, 2, 4, 6, 8])
def test_tempered_chains_decide_as_well_as_enumeration(example, decibels):
    """Within 5 percent of its error rate on the same words, and the same probabilities; a chain alone sticks at 8 dB."""
    detection = example["detection"]
    found = detection.decided(decibels, decibels, 5_000)
    ratio, _ = example["rates"].over(found.chance[detection.TEMPERED], found.chance[detection.EXACT])
    assert 1 <= ratio < 1.05
    assert decibels < 8 or found.chance[detection.PLAIN].mean() > 5 * found.chance[detection.EXACT].mean()
    # where enumeration knows how probable an error is, as many are counted
    for name, wrong in found.wrong.items():
        off = (wrong - found.chance[name]).mean(axis=1)
        assert abs(off.mean()) < FAR * off.std() / len(off) ** 0.5, name
    probabilities_are_those_of_enumeration(example["cdma"], decibels, 500, 4_000)


@pytest.mark.optimized
@pytest.mark.night
def test_symbols_help_to_follow_a_channel(example):
    """At 9 dB delay helps the jump-Markov filter, and pilots alone or one path of decisions are worse; frames of this seed."""
    mimo, channel = example["mimo"], example["channel"]
    keys = jax.random.split(jax.random.key(11), 60)
    wrong = {name: np.asarray(each).mean() for name, each in channel.wrong_bits(keys, jnp.float32(mimo.variance(9.0)), 32).items()}
    assert wrong[channel.KNOWN] < wrong[channel.LATER] < wrong[channel.TRACKED]
    assert wrong[channel.LATER] < min(wrong[channel.BETWEEN], wrong[channel.DIRECTED])
