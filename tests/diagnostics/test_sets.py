"""Distances between sets by hand."""

import numpy as np
import pytest

import motes as mo

TRUTHS = [[0.0, 0.0], [10.0, 0.0], [50.0, 50.0]]
ESTIMATES = [[10.0, 3.0], [0.0, 4.0]]


def test_ospa_by_hand():
    assert np.isclose(mo.diagnostics.ospa(ESTIMATES, TRUTHS, 5.0), np.sqrt((9 + 16 + 25) / 3))
    assert np.isclose(mo.diagnostics.ospa(ESTIMATES, TRUTHS, 3.5, order=1), (3 + 3.5 + 3.5) / 3)
    assert mo.diagnostics.ospa(np.zeros((0, 2)), np.zeros((0, 2)), 5.0) == 0 and mo.diagnostics.ospa(np.zeros((0, 2)), TRUTHS, 5.0) == 5


def test_gospa_by_hand():
    found = mo.diagnostics.gospa(ESTIMATES, TRUTHS, 5.0)
    assert np.isclose(found.distance, np.sqrt(9 + 16 + 12.5)) and (found.missed, found.false) == (1, 0)
    found = mo.diagnostics.gospa(ESTIMATES, TRUTHS, 3.5)
    assert np.isclose(found.distance, np.sqrt(9 + 3.5**2 / 2 * 3)) and (found.missed, found.false) == (2, 1)
    assert np.isclose(found.localization, 9)


def test_bad_input_is_named():
    for line, call in {
        "ospa estimates: expected points of 2 components, as the truths, got 1": lambda: mo.diagnostics.ospa([[1.0]], TRUTHS, 5.0),
        "gospa truths: expected finite points": lambda: mo.diagnostics.gospa(ESTIMATES, [[np.nan, 1.0]], 5.0),
        "ospa cutoff": lambda: mo.diagnostics.ospa(ESTIMATES, TRUTHS, 0.0),
        "gospa order: expected a number of at least 1, got 0.5": lambda: mo.diagnostics.gospa(ESTIMATES, TRUTHS, 5.0, order=0.5),
    }.items():
        with pytest.raises(mo.MotesError, match=line):
            call()
