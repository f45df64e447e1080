"""A model of the user's own, from the command line."""

import json
import sys
from pathlib import Path

import numpy as np
import pytest
from test_cli import refused

import motes as mo
from motes.cli.main import main
from motes.cli.records import build, flags_of, kinds, merged, with_size
from motes.filters.interface import Filter

MODEL = '''"""My model."""

import jax.numpy as jnp

import motes as mo


def make():
    walk = mo.LinearGaussian(jnp.eye(2), 0.1 * jnp.eye(2))
    return mo.StateSpaceModel(mo.Gaussian(jnp.zeros(2), jnp.eye(2)), walk, mo.LinearGaussian(jnp.eye(2), jnp.eye(2)), ("east", "north"))


def uneven():
    def Q(x, u, t):
        return (0.1 * u["dt"] + 1e-6 * u["wind"]) * jnp.eye(2)

    return mo.replace(make(), dynamics=mo.AdditiveGaussian(lambda x, u, t: x, Q))


def own(data):
    return {"model": make(), "ys": jnp.stack([jnp.asarray(data["a"]), jnp.asarray(data["b"])], axis=1)}


def broken():
    return 1 / 0


def number():
    return 3


def several():
    a, b = (mo.LinearGaussian(row, jnp.eye(1)) for row in ([[1.0, 0.0]], [[0.0, 1.0]]))
    return mo.replace(make(), sensor=mo.Independent(a=a, b=b))


constant = 3
'''
STEPS = 25
XS, YS = (np.array(drawn) for drawn in mo.simulate(
    3, mo.StateSpaceModel(mo.Gaussian(np.zeros(2), np.eye(2)), mo.LinearGaussian(np.eye(2), 0.1 * np.eye(2)),
                          mo.LinearGaussian(np.eye(2), np.eye(2))), STEPS))  # fmt: skip


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A folder with a model and its measurements, in which the user stands."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    # of another folder, where a test before this one stood
    monkeypatch.delitem(sys.modules, "model", raising=False)
    Path("model.py").write_text(MODEL)
    table = np.column_stack([0.5 * np.arange(STEPS), YS, XS, np.ones(STEPS)])
    text = "t,a,b,x,y,wind\n" + "".join(",".join(f"{value:.9g}" for value in row) + "\n" for row in table)
    Path("y.csv").write_text(text.replace(f"\n{table[4][0]:.9g},{table[4][1]:.9g},", f"\n{table[4][0]:.9g},,"))
    return tmp_path


def test_a_run_writes_what_python_would_find(folder, capsys):
    words = ["--data", "y.csv", "--data.columns", "a", "b", "--data.truth", "x", "y", "--filter", "particle", "--filter.n", "300"]
    assert main(["run", "model.py:make", *words, "--filter.policy", "ESS", "--filter.policy.share=0.3", "--smoother", "genealogy",
                 "--smoother.lag", "5", "--out", "found"]) == 0  # fmt: skip
    said = capsys.readouterr().out
    assert "n=300" in said and "share=0.3" in said and "rms east" in said and "at the end" in said
    names = {path.name for path in Path("found").iterdir()}
    assert names == {"particle.nc", "particle.npz", "track.csv", "summary.json", "states.png", "particle_smoothed.csv"}
    ys = YS.copy()
    ys[4, 0] = np.nan
    history = mo.History.load("found/particle.npz")
    wanted = mo.run(0, mo.ParticleFilter(n=300, policy=mo.resampling.ESS(0.3)), history_model(), ys)
    np.testing.assert_allclose(history.mean, wanted.mean, rtol=1e-4, atol=1e-4)
    summary = json.loads(Path("found/summary.json").read_text())
    assert {"rms_east", "rms_north"} <= set(summary["results"]["particle"])
    assert len(Path("found/particle_smoothed.csv").read_text().splitlines()) == STEPS + 1


