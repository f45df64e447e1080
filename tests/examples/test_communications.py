"""Receivers of the examples of communications: against each other on the same blocks, and the exact ones against enumeration."""

from itertools import product

import numpy as np
import pytest
from scipy.stats import binomtest

from examples_of import importable, loaded

with importable("communications"):
    import links


@pytest.fixture(scope="module")
def fading():
    return loaded("communications", "fading")


@pytest.fixture(scope="module")
def rates_of():
    """Mean error rates at one signal-to-noise ratio, by receiver."""
    return lambda found, index=0: {name: float(wrong[index].mean()) for name, wrong in found.items()}


def test_wilson_intervals_are_scipys_where_errors_come_alone():
    """Also where there are none; bursts widen them."""
    wrong = np.zeros((40, 50), bool)
    assert links.error_rate(wrong) == pytest.approx((0.0, *binomtest(0, 2000).proportion_ci(method="wilson")), abs=1e-6)
    wrong[::2, 7] = True
    alone = links.error_rate(wrong)
    assert alone == pytest.approx((0.01, *binomtest(20, 2000).proportion_ci(method="wilson")), abs=1e-6)
    bursts = np.zeros((40, 50), bool)
    bursts[0, :20] = True
    wide = links.error_rate(bursts)
    assert wide.rate == alone.rate and wide.low < alone.low and wide.high > alone.high


def test_bits_are_found_while_the_channel_fades(fading, rates_of, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    found = fading["compared"](fading["simulated"](1, 40, 200), (15,), 8)
    rate = rates_of(found)
    assert rate["channel known"] < rate["jump-Markov, lag 1"] < 0.9 * rate["decision-directed"]
    assert rate["jump-Markov, lag 1"] <= rate["jump-Markov, lag 0"] < rate["differential"]
    links.picture("fading", (15,), {"flat fading": found})
    assert (tmp_path / "out" / "fading.png").stat().st_size > 5_000


@pytest.mark.optimized
@pytest.mark.night
def test_no_pilot_is_needed_while_the_channel_fades(fading):
    """After one more symbol a genie's pilot is worth nothing, from 8 particles on; paired, on 100 blocks of 1000."""
    world, levels = fading["simulated"](0, 100), fading["JUDGED"]
    few, many = (fading["compared"](world, levels, n) for n in (8, 64))
    for index in range(len(levels)):
        ours, more, genie = few["jump-Markov, lag 1"][index], many["jump-Markov, lag 1"][index], few["genie's pilot"][index]
        assert more.mean() <= genie.mean()
        gain = links.paired(more, ours)
        assert gain.mean <= 2 * gain.error


@pytest.fixture(scope="module")
def equalization():
    return loaded("communications", "equalization")


def test_viterbi_finds_the_best_of_all_sequences(equalization):
    modes, taps, own = equalization["simulated"](1, 20, 0.9, 7)
    received = np.sum(taps * equalization["sent"](modes), axis=2) + own
    every = np.array([(0, *path) for path in product((0, 1), repeat=6)])
    cost = np.sum(np.abs(received[:, None] - np.einsum("btk,ptk->bpt", taps, equalization["sent"](every))) ** 2, axis=2)
    assert (every[cost.argmin(axis=1)] == equalization["viterbi"](received, taps)).all()
    assert (modes != every[cost.argmin(axis=1)]).any()


def test_bits_are_found_through_unknown_echoes(equalization, rates_of):
    found = equalization["compared"](equalization["simulated"](3, 24, 1.0, 110), 1.0, (12,), n=16)
    rate = rates_of(found)
    assert rate["Viterbi, channel known"] <= rate["jump-Markov, blind, lag 4"] + 0.01 < rate["per survivor, blind"]
    assert rate["jump-Markov, blind, lag 4"] < rate["jump-Markov, blind, lag 0"]


@pytest.mark.optimized
@pytest.mark.night
@pytest.mark.parametrize(("memory", "most"), [(1.0, 1.4), (0.998, np.inf)])
def test_blind_equalization_is_between_per_survivor_processing_and_a_known_channel(equalization, memory, most):
    """At 10 and 15 dB, on 600 blocks of 200 symbols: at most so many times the errors of Viterbi's algorithm that knows the channel.

    Measured 1.26 and 1.21; the filter draws nothing, since sixteen paths are all that differ.
    """
    found = equalization["compared"](equalization["simulated"](0, 600, memory), memory, (10, 15))
    for ours, known, survivor in zip(
        *(found[name] for name in ("jump-Markov, blind, lag 4", "Viterbi, channel known", "per survivor, blind")), strict=True
    ):
        assert ours.mean() < most * known.mean()
        gain = links.paired(ours, survivor)
        assert gain.mean < -2 * gain.error
        assert np.mean(ours.mean(axis=1) > equalization["LOST"]) < 0.02


@pytest.fixture(scope="module")
def phase():
    return loaded("communications", "phase")


def test_the_grid_of_angles_sums_over_all_paths(phase):
    """Against three nested sums over the carrier's angles and all turns."""
    walk, level = 0.3, 2.0
    modes, carrier, own = phase["simulated"](1, 300, walk, 3)
    received = phase["sent"](modes) * np.exp(1j * carrier) + np.sqrt(level) * own
    angles = np.linspace(-1.8, 1.8, 91)
    moves = np.exp(-0.5 * ((angles[:, None] - angles) / walk) ** 2)
    start = np.exp(-0.5 * (angles / phase["START"]) ** 2)
    fits = np.exp(-(np.abs(received[..., None, None] - np.exp(1j * (angles + np.pi / 2 * np.arange(4)[:, None]))) ** 2) / level)
    joint = np.zeros((300, 4, 4))
    for first, second in product(range(4), repeat=2):
        total = (first + second) % 4
        joint[:, first, second] = np.einsum("i,bi,ij,bj,jk,bk->b", start, fits[:, 0, 0], moves, fits[:, 1, first], moves, fits[:, 2, total],
                                            optimize=True)  # fmt: skip
    filtered, smoothed = phase["exact"](received, level, walk)
    assert (smoothed[:, 1] == joint.sum(axis=2).argmax(axis=1)).all()
    assert (smoothed[:, 2] == joint.sum(axis=1).argmax(axis=1)).all() and (filtered[:, 2] == smoothed[:, 2]).all()


def test_symbols_are_found_while_the_phase_walks(phase, rates_of):
    walk = np.radians(6)
    rate = rates_of(phase["compared"](phase["simulated"](1, 20, walk, 200), walk, (8,)))
    assert rate["phase known"] < rate["jump-Markov, lag 2"] < rate["jump-Markov, lag 0"] < 0.95 * rate["differential"]
    assert abs(rate["jump-Markov, lag 0"] / rate["exact, filtered"] - 1) < 0.1


@pytest.mark.optimized
@pytest.mark.night
@pytest.mark.parametrize("degrees", [2, 6])
def test_eight_particles_are_as_good_as_the_grid(phase, rates_of, degrees):
    """At 10 dB, on 100 blocks of 500 symbols: within 5 percent of its errors at once, and fewer after two more symbols."""
    walk = np.radians(degrees)
    rate = rates_of(phase["compared"](phase["simulated"](0, 100, walk), walk, (10,)))
    assert rate["jump-Markov, lag 0"] < 1.05 * rate["exact, filtered"]
    assert rate["jump-Markov, lag 2"] < rate["exact, filtered"]
