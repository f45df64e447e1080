"""The command line as its users meet it."""

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from data import recorded
from motes.cli.main import main
from motes.core.kept import programs

MARGINALIZED = 'kind = "MarginalizedParticleFilter"\nn = 150'
COMMAND = "import sys; from motes.cli.main import main; sys.exit(main())"


@pytest.fixture(scope="module")
def demo(tmp_path_factory):
    """A small demonstration, flown once; what is kept for the user is kept apart from the user's own."""
    home = tmp_path_factory.mktemp("home")
    with pytest.MonkeyPatch.context() as surroundings:
        surroundings.setenv("XDG_CACHE_HOME", str(home / "cache"))
        assert main(["demo", "terrain", "--n", "150", "--out", str(home / "out")]) == 0
        yield home / "out"


@pytest.fixture
def folder(demo, tmp_path):
    """A folder with the demonstration's flight alone."""
    for name in ("terrain.toml", "flight.csv", "jacksboro_fault_dem.npz"):
        shutil.copy(demo / name, tmp_path)
    return tmp_path


def refused(capsys, arguments, *words):
    """Assert exit code 2 and one line that holds the words."""
    code = main([str(argument) for argument in arguments])
    lines = capsys.readouterr().err.strip().splitlines()
    assert code == 2 and len(lines) == 1, (code, lines)
    assert len(lines[0]) <= 560 and "Traceback" not in lines[0]
    for word in words:
        assert word in lines[0], (word, lines[0])


def change(folder, old, new):
    path = folder / "terrain.toml"
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))
    return path


def test_demo_writes_everything(demo):
    names = {path.name for path in demo.iterdir()}
    histories = {f"{filter}.{form}" for filter in ("marginalized", "particle") for form in ("nc", "npz")}
    assert names == histories | {"summary.json", "track.csv", "particle_track.csv", "map.png", "states.png", "error.png", "flight.csv",
                                 "terrain.toml", "jacksboro_fault_dem.npz"}
    summary = json.loads((demo / "summary.json").read_text())
    assert summary["settings"]["n"] == 150 and "jax_version" in summary["provenance"]
    assert set(summary["results"]) == {"marginalized", "particle"}
    assert summary["results"]["marginalized"]["milliseconds_per_step"] > 0


@pytest.mark.night
def test_run_repeats_the_demo(folder, demo, capsys):
    assert main(["run", str(folder / "terrain.toml"), "--seed", "1"]) == 0
    printed = capsys.readouterr().out
    assert "marginalized" in printed and printed.count("Terrain: rough enough: ") == 1
    assert {"marginalized.nc", "summary.json", "map.png", "error.png"} <= {path.name for path in (folder / "run").iterdir()}
    summary = json.loads((folder / "run" / "summary.json").read_text())
    assert summary["settings"]["seed"] == 1 and summary["settings"]["noises"]["altimeter"] == 15.0


@pytest.mark.night  # much to compile
def test_run_with_fifteen_states(folder, capsys):
    change(folder, "states = 9", "states = 15")
    assert main(["run", str(folder / "terrain.toml"), "--n", "60"]) == 0
    assert "Terrain: rough enough: " in capsys.readouterr().out
    summary = json.loads((folder / "run" / "summary.json").read_text())
    assert summary["settings"]["inertial"] == {"states": 15, "grade": "tactical"}
    assert summary["results"]["marginalized"]["final_error_m"] < 3000
    assert (folder / "run" / "states.png").is_file() and (folder / "run" / "error.png").is_file()


@pytest.mark.night
def test_run_without_truth_on_parquet(folder, capsys):
    arrow, parquet = pytest.importorskip("pyarrow"), pytest.importorskip("pyarrow.parquet")
    from motes.io.tables import read_table

    table = {name: values[:41] for name, values in read_table(folder / "flight.csv").items()}
    table["height"][3] = float("nan")
    parquet.write_table(arrow.table(table), folder / "flight.parquet")
    change(folder, '"flight.csv"', '"flight.parquet"')
    change(folder, 'truth = ["true_north", "true_east"]', "")
    words = ["--filter", "marginalized", "--filter.n", "150", "--filter.linear", "rD,vD,aD"]
    assert main(["run", str(folder / "terrain.toml"), "--out", str(folder / "mine"), *words]) == 0
    assert {path.name for path in (folder / "mine").iterdir()} == {"marginalized.nc", "marginalized.npz", "summary.json", "map.png",
                                                                   "states.png", "track.csv"}  # fmt: skip