def history_model():
    return mo.StateSpaceModel(mo.Gaussian(np.zeros(2), np.eye(2)), mo.LinearGaussian(np.eye(2), 0.1 * np.eye(2)),
                              mo.LinearGaussian(np.eye(2), np.eye(2)), ("east", "north"))  # fmt: skip


TOML = """application = "model.py:uneven"
seed = 4

[data]
file = "y.csv"
columns = ["a", "b"]
time = "t"
inputs = ["wind"]

[filter]
kind = "KalmanFilter"
gate = 0.9999

[filters.kalman]
kind = "kalman"

[filters.few]
kind = "particle"
n = 50
"""


def test_a_toml_file_says_the_same_and_flags_change_it(folder, capsys):
    Path("own.toml").write_text(TOML.partition("[filters")[0])
    assert main(["run", "own.toml", "--out", "one"]) == 0
    assert "gate=0.9999" in capsys.readouterr().out
    times = mo.History.load("one/kalman.npz").times
    np.testing.assert_allclose(times, 0.5 * np.arange(STEPS))
    assert main(["run", "own.toml", "--filter", "ensemble kalman", "--filter.n", "40", "--out", "two", "--seed", "1"]) == 0
    assert "n=40" in capsys.readouterr().out


@pytest.mark.parametrize("ending", ["npz", "nc", "mat"])
def test_arrays_come_from_files_of_any_kind(folder, capsys, ending):
    from scipy.io import savemat

    file = f"y.{ending}"
    arrays = {"a": YS[:, 0], "b": YS[:, 1]}
    if ending == "npz":
        np.savez(file, **arrays, note="text")
    elif ending == "nc":
        import xarray

        xarray.Dataset({name: (("step",), value) for name, value in arrays.items()}).to_netcdf(file, engine="h5netcdf")
    else:
        savemat(file, {name: value[:, None] for name, value in arrays.items()})
    names = [] if ending == "mat" else ["--data.columns", "a", "b"]
    assert main(["run", "model.py:make", "--data", file, *names, "--filter", "kalman", "--out", "found"]) == 0
    wanted = mo.run(0, mo.KalmanFilter(), history_model(), YS)
    np.testing.assert_allclose(mo.History.load("found/kalman.npz").mean, wanted.mean, rtol=1e-4, atol=1e-4)


def test_a_function_may_make_measurements_of_the_data(folder, capsys):
    assert main(["run", "model.py:own", "--data", "y.csv", "--filter", "kalman", "--out", "found"]) == 0


def test_a_study_is_kept_and_goes_on(folder, capsys):
    words = ["study", "own.toml", "--steps", "6", "--out", "kept"]
    Path("study.toml").write_text('application = "model.py:make"\n' + TOML[TOML.index("[filters.kalman]"):])
    words[1] = "study.toml"
    assert main([*words, "--runs", "3"]) == 0
    first = capsys.readouterr().out
    assert "kalman" in first and "few" in first
    assert {"table.csv", "study.png", "report.html", "runs"} <= {path.name for path in Path("kept").iterdir()}
    assert main([*words, "--runs", "5", "--filters.more", "particle", "--filters.more.n", "80"]) == 0
    result = mo.studies.StudyResult.load("kept/runs")
    assert result.estimates.shape[:2] == (3, 5)


@pytest.mark.night
def test_a_plan(folder, capsys):
    assert main(["plan", "model.py:make", "--budget", "5ms", "--steps", "10", "--runs", "4"]) == 0
    assert "choice" in capsys.readouterr().out


