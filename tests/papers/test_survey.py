"""The picture of the survey's growth model shows what its table says."""

import runpy
from pathlib import Path

import numpy as np

import motes as mo

PROGRAM = Path(__file__).parents[2] / "papers" / "survey2004" / "pictures.py"


def test_every_filter_has_a_mark_for_each_number_of_particles():
    rows = (("exact", 4.0, 0.0, 0.0), ("rule, 10", 8.0, 100.0, 0.1), ("drawn, 100", 5.0, 25.0, 0.2), ("drawn, 1000", 4.4, 10.0, 0.04))
    table = mo.io.Table(("filter", "RMSE", "above exact, %", "s.e. of difference"), rows)
    axes = runpy.run_path(str(PROGRAM))["growth_figure"](table, (100, 1000)).axes[0]
    assert [label.get_text() for label in axes.get_yticklabels()] == ["rule, 10", "drawn"]
    shown = {marks.get_label(): marks for marks in axes.containers}
    expected = {"no particles": (100.0, 0, 2.5), "100 particles": (25.0, 1, 5.0), "1000 particles": (10.0, 1, 1.0)}
    assert set(shown) == set(expected)
    for label, (above, place, error) in expected.items():
        line, _, (bar,) = shown[label]
        np.testing.assert_allclose(line.get_xydata(), [[above, place]])
        np.testing.assert_allclose(np.ptp(bar.get_segments()[0][:, 0]), 2 * error)