@pytest.mark.parametrize(("old", "new", "words"), [
    ("seed = 0", "seed = ", ("TOML", "line")),
    ("seed = 0", "sead = 0", ("'sead'", "seed", "filter")),
    ('application = "terrain"', 'application = "moon"', ("application", "terrain", "'moon'")),
    ('application = "terrain"', "", ("terrain.toml: application", "'terrain'", "none")),
    ("[route]", "[rout]", ("'rout'", "route")),
    ("[filters.particle]", "[filters.more.particle]", ("filters.more kind", "'more'")),
    ("n = 150", 'n = 150\npolizy = "ess"', ("filters.marginalized", "'polizy'", "policy")),
    ("n = 150", "n = 0", ("n:", "at least 1")),
    ("n = 150", "n = 1e3", ("filters.marginalized n", "whole number")),
    ("n = 150", "n = 900000000000", ("filters.marginalized n", "at most")),
    ("seed = 0", "seed = 0\nn = 900000000000", ("n:", "at most")),
    (f"{MARGINALIZED}", f'{MARGINALIZED}\nlinear = ["vX"]', ("vX",)),
    (f"{MARGINALIZED}", f'{MARGINALIZED}\nlinear = ["rN"]', ("rN",)),
    ("n = 150", 'n = 150\npolicy = { kind = "ESS", share = 7 }', ("ESS share",)),
    (f"{MARGINALIZED}", 'kind = "kalmann"', ("filters.marginalized kind", "'kalmann'")),
    ("n = 150", 'n = 150\npolicy = "sometimes"', ("filters.marginalized policy kind", "'sometimes'")),
    ("seed = 0", "seed = 0\n[plan]\nbudged = 3", ("[plan]", "'budged'", "budget")),
    ("seed = 0", "seed = 0\nstudy = 3", ("study", "a table")),
    ("seed = 0", "seed = -4", ("seed", "-4")),
    ("altimeter = 15.0", "altimeter = nan", ("altimeter", "nan")),
    ("altimeter = 15.0", "altimeter = 1e-30", ("altimeter", "1e-30")),
    ("altimeter = 15.0", "altimeter = 1e30", ("altimeter", "1e+30")),
    ("altimeter = 15.0", 'altimeter = "15"', ("[noises] altimeter", "a number")),
    ('"flight.csv"', '"none.csv"', ("none.csv",)),
    ('"flight.csv"', '"terrain.toml"', ("terrain.toml",)),
    ('["jacksboro_fault_dem.npz"]', '["none.npz"]', ("none.npz",)),
    ('["jacksboro_fault_dem.npz"]', '["flight.csv"]', ("flight.csv",)),
    ('["jacksboro_fault_dem.npz"]', "[3]", ("[map] files", "list of texts")),
    ('height = "height"', 'height = "radar"', ("'radar'", "ins_north")),
    ('coordinates = "local"', 'coordinates = "map"', ("map", "covers", "outside")),
    ('outside = "refuse"', 'outside = "ignore"', ("map outside", "'missing'", "'ignore'")),
    ("states = 9", "states = 12", ("inertial states", "9 or 15", "12")),
    ('grade = "tactical"', 'grade = "cheap"', ("inertial grade", "'tactical'", "'cheap'")),
    ("gyro_bias = 0.06", "gyro_bias = 0", ("prior gyro_bias", "0")),
    ('out = "run"', 'out = "flight.csv"', ("flight.csv", "folder")),
])
def test_bad_settings_are_refused(folder, capsys, old, new, words):
    path = change(folder, old, new)
    before = sorted(folder.iterdir())
    refused(capsys, ["run", path], "motes run:", *words)
    assert sorted(folder.iterdir()) == before


@pytest.mark.parametrize(("line", "column", "value", "words"), [
    (5, 4, "high", ("line 5", "'height'", "'high'")),
    (5, 0, "0.1", ("times", "line 5")),
    (5, 1, "", ("'ins_north'", "row 4")),
    (5, 2, "inf", ("finite", "'ins_east'")),
])
def test_bad_tables_are_refused(folder, capsys, line, column, value, words):
    lines = (folder / "flight.csv").read_text().splitlines()
    cells = lines[line - 1].split(",")
    cells[column] = value
    lines[line - 1] = ",".join(cells)
    (folder / "flight.csv").write_text("\n".join(lines))
    refused(capsys, ["run", folder / "terrain.toml"], *words)
    assert not (folder / "run").exists()


def test_maps_are_refused(folder, capsys):
    # a virtual raster may name any file or address: it must not be opened
    (folder / "map.tif").write_text('<VRTDataset rasterXSize="9" rasterYSize="9"></VRTDataset>')
    refused(capsys, ["run", folder / "terrain.toml", "--map.files", folder / "map.tif"], "map.tif")
    elsewhere = recorded("terrain/dted/w121/n36.dt1")
    change(folder, 'coordinates = "local"', 'coordinates = "map"')
    refused(capsys, ["run", folder / "terrain.toml", "--map.files", elsewhere], "map", "covers")
    assert not (folder / "run").exists()