GOOD = ["--data", "y.csv", "--data.columns", "a", "b", "--filter", "kalman"]
REFUSALS = [
    (["model.py:broken", *GOOD], ["application model.py:broken", "ZeroDivisionError", "model.py, line 25"]),
    (["model.py:number", *GOOD], ["expected a function that returns a model", "got int"]),
    (["model.py:none", *GOOD], ["expected a function none", "make"]),
    (["missing.py:make", *GOOD], ["expected a Python file", "missing.py"]),
    (["no_such_module:make", *GOOD], ["ModuleNotFoundError"]),
    (["model.py:make", "--data", "y.csv"], ["filter: expected a filter by name"]),
    (["model.py:make", *GOOD[:-1], "kalmann"], ["filter kind: expected the name of a Filter, such as kalman", "'kalmann'"]),
    (["model.py:make", *GOOD[:-1], "ekf"], ["such as ensemblekalman, extendedkalman, got 'ekf'"]),
    (["model.py:make", *GOOD[:-1], "UKF", "--filter.n", "3"], ["filter: expected parameters of UnscentedKalmanFilter"]),
    (["model.py:make", *GOOD, "--filter.n", "3"], ["filter: expected parameters of KalmanFilter", "'n'"]),
    (["model.py:make", *GOOD[:-1], "particle"], ["filter n: expected a value", "--filter.n"]),
    (["model.py:make", "--filter", "kalman"], ["data: expected a file of measurements", "--data FILE"]),
    (["model.py:make", "--data", "y.csv", "--filter.n", "3"], ["filter: expected a name"]),
    (["model.py:make", *GOOD[:-1], "particle", "--filter.n", "many"], ["filter n: expected a whole number", "'many'"]),
    (["model.py:make", *GOOD[:-1], "particle", "--filter.n", "9", "--filter.policy", "often"], ["filter policy kind"]),
    (["model.py:make", "--data", "y.csv", "--data.columns", "a", "z", "--filter", "kalman"], ["y.csv: expected a column 'z'", "t, a, b"]),
    (["model.py:make", "--data", "y.csv", "--data.columns", "a", "--filter", "kalman"], ["ys: expected shape (t, 2)"]),
    (["model.py:make", "--data", "none.csv", "--filter", "kalman"], ["none.csv"]),
    (["model.py:make", *GOOD, "--filter"], ["--filter: expected a value after it"]),
    (["model.py:constant", *GOOD], ["expected a function constant", "got int 3"]),
    (["no_such_module:make", *GOOD], ["a file is named FILE.py:FUNCTION"]),
    (["model.py:make", *GOOD, "--filter.gate", "0.9", "--filter.gate", "0.8"], ["--filter.gate: expected one value", "0.9 and 0.8"]),
    (["model.py:make", *GOOD[:-1], "particle", "--n", "0"], ["n: expected a whole number of at least 1"]),
    (["model.py:make", *GOOD[:-1], "particle", "--n", "70000000"], ["n: expected at most 50000000 particles"]),
    (["model.py:make", *GOOD, "--smoother", "backward simulation", "--smoother.n", "10"], ["laws of the kind Cloud", "got Gaussian"]),
    (["model.py:make", *GOOD[:-2], "--filters.a/b", "kalman"], ["filters 'a/b': expected a name for files"]),
    (["model.py:several", *GOOD, "--filter.gate.c", "0.9"], ["gate: expected gates of a, b", "'c'"]),
]


@pytest.mark.parametrize(("words", "parts"), REFUSALS, ids=lambda value: value[0] if isinstance(value, list) else str(value))
def test_what_cannot_be_is_one_line(folder, capsys, words, parts):
    before = sorted(folder.iterdir())
    refused(capsys, ["run", *words], *parts)
    assert [path for path in sorted(folder.iterdir()) if path.name not in ("cache", "__pycache__")] == before


@pytest.mark.parametrize(("text", "parts"), [
    ("filter = 3", ["filter: expected a name, or a table"]),
    ("smoother = 3\nfilter = 'kalman'", ["smoother: expected a name, or a table"]),
    ("filters = ['kalman']", ["filters: expected filters by names of your own"]),
    ("[filters.'../out']\nkind = 'kalman'", ["filters '../out': expected a name for files"]),
    ("[filters.'']\nkind = 'kalman'", ["filters '': expected a name for files"]),
])  # fmt: skip
def test_choices_in_a_file_that_cannot_be_are_one_line(folder, capsys, text, parts):
    Path("own.toml").write_text('application = "model.py:make"\ndata.file = "y.csv"\ndata.columns = ["a", "b"]\n' + text)
    refused(capsys, ["run", "own.toml"], *parts)
    assert not Path("out").exists()


