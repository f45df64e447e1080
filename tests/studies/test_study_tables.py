"""Tables against numbers worked out by plain NumPy, and their forms."""

import csv
import io
import math
import re
from types import SimpleNamespace

import numpy as np
import pytest

import motes as mo
from data import refused
from motes.core.checks import FileError
from motes.core.record import replace
from studied import RUNS, STEPS, made_result


@pytest.fixture
def result():
    return made_result()


def plain(result, filter, states, runs):
    """RMSE with its error by leaving out one run after the other, which needs no formula for the spread."""
    runs = np.flatnonzero(runs)
    errors = result.estimates[filter][:, :, states] - result.truth[:, :, states]
    means = np.square(errors).sum(-1).mean(-1)[runs]
    return np.sqrt(means.mean()), means


def jackknife(statistic, runs):
    values = np.array([statistic(np.delete(np.arange(runs), left)) for left in range(runs)])
    return np.sqrt((runs - 1) * np.var(values))


def test_columns(result):
    table = result.table()
    assert "kept" not in table.columns and "of bound" not in table.columns and "s/step" not in table.columns
    assert table.column("filter") == ["ref", "ref", "other", "other"] and table.column("block") == ["plane", "y"] * 2
    everything = np.ones(RUNS, bool)
    for row, (filter, states) in enumerate([(0, [2, 0]), (0, [1]), (1, [2, 0]), (1, [1])]):
        rmse, means = plain(result, filter, states, everything)
        assert table.column("RMSE")[row] == pytest.approx(rmse)
        assert table.column("median")[row] == pytest.approx(np.median(np.sqrt(means)))
        errors = (result.estimates - result.truth)[filter][..., states]
        assert table.column("bias")[row] == pytest.approx(np.linalg.norm(errors.mean((0, 1))))
        assert table.column("NEES/dim")[row] == pytest.approx(result.nees[filter, :, :, row % 2].mean() / len(states))
        assert table.column("lost")[row] == 0
    assert all(math.isnan(value) for value in table.column("difference")[:2])
    rmse, means = plain(result, 0, [2, 0], everything)
    assert table.column("s.e.")[0] == pytest.approx(jackknife(lambda left: np.sqrt(means[left].mean()), RUNS), rel=0.1)


def test_lost_runs_are_counted_and_left_out_of_what_follows(result):
    result = replace(result, lost_beyond=("plane", 40.0))
    table = result.table()
    kept = np.arange(RUNS) != 4
    assert table.column("lost") == [0, 0, 1, 1]
    for row, (filter, states) in enumerate([(0, [2, 0]), (0, [1]), (1, [2, 0]), (1, [1])]):
        own = kept if filter else np.ones(RUNS, bool)
        assert table.column("RMSE")[row] == pytest.approx(plain(result, filter, states, np.ones(RUNS, bool))[0])
        assert table.column("kept")[row] == pytest.approx(plain(result, filter, states, own)[0])
        errors = (result.estimates - result.truth)[filter][own][..., states]
        assert table.column("bias")[row] == pytest.approx(np.linalg.norm(errors.mean((0, 1))))
        if filter:
            (mine, means), (reference, others) = (plain(result, place, states, kept) for place in (1, 0))
            assert table.column("difference")[row] == pytest.approx(mine - reference)
            spread = jackknife(lambda left, a=means, b=others: np.sqrt(a[left].mean()) - np.sqrt(b[left].mean()), RUNS - 1)
            assert table.column("s.e. of it")[row] == pytest.approx(spread, rel=0.1)


def test_rmse_over_time(result):
    result = replace(result, lost_beyond=("plane", 40.0))
    over_time = result.rmse_over_time("plane")
    errors = (result.estimates - result.truth)[..., [2, 0]]
    np.testing.assert_allclose(over_time[0], np.sqrt(np.square(errors[0]).sum(-1).mean(0)))
    np.testing.assert_allclose(over_time[1], np.sqrt(np.square(np.delete(errors[1], 4, 0)).sum(-1).mean(0)))
    assert np.isnan(replace(result, lost_beyond=("y", 1e-9)).rmse_over_time("y")).all()


def test_errors_of_the_rmse_are_those_of_many_studies():
    """400 studies of 50 runs: the mean claimed error is the spread of the RMSE; level 1e-6 (chi-square, 399 degrees: a factor of 1.19)."""
    from motes.studies.tables import accuracy, difference

    draw = np.random.default_rng(8)
    common = draw.gamma(2.0, 1.0, (400, 50, 4))
    squared, reference = common * draw.gamma(1.0, 1.0, (400, 50, 1)), common
    found = [accuracy(study) for study in squared]
    assert 1 / 1.25 < np.mean([one.error for one in found]) / np.std([one.rmse for one in found]) < 1.25
    found = [difference(a, b) for a, b in zip(squared, reference, strict=True)]
    assert 1 / 1.25 < np.mean([one.error for one in found]) / np.std([one.rmse for one in found]) < 1.25
    apart = np.hypot(*(np.mean([accuracy(study).error for study in which]) for which in (squared, reference)))
    assert np.mean([one.error for one in found]) < 0.95 * apart


