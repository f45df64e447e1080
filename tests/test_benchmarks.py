"""The report of the benchmarks: from recorded seconds to tables. Nothing is timed here."""

import sys
from pathlib import Path

import pytest

FOLDER = Path(__file__).parents[1] / "benchmarks"


@pytest.fixture(scope="module")
def benchmarks():
    """Put the folder of the benchmarks on the import path while its programs are tested."""
    sys.path.insert(0, str(FOLDER))
    yield
    sys.path.remove(str(FOLDER))


def record(engine, seconds, case="bootstrap", n=2_000, values=(7.0, 7.2, 7.1), **more):
    known = {"case": case, "model": "radar", "size": 0, "n": n, "steps": 100, "runs": 1, "engine": engine, "first": 2.0}
    return known | {"seconds": list(seconds), "values": list(values)} | more


@pytest.fixture(scope="module")
def results():
    records = [
        record("motes (JAX)", (0.02, 0.03, 0.022)),
        record("motes", (0.002, 0.0021, 0.0019)),
        record("particles", (0.1, 0.2, 0.15)),
        record("C++ yardstick", (0.001, 0.001, 0.001), values=(90.0, 90.2, 90.1)),
        {key: value for key, value in record("smcx", ()).items() if key != "seconds"} | {"failed": "took more than 60 s"},
        *(record("motes (JAX)", (n * 1e-6,), case="scaling", n=n) for n in (10_000, 100_000)),
    ]
    machine = {"cpu": "a CPU", "cores": 2, "system": "a system", "load before": 0.1}
    return {"records": records, "machine": machine, "versions": {"jax": "0.10"}, "date": "2026-01-01", "quick": False}


def test_report_tables(benchmarks, results):
    from report import text

    lines = text(results).splitlines()
    assert "| radar | 2,000 | 100 | motes (JAX) | 110 | 100 to 150 | 11.00 / 1.00 / - | 2.0 | 7.1 (sd 0.1) |" in lines
    assert "| radar | 2,000 | 100 | particles | 750 | 500 to 1000 | 75.00 / 6.82 / - | 2.0 | 7.1 (sd 0.1) |" in lines
    assert any(line.startswith("| radar | 2,000 | 100 | smcx | took more than 60 s |") for line in lines)
    assert any("C++ yardstick | 5 |" in line and line.endswith("**differs** |") for line in lines)


def test_report_compares_with_what_was_asked(benchmarks, results):
    from report import text

    lines = text(results).splitlines()
    assert "| bootstrap, radar, n = 2,000 | particles / motes | >= 12 | 75.00 | yes |" in lines
    assert "| bootstrap, radar, n = 200,000 | particles / motes (JAX) | >= 7 | not measured |  |" in lines
    assert "| exponent of time against particles | motes (JAX) | 1.0 +- 0.1 | 1.000 | yes |" in lines


def test_report_names_what_is_faster_than_us(benchmarks, results):
    from report import losses

    assert losses(results["records"]) == [
        "bootstrap, radar, n = 2,000, 100 steps: C++ yardstick is 2.00 times as fast as motes",
        "bootstrap, radar, n = 2,000, 100 steps: C++ yardstick is 22.00 times as fast as motes (JAX)",
    ]


def test_figure_is_drawn(benchmarks, results, tmp_path):
    pytest.importorskip("matplotlib")
    from figure import bars, draw

    for name, drawn in {"results.png": draw, "bars.png": lambda results, path: bars(results, path, 2_000)}.items():
        drawn(results, tmp_path / name)
        assert (tmp_path / name).stat().st_size > 1_000


@pytest.mark.night
def test_dry_run_of_an_accelerator(benchmarks, monkeypatch, tmp_path):
    import gpu

    monkeypatch.setattr(sys, "argv", ["gpu.py", "--dry", "--out", str(tmp_path)])
    gpu.main()
    text = (tmp_path / "GPU.md").read_text()
    assert "| random words | equal | equal |" in text and "a dry run" in text
    assert not any(mark in text for mark in ("**differ", "too much", "Error")), text
    for words in ("radar, float64", "cumulative weights", "normal numbers"):
        assert f"\n| {words} |" in text


def test_what_a_device_computes_otherwise_is_told(benchmarks, tmp_path):
    import gpu
    import numpy as np

    class Wrong:
        """A device whose random words, normal numbers and runs are not those of the CPU."""

        dry = True

        def ask(self, engine, task):
            np.save(tmp_path / engine, np.ones(5, np.float32) * (2 if engine == "device" else 1))
            return dict.fromkeys(gpu.LIMITS, 1e-6) | {"random words": engine, "uniform numbers": 1, "normals": tmp_path / f"{engine}.npy"}

        def measured(self, row, variables):
            return {"device": {"values": [1.0, 1.1]}, "CPU": {"values": [9.0, 9.1]}}

    lines = dict(line[:2] for line in gpu.same(Wrong(), 500))
    assert lines["random words"] == "**differ**" and lines["uniform numbers"] == "equal"
    wrong = [name for name, found in lines.items() if "too much" in found]
    assert wrong == ["normal numbers, units in the last place", *gpu.STEPS]
    assert gpu.agreement({"values": [1.0, 1.1]}, {"values": [9.0, 9.1]}).endswith("**differs**")


def test_tracks_are_counted_as_said(benchmarks):
    import numpy as np
    from scans import counted, made, two_targets

    world = two_targets()
    states, own, scans = made(world, 3)
    there = ~np.isnan(own[..., 0])
    assert abs(there.mean() - world.detection) < 0.1
    assert abs(np.mean([len(scan) for scan in scans]) - world.rate - 2 * world.detection) < 2
    for scan, plots in zip(scans, own, strict=True):
        assert all((scan == plot).all(axis=1).any() for plot in plots[~np.isnan(plots[:, 0])])
    assert counted(world, states[..., :2], states) == (False, 0, 0)
    exchanged = np.concatenate([states[:40, :, :2], states[40:, ::-1, :2]])
    assert counted(world, exchanged, states)[:2] == (False, 1)
    gone = states[..., :2].copy()
    gone[-20:, 1] += 2_000
    assert counted(world, gone, states)[0]


@pytest.mark.night
def test_trackers_are_set_beside_the_genie_and_what_was_asked(benchmarks, monkeypatch):
    import dataclasses

    import scans
    import tracking

    import motes as mo

    monkeypatch.setattr(tracking, "find_spec", lambda name: None)
    world = dataclasses.replace(scans.one_target("easy", 0.9, 0.02), scans=6)
    found = tracking.measured(world, 2, {"extended Kalman (PDA)": mo.ExtendedKalmanFilter()})
    genie, ours = tracking.rows("easy", 2, found)
    assert genie[6] == 1 and 0.8 < ours[6] < 1.5 and ours[7] > 0 and ours[8] is None
    values = {tracking.GENIE: (0, 0.0, 20.0, float("nan")), tracking.PEER: (1, 1.0, 26.0, 0.02)}
    values |= {name: (0, 1.0, 26.5, 0.001) for name in ("particle filter, n = 1000", "marginalized, n = 1000")}
    rows = {row[2]: row[3:] for row in tracking.asked(dict.fromkeys((tracking.HARD, tracking.EASY, tracking.CROSSING), values)).rows}
    assert rows["at most 27 m"] == ("26.5 m", "yes") and rows["at most 1.1 of the genie"] == ("1.325", "no")
    assert rows["at least 10 times as fast as Stone Soup's PDA"] == ("20.0", "yes")