@pytest.mark.parametrize(("words", "parts"), [(["--runs", "-3"], ["runs"]), (["--steps", "0"], ["steps: expected a whole number"])])
def test_a_study_that_cannot_be_leaves_nothing(folder, capsys, words, parts):
    refused(capsys, ["study", "model.py:make", "--filters.a", "kalman", *words], *parts)
    assert not Path("out").exists()


def test_choices_change_what_is_there_by_default(folder, capsys):
    """A parameter of a parameter, a gate by sensor, the number of particles, a module beside the file, rows of MATLAB."""
    from scipy.io import savemat

    assert build(Filter, {"kind": "particle", "policy": {"share": 0.3}}, "filter", 5) == mo.ParticleFilter(5, policy=mo.resampling.ESS(0.3))
    Path("beside.py").write_text("from model import several\n")
    Path("deep").mkdir()
    for name in ("beside.py", "model.py"):
        Path(name).rename(Path("deep") / name)
    savemat("y.mat", {"a": YS[:, 0], "b": YS[:, 1]})
    words = ["run", "deep/beside.py:several", "--data", "y.mat", "--data.columns", "b", "--filter", "kalman", "--filter.gate.b", "0.99"]
    assert main(words) == 0
    model = mo.replace(history_model(), sensor=mo.LinearGaussian([[0.0, 1.0]], np.eye(1)))
    wanted = mo.run(0, mo.KalmanFilter(gate=0.99), model, YS[:, 1:])
    np.testing.assert_allclose(mo.History.load("out/kalman.npz").mean, wanted.mean, rtol=1e-4, atol=1e-4)


def test_every_filter_can_be_chosen_by_name():
    known = kinds(Filter)
    assert {"ParticleFilter", "KalmanFilter", "JumpMarkovFilter", "PointMassFilter", "PaRIS"} <= set(known)
    assert build(Filter, "cubature kalman", "filter") == mo.CubatureKalmanFilter()
    given = {"kind": "regularized", "n": 10, "scheme": "stratified", "regularization": {"kind": "Regularization", "factor": 0.5}}
    try:
        found = build(Filter, given, "filter")
    except mo.MotesError:
        given.pop("regularization")
        found = build(Filter, given, "filter")
    assert found.n == 10 and found.scheme == mo.resampling.Stratified()
    around = {"kind": "AdaptiveSize", "filter": {"kind": "particle", "n": 5}, "sizes": [10, 20], "widths": [1, 2.5]}
    assert build(Filter, around, "filter") == mo.AdaptiveSize(mo.ParticleFilter(n=5), (10, 20), (1, 2.5))


def test_flags_are_taken_apart():
    found, rest = flags_of(["--seed", "1", "--filter", "particle", "--filter.n=20", "--filter.linear", "vx,vy", "--out", "x"], ("filter",))
    assert found == {"filter": {"kind": "particle", "n": 20, "linear": ["vx", "vy"]}} and rest == ["--seed", "1", "--out", "x"]
    assert merged({"kind": "particle", "n": 3}, {"n": 5}) == {"kind": "particle", "n": 5}
    assert merged({"kind": "particle", "n": 3}, {"kind": "kalman"}) == {"kind": "kalman"}


def test_the_number_of_particles_reaches_filters_inside_of_others():
    inner = mo.Recovering(mo.ParticleFilter(n=9_000), lambda key, y, u, t: y)
    found = with_size({"plain": inner, "sized": mo.AdaptiveSize(inner, (200, 2_000, 9_000), (1.0,))}, 3_000)
    assert found["plain"].filter.n == 3_000 and found["sized"].sizes == (200, 2_000, 3_000)
