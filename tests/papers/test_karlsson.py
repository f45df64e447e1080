"""The program that reproduces Karlsson, Schon, Gustafsson (2005), on a clock whose times are known: nothing is timed here."""

import csv
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import motes as mo
from motes.costs.calibration import Slope

FOLDER = Path(__file__).parents[2] / "papers" / "karlsson2004"
FIXED = {"PPPPPP": 10e-6, "PPKKPP": 12e-6, "PPPPKK": 8e-6, "PPKKKK": 5e-6}
EACH = {"PPPPPP": 60e-9, "PPKKPP": 55e-9, "PPPPKK": 65e-9, "PPKKKK": 62.49e-9}
C1, C2, C3, FLOP = 400.0, 500.0, 100.0, 1e-11


def on_the_clock(name, n):
    return FIXED[name] + EACH[name] * n


@pytest.fixture(scope="module")
def program():
    """Put the folder of the program on the import path while it is tested."""
    sys.path.insert(0, str(FOLDER))
    yield
    sys.path.remove(str(FOLDER))


@pytest.fixture
def known(program, monkeypatch):
    """A machine with known times and constants."""
    from printed import KALMAN

    names = {states: name for name, states in KALMAN.items()}

    def seconds(filter, model, ys):
        return on_the_clock(names[getattr(filter, "linear", ())], filter.n)

    def constant(value):
        return Slope(value, value, value, 1.0)

    calibration = mo.costs.Calibration(*map(constant, (FLOP, C1 * FLOP, C2 * FLOP, C3 * FLOP)), engine="jax", device="cpu")
    monkeypatch.setattr(mo.costs, "seconds_per_step", seconds)
    monkeypatch.setattr(mo.costs, "calibrate", lambda refresh: calibration)


@pytest.fixture(scope="module")
def out(tmp_path_factory):
    return tmp_path_factory.mktemp("karlsson")


def rows(path):
    with path.open() as file:
        return list(csv.DictReader(file))


def numbers(row, *names):
    return [float(row[name]) for name in names]


@pytest.mark.night
def test_quick_run(known, out, monkeypatch, capsys):
    """All parts run, and what they write fits the clock, the equations and each other."""
    import reproduce

    monkeypatch.setattr(sys, "argv", ["reproduce.py", "--quick", "--engine", "jax", "--out", str(out)])
    reproduce.main()
    assert "gain of full marginalization" in capsys.readouterr().out
    expected = {f"figure{number}.{kind}" for number in (1, 2) for kind in ("csv", "png")} | {"tracks.csv", "tracks.png"}
    expected |= {"figure3_jax.csv", "figure3_jax.png", "figure3_jax_errors.md", "figure3_jax_lines.md"}
    expected |= {f"table2_{place}_jax.{kind}" for place in ("short", "close", "long") for kind in ("csv", "md")}
    expected |= {"table3_short_jax.csv", "table3_short_jax.md"}
    assert {path.name for path in out.iterdir()} == expected
    check_figure_3(rows(out / "figure3_jax.csv"))
    for place in ("short", "close", "long"):
        check_table_2(rows(out / f"table2_{place}_jax.csv"))
    check_table_3(rows(out / "table3_short_jax.csv"))
    check_tracks(rows(out / "tracks.csv"))


def check_figure_3(table):
    assert {(row["N"], row["judged"]) for row in table} == {("500", "yes"), ("1000", "no"), ("2000", "no")}
    for row in table:
        n = int(row["N"])
        measured, line, flops = numbers(row, "measured", "line", "flops")
        assert measured == pytest.approx(1e6 * on_the_clock(row["partition"], n))
        assert line == pytest.approx(measured)
        # equation 11 with (p, k) = (6, 0) and (2, 4), by hand
        fixed, each = (360.0, 150 + 6 * C3) if row["partition"] == "PPPPPP" else (544 + 4 / 3 * 8, 94 + 2 * C3)
        assert flops == pytest.approx(1e6 * FLOP * (fixed + (each + C1 + C2) * n))


def check_table_2(table):
    plain, full = table[:3], table[3:]
    assert [row["block"] for row in full] == ["position", "velocity", "acceleration"]
    for own, base in zip(full, plain, strict=True):
        n, time, share = numbers(own, "N", "us/step", "of plain")
        assert (n, base["N"], base["to plain, percent"]) == (2000, "2000", "")
        assert time == pytest.approx(1e6 * on_the_clock("PPKKKK", n))
        assert share == pytest.approx(on_the_clock("PPKKKK", n) / on_the_clock("PPPPPP", 2000))
        if own["lost"] == base["lost"] == "0":
            assert own["kept"] == own["RMSE"]
            assert float(own["to plain, percent"]) == pytest.approx(100 * (float(own["RMSE"]) / float(base["RMSE"]) - 1))
    assert numbers(full[0], "paper") + numbers(plain[2], "paper") == [5.60, 0.52]


