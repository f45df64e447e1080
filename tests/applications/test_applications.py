"""Applications: found by their folder, shown without data, run again from the files that they write, each in a folder of its own."""

import dataclasses
import importlib
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

import motes as mo
import motes.applications
from motes.cli.asked import Plan, Run, Study, applications, asked
from motes.cli.main import main
from motes.cli.options import read_toml
from motes.cli.records import build, choice_of
from motes.cli.toml import helps, written
from motes.filters.interface import Filter

WALK = {
    "__init__": '"""A walker, seen badly."""\n',
    "settings": '''"""Settings of the walk."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Settings:
    """Follow a walker.

    Attributes:
        length: steps to go.
        spread: of what is measured, m.
    """

    length: int = 30
    spread: float = 0.5
''',
    "job": '''"""The walk as a job."""

import jax.numpy as jnp

import motes as mo
from motes.applications.interface import Job, Score


def load(settings, seed):
    walk = mo.LinearGaussian(jnp.eye(2), 0.1 * jnp.eye(2))
    sensor = mo.LinearGaussian(jnp.eye(2), settings.spread**2 * jnp.eye(2))
    model = mo.StateSpaceModel(mo.Gaussian(jnp.zeros(2), jnp.eye(2)), walk, sensor, ("east", "north"))
    xs, ys = mo.simulate(seed, model, settings.length)
    return Walk(model=model, ys=ys, truth=xs, filters={"kalman": mo.KalmanFilter()})


class Walk(Job):
    def about(self):
        return "Off we go."

    def scores(self, history):
        return (Score("distance", 12.5, "m", 1),)
''',
}


@pytest.fixture
def walk(tmp_path, monkeypatch):
    """An application of one folder, which nothing else knows of."""
    folder = tmp_path / "rooms" / "walk"
    folder.mkdir(parents=True)
    for name, text in WALK.items():
        (folder / f"{name}.py").write_text(text)
    monkeypatch.setattr(motes.applications, "__path__", [*motes.applications.__path__, str(folder.parent)])
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.chdir(tmp_path)
    yield "walk"
    for name in [name for name in sys.modules if name.startswith("motes.applications.walk")]:
        del sys.modules[name]


def test_a_new_application_is_one_folder(walk, capsys):
    assert main(["demo", "walk", "--spread", "0.25", "--seed", "3"]) == 0
    said = capsys.readouterr().out
    assert "Off we go." in said and "distance, m" in said and "12.5" in said
    assert json.loads(Path("out/summary.json").read_text())["results"]["kalman"]["distance_m"] == 12.5
    assert read_toml("out/walk.toml")["spread"] == 0.25
    assert main(["run", "out/walk.toml", "--out", "again"]) == 0
    assert np.array_equal(mo.History.load("again/kalman.npz").mean, mo.History.load("out/kalman.npz").mean)
    assert main(["study", "out/walk.toml", "--runs", "3", "--steps", "5", "--filters.few", "particle", "--filters.few.n", "40"]) == 0
    assert mo.studies.StudyResult.load("out/run/runs").filters == ("kalman", "few")
    assert main(["run", "walk", "--length", "0"]) == 2


@pytest.mark.parametrize("name", applications())
def test_settings_cost_no_import_and_are_explained(name):
    code = f"import sys, motes.applications.{name}.settings; sys.exit('jax' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], timeout=60).returncode == 0
    settings = importlib.import_module(f"motes.applications.{name}.settings").Settings
    assert {field.name for field in dataclasses.fields(settings)} <= set(helps(settings)), "each has its help"
    assert all(asked(kind, [name], "motes").own() == settings() for kind in (Run, Plan, Study))


def test_settings_named_as_options_are_refused(walk, tmp_path, capsys):
    file = tmp_path / "rooms" / "walk" / "settings.py"
    file.write_text(file.read_text().replace("length", "steps"))
    assert main(["run", "walk"]) == 2
    assert "application walk: expected settings by other names than those of the commands, got steps" in capsys.readouterr().err


