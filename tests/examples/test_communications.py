"""Receivers of the examples of communications: against each other on the same blocks, and the exact ones against enumeration."""

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