def test_plan_hands_over_what_the_file_says(folder, monkeypatch, capsys):
    asked = {}

    def plan(model, budget, **options):
        asked.update(options, model=model, budget=budget)
        return "the plan"

    monkeypatch.setattr("motes.planning.plan.plan", plan)
    assert main(["plan", str(folder / "terrain.toml"), "--budget", "2.5ms", "--steps", "30", "--runs", "4", "--seed", "9"]) == 0
    assert capsys.readouterr().out == "the plan\n"
    assert asked["budget"] == pytest.approx(2.5e-3) and asked["states"] == ("rN", "rE") and asked["verify"] is False
    assert (asked["pilot"].runs, asked["pilot"].seed, asked["pilot"].inputs.north.shape) == (4, 9, (30,))
    for budget in ("5", "0ms", "ms", "-1s", "five ms"):
        refused(capsys, ["plan", folder / "terrain.toml", f"--budget={budget}"], "budget", "5ms", repr(budget))


@pytest.mark.parametrize(("arguments", "words"), [
    (["fly"], ("'fly'", "demo")),
    (["demo", "moon"], ("'moon'", "terrain")),
    (["demo", "--n", "abc"], ("--n", "abc")),
    (["demo", "--m", "3"], ("--m",)),
    (["demo", "--filter", "best"], ("filter kind", "'best'")),
    (["demo", "--noises.position", "-1"], ("noises position", "-1")),
    (["demo", "--route.fixes", "0"], ("route fixes", "0")),
    (["demo", "--filters.a.n", "9"], ("filters.a kind", "'a'")),
    (["demo", "--filters", "particle"], ("filters", "names of your own")),
    (["demo", "--filter", "kalman", "--n", "9"], ("n:", "filters with particles", "kalman")),
    (["demo", "robot", "--odometry", "none"], ("--odometry",)),
    (["demo", "aircraft", "--duration", "5"], ("duration", "5")),
    (["demo", "model.py:make"], ("'model.py:make'", "terrain")),
    (["run", "moon"], ("'moon'", "terrain", "MODULE:FUNCTION")),
    (["study", "terrain", "--steps", "500"], ("steps", "at most 400", "500")),
    (["demo", "--out", "/proc/none/out"], ("/proc/none/out", "folder")),
    (["run"], ("TOML", "nothing")),
    (["run", "none.toml"], ("none.toml",)),
    (["run", "--seed", "3"], ("TOML", "--seed")),
    (["plan", "--seed", "3"], ("TOML", "--seed")),
    (["plan", "none.toml"], ("none.toml",)),
    (["doctor", "now"], ("now",)),
])
def test_bad_words_are_refused(tmp_path, monkeypatch, capsys, arguments, words):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    refused(capsys, arguments, *words)
    assert not (tmp_path / "out").exists()


def test_interruption(monkeypatch, capsys):
    def interrupted(words):
        raise KeyboardInterrupt

    monkeypatch.setattr("motes.cli.doctor.main", interrupted)
    assert main(["doctor"]) == 130
    assert capsys.readouterr().err == "motes doctor: interrupted\n"


@pytest.mark.parametrize(("error", "words"), [
    (MemoryError(), ("memory", "fewer particles")),
    (RuntimeError("RESOURCE_EXHAUSTED: Out of memory allocating 9 bytes."), ("memory", "fewer particles")),
    (RuntimeError("Unable to initialize backend 'moon'"), ("device", "'moon'")),
])
def test_machines_that_cannot_are_told_in_one_line(monkeypatch, capsys, error, words):
    def failing(arguments):
        raise error

    monkeypatch.setattr("motes.cli.doctor.main", failing)
    refused(capsys, ["doctor"], *words)
    error.args = ("a fault of ours",)
    if not isinstance(error, MemoryError):
        with pytest.raises(RuntimeError):
            main(["doctor"])


def test_cache_that_others_can_use_is_made_private(tmp_path, monkeypatch):
    from motes.core.kept import private_folder

    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    place = tmp_path / "motes" / "compiled"
    place.mkdir(parents=True)
    place.chmod(0o777)
    assert private_folder("compiled") == place and place.stat().st_mode & 0o777 == 0o700
    shutil.rmtree(place)
    place.symlink_to(tmp_path)
    assert private_folder("compiled") is None
    monkeypatch.setenv("XDG_CACHE_HOME", "/proc/none")
    assert private_folder("compiled") is None


