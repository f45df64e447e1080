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
        record("motes (native)", (0.002, 0.0021, 0.0019)),
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
    assert "| radar | 2,000 | 100 | motes (JAX) | 110 | 100 to 150 | 1.00 / 11.00 | 2.0 | 7.1 (sd 0.1) |" in lines
    assert "| radar | 2,000 | 100 | particles | 750 | 500 to 1000 | 6.82 / 75.00 | 2.0 | 7.1 (sd 0.1) |" in lines
    assert any(line.startswith("| radar | 2,000 | 100 | smcx | took more than 60 s |") for line in lines)
    assert any("C++ yardstick | 5 |" in line and line.endswith("**differs** |") for line in lines)


def test_report_compares_with_what_was_asked(benchmarks, results):
    from report import text

    lines = text(results).splitlines()
    assert "| bootstrap, radar, n = 2,000 | particles / motes (native) | >= 12 | 75.00 | yes |" in lines
    assert "| bootstrap, radar, n = 200,000 | particles / motes (JAX) | >= 7 | not measured |  |" in lines
    assert "| exponent of time against particles | motes (JAX) | 1.0 +- 0.1 | 1.000 | yes |" in lines


def test_report_names_what_is_faster_than_us(benchmarks, results):
    from report import losses

    assert losses(results["records"]) == [
        "bootstrap, radar, n = 2,000, 100 steps: C++ yardstick is 22.00 times as fast as motes (JAX)",
        "bootstrap, radar, n = 2,000, 100 steps: C++ yardstick is 2.00 times as fast as motes (native)",
    ]


def test_figure_is_drawn(benchmarks, results, tmp_path):
    pytest.importorskip("matplotlib")
    from figure import draw

    draw(results, tmp_path / "results.png")
    assert (tmp_path / "results.png").stat().st_size > 1_000
