"""A robot with a laser in a building: maps and scans as files, what is refused, a start that nobody knows, a kidnapping."""

import json
from pathlib import Path

import numpy as np
import pytest

import motes as mo
from data import refused
from motes.applications.laser.grid import read_grid, write_grid
from motes.applications.laser.job import load
from motes.applications.laser.scans import read_scans, write_scans
from motes.applications.laser.settings import Settings
from motes.applications.laser.world import building, driven
from motes.cli.main import main


def test_a_map_is_read_as_it_is_written(tmp_path):
    write_grid(tmp_path / "map.yaml", building())
    found = read_grid(tmp_path / "map.yaml")
    assert np.array_equal(found.occupied, building().occupied) and np.array_equal(found.free, building().free)
    assert found.resolution == 0.1 and found.origin == (0.0, 0.0)


@pytest.mark.parametrize(("old", "new", "words"), [
    ("resolution: 0.1", "resolution: -1", ("resolution", "above 0", "-1")),
    ("resolution: 0.1", "resolution: __import__('os')", ("resolution", "above 0")),
    ("origin: [0.0, 0.0, 0.0]", "origin: [0.0, 0.0, 0.5]", ("origin", "0.5")),
    ("negate: 0", "", ("negate",)),
    ("negate: 0", "negate: maybe", ("negate", "0 or 1", "maybe")),
    ("free_thresh: 0.196", "free_thresh: 0.9", ("occupied_thresh", "above free_thresh")),
    ("free_thresh: 0.196", "free_thresh", ("key: value", "line 5")),
    ("image: map.png", "image: other.png", ("other.png",)),
    ("image: map.png", "image: map.yaml", ("PNG",)),
])  # fmt: skip
def test_maps_are_refused(tmp_path, old, new, words):
    path = tmp_path / "map.yaml"
    write_grid(path, building())
    path.write_text(path.read_text().replace(old, new))
    with pytest.raises(mo.FileError) as error:
        read_grid(path)
    refused(error, *words)


def test_scans_are_read_as_they_are_written_and_refused(tmp_path):
    path, scans = tmp_path / "scans.csv", driven(0, 60.0, 30.0, 0.1)[1]
    write_scans(path, scans)
    assert all(np.array_equal(one, other, equal_nan=True) for one, other in zip(read_scans(path), scans, strict=True))
    text = path.read_text()
    for old, new, words in (("range_", "beam_", ("range_0",)), ("forward", "ahead", ("forward",)), ("\n0.5,", "\n0.5,nan,-1,", ())):
        path.write_text(text.replace(old, new))
        with pytest.raises(mo.FileError) as error:
            read_scans(path)
        refused(error, "scans.csv", *words)
    negative = scans._replace(ranges=np.where(np.arange(24) == 3, -2.0, scans.ranges))
    write_scans(path, negative)
    with pytest.raises(mo.FileError) as error:
        read_scans(path)
    refused(error, "0 or more", "-2.0")


@pytest.mark.parametrize(("changes", "word"), [
    ({"seconds": 10.0}, "seconds"), ({"kidnap": 900.0}, "kidnap"), ({"outliers": 1.0}, "outliers"), ({"map": "map.yaml"}, "map alone"),
])  # fmt: skip
def test_settings_are_refused(changes, word):
    with pytest.raises(mo.MotesError) as error:
        load(Settings(**changes), 0)
    refused(error, word)


def test_it_is_shown_and_runs_again_from_its_files(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("motes.applications.laser.pictures.PICTURES", 2)
    assert main(["demo", "laser", "--seconds", "60", "--n", "300"]) == 0
    assert json.loads(Path("out/summary.json").read_text())["application"] == "laser"
    assert main(["run", "out/laser.toml", "--out", "again"]) == 0
    one, other = (mo.History.load(f"{folder}/recovering.npz").mean for folder in ("out", "again"))
    assert np.array_equal(one, other)


def run(seed, **settings):
    job = load(Settings(kidnap=100.0, **settings), seed)
    return [score.value for score in job.scores(mo.run(seed, job.filters["recovering"], job.model, job.ys, job.inputs))]


@pytest.mark.optimized
@pytest.mark.night
def test_a_start_anywhere_is_found_and_a_kidnapping_survived():
    found = [run(seed) for seed in range(20)]
    assert sum(one[0] is not None for one in found) >= 19, found
    assert sum(one[2] is not None for one in found) >= 18, found


@pytest.mark.optimized
@pytest.mark.night
def test_outliers_cost_little():
    clean, wrong = (np.median([run(seed, outliers=share)[1] for seed in (0, 2, 3, 4, 7)]) for share in (0.0, 0.1))
    assert wrong <= 1.3 * clean