def test_compiled_programs_are_kept_for_the_next_call(tmp_path):
    def kept(imports, **environment):
        clean = {name: value for name, value in os.environ.items() if not name.startswith("JAX_")}
        code = f"import {imports}, jax; print(jax.config.jax_compilation_cache_dir, jax.config.jax_persistent_cache_min_compile_time_secs)"
        found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True,
                               env=clean | {"XDG_CACHE_HOME": str(tmp_path)} | environment).stdout
        return found.split()

    folder = str(tmp_path / "motes" / programs())
    assert kept("motes, jax") == kept("jax, motes") == [folder, "0.2"] and Path(folder).stat().st_mode & 0o777 == 0o700
    assert kept("motes", MOTES_CACHE="off")[0] == kept("motes", MOTES_CACHE="0")[0] == "None"
    assert kept("motes", JAX_COMPILATION_CACHE_DIR="/mine") == ["/mine", "1.0"]
    assert kept("motes", JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS="3") == [folder, "3.0"]


def shell(*arguments, **environment):
    return subprocess.run([sys.executable, "-c", COMMAND, *map(str, arguments)], capture_output=True, text=True, timeout=120,
                          env=os.environ | environment)


def test_help_is_quick_and_does_not_import_jax():
    code = COMMAND.replace("sys.exit(main())", "main(); sys.exit('jax' in sys.modules or 'tyro' in sys.modules)")
    for arguments in (["--help"], []):
        done = subprocess.run([sys.executable, "-c", code, *arguments], capture_output=True, text=True, timeout=60)
        assert done.returncode == 0 and "doctor" in done.stdout
    done = shell("run", "--help")
    assert done.returncode == 0 and "--filter.n" in done.stdout


def test_real_process_refuses_in_one_line(folder):
    done = shell("run", change(folder, 'height = "height"', 'height = "radar"'))
    assert done.returncode == 2 and len(done.stderr.strip().splitlines()) == 1 and "'radar'" in done.stderr


def test_doctor(tmp_path):
    done = shell("doctor", XDG_CACHE_HOME=str(tmp_path))
    assert done.returncode == 0 and not done.stderr
    for word in ("motes", "jax", "precision", "devices", "matplotlib", "processors", str(Path(tmp_path) / "motes")):
        assert word in done.stdout


def test_report_of_a_run(tmp_path, monkeypatch, capsys):
    import motes as mo

    model = mo.StateSpaceModel(mo.Gaussian([0.0], [[1.0]]), mo.LinearGaussian([[0.9]], [[1.0]]), mo.LinearGaussian([[1.0]], [[1.0]]))
    history = mo.run(0, mo.KalmanFilter(), model, [[1.0], [2.0], [0.5]])
    monkeypatch.chdir(tmp_path)
    history.save("run.npz")
    assert main(["report", "run.npz"]) == 0
    assert str(history) in capsys.readouterr().out and "<h1>Run</h1>" in Path("report.html").read_text()
    kept = mo.run(0, mo.ParticleFilter(n=20), model, [[1.0], [2.0], [0.5]], keep=mo.keep.laws)
    for one, drawn in ((history, True), (kept, False)):
        page = mo.report(one, "again.html").read_text()
        assert (re.findall(r'"drawn": ?(\w+)', page), "drawn from mean" in page) == ([str(drawn).lower()] * 3, True)
    refused(capsys, ["report", "none.npz"], "none.npz")


def test_report_of_a_store(tmp_path, monkeypatch, capsys):
    import motes as mo

    model = mo.StateSpaceModel(mo.Gaussian([0.0], [[1.0]]), mo.LinearGaussian([[0.9]], [[1.0]]), mo.LinearGaussian([[1.0]], [[1.0]]))
    result = mo.study(mo.Experiment(model, {"kalman": mo.KalmanFilter()}, steps=4, runs=3), store=tmp_path / "runs")
    assert main(["report", str(tmp_path / "runs"), "--out", str(tmp_path / "page.html"), "--title", "Mine"]) == 0
    printed = capsys.readouterr().out
    assert "kalman" in printed and f"{result.table().column('RMSE')[0]:#.4g}" in printed and "page.html" in printed
    assert "<h1>Mine</h1>" in (tmp_path / "page.html").read_text()
    (tmp_path / "runs").rename(tmp_path / "-rf")
    monkeypatch.chdir(tmp_path)
    assert main(["report", "--", "-rf", "--out=-o.html"]) == 0 and (tmp_path / "-o.html").is_file()
    assert main(["report", "./-rf"]) == 0 and (tmp_path / "report.html").is_file()
    refused(capsys, ["report", "-rf"], "options", "-rf")
    refused(capsys, ["report", "--"], "the folder of a study or the file of a run first")
    refused(capsys, ["run", "--", "-none.toml"], "-none.toml")
    (tmp_path / "-rf").rename(tmp_path / "runs")
    refused(capsys, ["report"], "the folder of a study or the file of a run first", "nothing")
    refused(capsys, ["report", tmp_path], "ledger.sqlite", "the ledger of a study")
    refused(capsys, ["report", tmp_path / "runs", "--out", "page.txt"], "page.txt", ".html")
    refused(capsys, ["report", tmp_path / "runs", "--outt", "x"], "--outt")