def check_table_3(table):
    plain, full = table
    assert (plain["N"], full["paper's N"]) == ("2000", "264")
    n, low, high, share, time = numbers(full, "N", "above", "below", "of plain, percent", "time of plain, percent")
    assert (low, high) == (10, 2000)
    assert n in (low, high)
    assert share == pytest.approx(100 * n / 2000)
    assert time == pytest.approx(100 * on_the_clock("PPKKKK", n) / on_the_clock("PPPPPP", 2000))


def check_tracks(table):
    assert [row["track"] for row in table] == ["0", "1", "2"]
    for row in table:
        plain, full, gain = numbers(row, "plain", "marginalized", "gain, percent")
        assert gain == pytest.approx(100 * (1 - full / plain))


def test_ratios_of_figures_1_and_2(program):
    from ratios import FIGURE_1, FIGURE_2, ratios

    first, second = ({row[:2]: row[2:] for row in ratios(ways).rows} for ways in (FIGURE_1, FIGURE_2))
    assert len(first) == len(second) == sum(range(2, 9))
    assert first[6, 4] == pytest.approx((1 / (1 - 556 / 1832),))  # equation 14
    assert all(ratio > 1 for (_, k), (ratio,) in first.items() if k)
    assert second[9, 7] == pytest.approx((0.8815, 0.5978), abs=1e-4)
    assert second[9, 0] == (1, None)


def test_the_papers_own_errors(program):
    """One price of a flop for eight times: no other one has smaller squares."""
    from printed import TABLE_II, TABLE_III, own_errors

    found = 1 + np.array(own_errors())
    counts = {"PPPPPP": 1832, "PPKKPP": 1554, "PPPPKK": 1554, "PPKKKK": 1276}
    times = [counts[name] * row[0] / row[-1] for table in (TABLE_II, TABLE_III) for name, row in table.items()]
    np.testing.assert_allclose(found / found[0], np.array(times) / times[0], rtol=3e-3)  # what does not depend on N is left out here
    assert np.sum((found - 1) ** 2) < min(np.sum((found * price - 1) ** 2) for price in (0.99, 1.01))


def test_partitions_are_compared_over_runs_that_both_kept(program):
    from tables import change

    squared = np.array([[[4.0, 4.0], [900.0, 900.0], [2.0, 6.0]], [[1.0, 1.0], [1.0, 1.0], [3.0, 3.0]]])
    lost = np.array([[False, True, False], [False, False, False]])
    result = SimpleNamespace(lost=lost, squared_errors=lambda block: squared)
    # RMSE 2 and root of 2; each run adds its mean square over twice the RMSE
    influence = np.array([1, 3]) / (2 * np.sqrt(2)) - np.array([4, 4]) / 4
    expected = 100 * (np.sqrt(2) - 2) / 2, 100 * influence.std(ddof=1) / np.sqrt(2) / 2
    assert change(result, "position", 1) == pytest.approx(expected)


def test_equal_times(known):
    """On a clock whose times are lines, numbers of particles are the even ones nearest to what the plain filter's time allows."""
    import clock

    sizes, seconds = clock.matched(tuple(FIXED), 1_000, 1)
    assert sizes["PPPPPP"] == 1_000
    for name, n in sizes.items():
        assert seconds[name] == on_the_clock(name, n)
        assert n % 2 == 0 and on_the_clock(name, n - 2) < on_the_clock("PPPPPP", 1_000) < on_the_clock(name, n + 2)


def test_equal_times_where_times_have_steps(program, monkeypatch):
    """The line says 1 234 particles, whose steps take half as long again as it says."""
    import clock

    def seconds(filter, model, ys):
        own = isinstance(filter, mo.MarginalizedParticleFilter)
        return 1e-7 * filter.n * (1.2 if own and filter.n not in (700, 1_000, 1_600) else 0.81 if own else 1.0)

    monkeypatch.setattr(mo.costs, "seconds_per_step", seconds)
    sizes, times = clock.matched(("PPPPPP", "PPKKKK"), 1_000, 1)
    assert sizes == {"PPPPPP": 1_000, "PPKKKK": 2 * round(1_234 / 1.4808 / 2)}
    assert times == pytest.approx({"PPPPPP": 1e-4, "PPKKKK": 1e-7 * 1.2 * 834})


def test_least_of_the_turns_counts(program, monkeypatch):
    import clock

    asked = []

    def seconds(filter, model, ys):
        asked.append(filter.n)
        return 1e-6 * (filter.n + [5, 0, 9][(len(asked) - 1) // 2])

    monkeypatch.setattr(mo.costs, "seconds_per_step", seconds)
    times = clock.in_turns([("PPPPPP", 100), ("PPKKKK", 300)], 3)
    assert asked == [100, 300, 100, 300, 100, 300]
    assert times == {("PPPPPP", 100): 1e-6 * 100, ("PPKKKK", 300): 1e-6 * 300}


def test_tracks_of_the_scenarios(program):
    from scenario import NEAR, fixed_track, nearest, track

    np.testing.assert_array_equal(fixed_track("short"), track(0))
    close = fixed_track("close")
    first = next(seed for seed in range(24) if nearest(track(seed)) < NEAR)
    np.testing.assert_array_equal(close, track(first))
    assert nearest(close) < 300 < nearest(fixed_track("short"))
    assert nearest(fixed_track("long")) > 2_000