@pytest.mark.parametrize("name", applications())
def test_settings_are_their_file(name, tmp_path):
    settings = importlib.import_module(f"motes.applications.{name}.settings").Settings
    (tmp_path / "x.toml").write_text(f'application = "{name}"\nout = "x"\n\n' + written(settings(), tmp_path))
    assert asked(Run, [str(tmp_path / "x.toml")], "motes run").own() == settings()


SHORT = {"terrain": ("--route.fixes", "41", "--n", "300"), "robot": ("--seconds", "60", "--n", "60"),
         "aircraft": ("--duration", "600", "--plots.steps", "200", "--n", "40"),
         "laser": ("--seconds", "60", "--n", "300"), "slam": ("--seconds", "60", "--n", "5"),
         "mode_s": ("--seconds", "0.004", "--aircraft", "2"),
         "target_tracking": ("--scans", "20", "--n", "100"), "video": ("--frames", "24")}  # fmt: skip


@pytest.mark.night
@pytest.mark.parametrize("name", sorted(set(applications()) - {"terrain"}))
def test_each_is_shown_without_data_and_runs_again_from_its_files(name, tmp_path, monkeypatch, capsys):
    """That of the terrain: tests/cli."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.chdir(tmp_path)
    assert main(["demo", name, *SHORT[name], "--seed", "2"]) == 0
    found = json.loads(Path("out/summary.json").read_text())
    assert found["application"] == name and all(isinstance(one["median_ess"], float) for one in found["results"].values())
    assert main(["run", f"out/{name}.toml", "--out", "again"]) == 0
    for file in Path("out").glob("*.npz"):
        one, other = (np.asarray(mo.History.load(folder / file.name).mean) for folder in (Path("out"), Path("again")))
        assert np.array_equal(one, other)


def test_filters_are_written_as_they_are_read():
    for filter in (mo.ParticleFilter(n=5), mo.MarginalizedParticleFilter(n=7, linear=("vx",), policy=mo.resampling.ESS(0.3)),
                   mo.JumpMarkovFilter(n=9, sampled=("turn",)), mo.InteractingMultipleModel(),
                   mo.AdaptiveSize(mo.ParticleFilter(n=5), (10, 20), (1.0, 2.5))):  # fmt: skip
        assert build(Filter, choice_of(filter), "filter") == filter


STUDY = """application = "terrain"

[route]
fixes = 8

[study]
runs = 60

[filters.particle]
n = 300

[filters.few]
kind = "particle"
n = 50
"""


def blocks(folder):
    return len(list(Path(folder).glob("part*.npz"))) if Path(folder).is_dir() else 0


@pytest.mark.night
def test_a_study_of_the_terrain_is_killed_and_goes_on(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.chdir(tmp_path)
    Path("terrain.toml").write_text(STUDY)
    code = "from motes.cli.main import main; main()"
    paths = os.pathsep.join(filter(None, sys.path))
    process = subprocess.Popen([sys.executable, "-c", code, "study", "terrain.toml", "--out", "killed"], stdout=subprocess.DEVNULL,
                               stderr=subprocess.DEVNULL, env=os.environ | {"PYTHONPATH": paths})  # fmt: skip
    while not blocks("killed/runs"):
        assert process.poll() is None, "it ended before anything was kept"
        time.sleep(0.02)
    process.send_signal(signal.SIGKILL)
    process.wait(60)
    begun = blocks("killed/runs")
    assert main(["study", "terrain.toml", "--out", "killed"]) == 0
    assert begun < blocks("killed/runs")
    assert main(["study", "terrain.toml", "--out", "whole"]) == 0
    assert mo.studies.StudyResult.load("killed/runs") == mo.studies.StudyResult.load("whole/runs")
    assert {"table.csv", "study.png", "report.html"} <= {path.name for path in Path("killed").iterdir()}
