"""A robot with a laser in a building: maps and scans as files, what is refused, a start that nobody knows, a kidnapping."""

import json
from pathlib import Path

import jax
import numpy as np
import pytest

import motes as mo
from data import refused
from motes.applications.laser.grid import read_grid, write_grid
from motes.applications.laser.job import load
from motes.applications.laser.model import LikelihoodField, hit_sd, poses_of, seeking, usual
from motes.applications.laser.scans import read_scans, write_scans
from motes.applications.laser.settings import Settings
from motes.applications.laser.world import building, driven
from motes.cli.main import main
from motes.io.dialect import TableFile


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
    assert all(np.array_equal(one, other, equal_nan=True) for one, other in zip(read_scans(path)[:6], scans[:6], strict=True))
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


@pytest.mark.night
def test_it_is_shown_and_runs_again_from_its_files(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("motes.applications.laser.pictures.PICTURES", 2)
    assert main(["demo", "laser", "--seconds", "60", "--n", "300"]) == 0
    assert json.loads(Path("out/summary.json").read_text())["application"] == "laser"
    assert main(["run", "out/laser.toml", "--out", "again"]) == 0
    one, other = (mo.History.load(f"{folder}/recovering.npz").mean for folder in ("out", "again"))
    assert np.array_equal(one, other)


def test_a_place_is_sought_by_scans():
    """Uniform poses would be so near two times in 10 000; along the corridor much looks alike."""
    grid, scans = driven(0, 60.0, 0.0, 0.0)
    draw, keys = seeking(LikelihoodField.of(grid, scans.bearings), poses_of(grid)), jax.random.split(jax.random.key(0), 500)
    sought = jax.jit(lambda y: jax.vmap(lambda key: draw(key, y, None, 0))(keys))
    off = np.stack([np.asarray(sought(scans.ranges[step])) - scans.poses[step] for step in range(20, 120, 20)])
    near = (np.hypot(off[..., 0], off[..., 1]) < 0.7) & (np.abs(np.angle(np.exp(1j * off[..., 2]))) < 0.2)
    assert near.mean() > 0.02


def test_a_scan_from_where_the_robot_is_has_the_usual_density_and_no_other():
    grid, scans = driven(1, 60.0, 0.0, 0.1)
    field, late = LikelihoodField.of(grid, scans.bearings), 100
    beyond = jax.jit(jax.vmap(lambda y, x: field.log_prob(y, x, hit_sd(late)) - usual(y, None, late)))
    assert np.mean(beyond(scans.ranges, scans.poses)) > 0
    assert np.median(beyond(scans.ranges, scans.poses[::-1])) < -3


def scored(job, seed):
    """Seconds until the robot is found, and the error from then on; the same after a kidnapping."""
    jax.clear_caches()
    return [score.value for score in job.scores(mo.run(seed, job.filters["recovering"], job.model, job.ys, job.inputs))]


@pytest.mark.optimized
@pytest.mark.night
@pytest.mark.parametrize("first", [0, 100])
def test_a_start_anywhere_is_found_and_a_kidnapping_survived(first):
    found = [scored(load(Settings(kidnap=100.0), seed), seed) for seed in range(first, first + 20)]
    for seconds, error in ((0, 1), (2, 3)):
        assert sum(one[seconds] is not None and one[seconds] <= 30 and one[error] <= 0.5 for one in found) >= 19, found


def found_by_files(folder, seed, outliers):
    """Seconds until the robot is found on a map and a recording of its own, and the error from then on."""
    grid, scans = driven(seed, 100.0, 0.0, outliers)
    write_grid(folder / "map.yaml", grid)
    write_scans(folder / "scans.csv", scans)
    return scored(load(Settings(map=str(folder / "map.yaml"), data=TableFile(file=str(folder / "scans.csv"))), seed), seed)


@pytest.mark.optimized
@pytest.mark.night
def test_outliers_in_a_recording_cost_little(tmp_path):
    """Of 20 recordings with a tenth of the beams wrong, 19 are found, and the error is at most 1.3 times that without."""
    clean, wrong = (np.array([found_by_files(tmp_path, seed, share) for seed in range(20)], float) for share in (0.0, 0.1))
    both = ~np.isnan(clean[:, 1]) & ~np.isnan(wrong[:, 1])
    assert both.sum() >= 19, (clean, wrong)
    rms = [np.sqrt(np.mean(one[both, 1] ** 2)) for one in (clean, wrong)]
    assert rms[1] <= 1.3 * rms[0], (clean, wrong)
