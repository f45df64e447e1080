"""The data that come with the package: whole, as published, and small."""

from pathlib import Path

import numpy as np
import pytest

import motes as mo
from data import recorded
from motes.io import read_table

SETS = [name for name in mo.data.__all__ if name != "DataSet"]


@pytest.mark.parametrize("name", SETS)
def test_sets_are_ready_for_filters_and_say_what_they_are(name):
    found = getattr(mo.data, name)()
    assert found.values.shape == (len(found.times), len(found.names)) and np.isfinite(found.values).all()
    assert np.all(np.diff(found.times) > np.zeros((), np.diff(found.times).dtype)) and len(found.units) == len(found.names)
    said = repr(found)
    assert all(part in said for part in (found.title, found.source, found.licence)) and len(said) < 500


def test_numbers_are_those_published():
    nile, coal, lynx, galaxies, pound = (getattr(mo.data, name)() for name in ("nile", "coal", "lynx", "galaxies", "pound"))
    assert nile.values.mean() == 919.35 and (nile.times[0], nile.times[-1]) == (1871, 1970)
    assert coal.values.sum() == 191 and (coal.times[0], coal.times[-1]) == (1851, 1962)
    assert lynx.values.max() == 6991 and lynx.times[lynx.values[:, 0].argmax()] == 1904
    assert galaxies.values.shape == (82, 1) and galaxies.values[77] == 26960
    assert len(pound.values) == 946 and pound.times[-1] == np.datetime64("1985-06-28")


def test_numbers_are_those_of_the_recordings_beside_the_repository():
    for name in ("nile", "lynx"):
        table = read_table(recorded(f"timeseries/{name}.csv"))
        np.testing.assert_array_equal(getattr(mo.data, name)().values[:, 0], table["value"])
    dates = read_table(recorded("timeseries/coal.csv"))["date"]
    np.testing.assert_array_equal(mo.data.coal().values[:, 0], np.bincount((np.floor(dates) - 1851).astype(int), minlength=112))


def test_all_sets_together_are_small():
    files = list((Path(mo.data.__file__).parent).glob("*.csv"))
    assert {file.stem for file in files} == set(SETS) and sum(file.stat().st_size for file in files) < 300_000