def test_bound_and_seconds(result):
    covs = np.stack([np.diag([1.0, 2.0, 3.0]) * (t + 1) for t in range(STEPS)]) + 0.1
    table = result.table(bound=SimpleNamespace(cov=covs), seconds={"other": 0.012345})
    least = np.sqrt((covs[:, 0, 0] + covs[:, 2, 2]).mean())
    assert table.column("of bound")[2] == pytest.approx(table.column("RMSE")[2] / least)
    np.testing.assert_allclose(result.bound_over_time("y", SimpleNamespace(cov=covs)), np.sqrt(covs[:, 1, 1]))
    assert table.column("s/step") == [None, None, 0.012345, 0.012345]
    with pytest.raises(mo.MotesError) as error:
        result.table(bound=SimpleNamespace(cov=covs[1:]))
    refused(error, "bound.cov: expected shape (5, 3, 3) (steps, states, states), got shape (4, 3, 3)")
    with pytest.raises(mo.MotesError, match="table seconds: expected one of 'ref', 'other', got 'else'"):
        result.table(seconds={"else": 1.0})


def test_what_cannot_be_had_is_a_dash(result):
    single = replace(result, **{name: getattr(result, name)[:, :1] for name in ("estimates", "nees", "ess", "log_likelihood", "collapsed")},
                     truth=result.truth[:1])
    assert math.isnan(single.table().column("s.e.")[0])
    gone = replace(result, estimates=np.where(np.arange(RUNS)[:, None, None] == 2, np.nan, result.estimates))
    table = gone.table()
    assert table.column("lost") == [1, 1, 1, 1] and math.isnan(table.column("RMSE")[0]) and math.isfinite(table.column("kept")[0])
    cells = [cell.strip() for cell in table.to_markdown().splitlines()[2].split("|")]
    assert cells[3] == "-" and "nan" not in str(table) + table.to_markdown() + table.to_latex() + table.to_csv()


HOSTILE = ("=1+1", "a|b_c<d>&", "50% #1 {x} ~^\\ $", "[red]x[/red]")


def test_forms(result, tmp_path):
    for name in HOSTILE:
        table = replace(result, filters=("ref", name)).table()
        assert name in str(table)
        rows = list(csv.reader(io.StringIO((table.save(tmp_path / "table.csv")).read_text())))
        assert rows[0] == list(table.columns) and rows[3][0] == ("'=1+1" if name == "=1+1" else name)
        assert [float(row[2]) for row in rows[1:]] == table.column("RMSE") and rows[1][table.columns.index("difference")] == ""
        latex = table.save(tmp_path / "table.tex").read_text()
        assert latex.count("&") - latex.count(r"\&") == 5 * (len(table.columns) - 1) and latex.count(r"\\") == 5
        markdown = table.save(tmp_path / "table.md").read_text()
        assert all(len(re.findall(r"(?<!\\)\|", line)) == len(table.columns) + 1 for line in markdown.splitlines())
        assert "<d>" not in markdown
    escaped = r"50\% \#1 \{x\} \textasciitilde{}\textasciicircum{}\textbackslash{} \$"
    assert escaped in replace(result, filters=("ref", HOSTILE[2])).table().to_latex()
    with pytest.raises(FileError, match=r"expected a name that ends in .csv, .md or .tex, got .txt"):
        result.table().save(tmp_path / "table.txt")
    with pytest.raises(mo.MotesError, match="table column: expected one of"):
        result.table().column("speed")


def test_digits():
    from motes.io.result_table import shown

    assert [shown(value) for value in (1.0, 0.0123456, 123456.0, 3, None, math.nan, math.inf, "x")] == [
        "1.000", "0.01235", "1.235e+05", "3", "-", "-", "inf", "x"]


def test_xarray_and_netcdf(result, tmp_path):
    xarray = pytest.importorskip("xarray")
    found = result.to_xarray()
    assert found.estimates.dims == ("filter", "run", "time", "state") and list(found.block.values) == ["plane", "y"]
    np.testing.assert_array_equal(found.sel(filter="other", state="z").estimates, result.estimates[1, :, :, 2])
    with xarray.open_dataset(result.save(tmp_path / "study.nc"), engine="h5netcdf") as read:
        np.testing.assert_array_equal(read.truth, result.truth)
        assert read.attrs["jax_version"] == "1" and read.attrs["seed"] == 0
    with pytest.raises(FileError, match="expected a name that ends in .nc"):
        result.save(tmp_path / "study.csv")
    with pytest.raises(mo.MotesError, match="block: expected one of plane, y, got 'z'"):
        result.errors("z")


def test_tables_are_written_in_notebooks_too(monkeypatch):
    """There rich, which draws them, shows what it is to write."""
    table = mo.io.Table(("filter", "RMSE"), (("plain", 1.5),))
    before = str(table)
    monkeypatch.setattr("rich.console._is_jupyter", lambda: True)
    assert "plain" in before and str(table) == before
