"""A robot without a map: beacons whose ranges are rings, objects that it sees; recordings of both kinds, and what they must be."""

import io
import json

import jax
import numpy as np
import pytest
from batch_slam import solved

import motes as mo
from data import recorded, refused
from motes.applications.slam import recording as reading
from motes.applications.slam.job import laid_on, load, rms
from motes.applications.slam.settings import Settings
from motes.applications.slam.world import made_up
from motes.cli.main import main

pytestmark = pytest.mark.jax
SEEDS = 20


def scores(settings, seed, n=100):
    job = load(settings, seed)
    history = mo.run(seed, mo.LandmarkFilter(n=n), job.model, job.ys, job.inputs, keep=mo.keep.paths)
    return {one.name: one.value for one in job.scores(history)}


def test_beacons_that_nobody_surveyed_are_found_on_their_rings():
    found = scores(Settings(seconds=200.0), 3)
    assert found["path rms"] < 0.7 and found["landmarks rms"] < 1.0, found


@pytest.mark.night
def test_objects_are_mapped_and_the_odometry_corrected():
    job = load(Settings(seconds=300.0, sights="places"), 2)
    history = mo.run(2, mo.LandmarkFilter(n=100), job.model, job.ys, job.inputs, keep=mo.keep.paths)
    found = {one.name: one.value for one in job.scores(history)}
    assert found["path rms"] < 0.6 and found["landmarks rms"] < 0.6 < rms(job.way.truth, job.way.alone), found
    # the errors that the world has are found as well
    assert np.all(np.abs(np.asarray(history.mean)[-1, 3:] - [0.0015, 0.02]) < 5 * np.sqrt(np.diag(history.cov[-1])[3:]))


def test_a_path_is_laid_on_another_by_a_turn_and_a_shift():
    rng = np.random.default_rng(0)
    path = rng.normal(size=(9, 2))
    c, s = np.cos(2.5), np.sin(2.5)
    truth = path @ np.array([[c, s], [-s, c]]) + [3, -4]
    truth[4] = np.nan
    assert np.allclose(laid_on(truth, path)(path)[:4], truth[:4]) and rms(truth, path) < 1e-12


def test_what_was_written_is_read_back(tmp_path):
    world = made_up(1, 60.0)
    reading.write_graph(tmp_path / "graph.txt", world.graph)
    again = reading.read_graph(tmp_path / "graph.txt")
    assert np.array_equal(again.steps, world.graph.steps)
    order = np.lexsort(world.graph.seen.T[::-1])
    assert np.allclose(again.seen[np.lexsort(again.seen.T[::-1])], world.graph.seen[order])


GOOD = "ODOMETRY 0 1 1.0 0.0 0.1 9\nLANDMARK 1 7 2.0 3.0 0.4\nODOMETRY 1 2 1.0 0.0 0.0\n"
BAD = {
    "no number": (GOOD + "LANDMARK 2 7 x 3.0\n", 'line 4: expected "ODOMETRY i j dx dy dtheta" or "LANDMARK i k x y"'),
    "unknown line": ("EDGE 1 2\n" + GOOD, "line 1: expected"), "too short": ("ODOMETRY 0 1 1.0\n", "line 1: expected"),
    "not finite": (GOOD + "ODOMETRY 2 3 nan 0 0\n", "line 4: expected"), "no chain": (GOOD + "ODOMETRY 5 6 1 0 0\n", "a step from pose 2"),
    "no such pose": (GOOD + "LANDMARK 9 7 1 1\n", "landmarks seen from poses to which steps lead, got one from pose 9"),
    "nothing seen": ("ODOMETRY 0 1 1 0 0\n", "lines ODOMETRY and lines LANDMARK, got 1 and 0"), "empty": ("", "got 0 and 0"),
    "no text": ("\x00\xff", "no text"),
}  # fmt: skip


@pytest.mark.parametrize("name", BAD)
def test_a_file_that_is_no_recording_is_told_in_one_line(name, tmp_path):
    text, said = BAD[name]
    (tmp_path / "graph.txt").write_bytes(text.encode("latin-1"))
    with pytest.raises(mo.FileError) as error:
        load(Settings(data=str(tmp_path / "graph.txt")), 0)
    refused(error, said)


@pytest.mark.parametrize(("settings", "said"), [
    (Settings(gaussians=0), "gaussians"), (Settings(scale=0.0), "scale"), (Settings(seconds=5.0), "seconds"),
    (Settings(seconds=5.0, sights="places"), "seconds"), (Settings(data="missing.txt"), "a file that can be read"),
])  # fmt: skip
def test_settings_that_cannot_be_used(settings, said):
    with pytest.raises(mo.MotesError) as error:
        load(settings, 0)
    refused(error, said)


@pytest.mark.night
def test_the_command_writes_pictures_and_runs_again_from_its_files(tmp_path, capsys):
    main(["demo", "slam", "--seconds", "60", "--sights", "places", "--n", "20", "--out", str(tmp_path / "a")])
    assert "landmarks are on the map" in capsys.readouterr().out
    found = {path.name for path in (tmp_path / "a").iterdir()}
    assert {"map.png", "map.gif", "recording.txt", "slam.toml", "summary.json", "landmarks.npz"} <= found
    main(["run", str(tmp_path / "a" / "slam.toml"), "--out", str(tmp_path / "b")])
    one, other = (json.loads((tmp_path / name / "summary.json").read_text())["results"]["landmarks"]["log_likelihood"] for name in "ab")
    assert one == pytest.approx(other, rel=1e-4)
    with io.BytesIO((tmp_path / "a" / "map.gif").read_bytes()) as file:
        assert file.read(4) == b"GIF8"
    again = mo.History.load(tmp_path / "a" / "landmarks.npz")
    assert again.state.landmarks().mean.shape[1] == 2


@pytest.mark.night
@pytest.mark.optimized  # much to compute
def test_plaza_with_beacons_unknown():
    """20 seeds, 100 particles: path at most 0.6 m once laid on the truth, beacons at most 0.5 m on average, none lost."""
    file = str(recorded("robot/Plaza1_.mat"))
    found = [scores(Settings(data=file), seed) for seed in range(SEEDS)]
    paths, beacons = (np.array([one[name] for one in found]) for name in ("path rms", "landmarks rms"))
    assert paths.max() < 0.75 and paths.mean() < 0.6 and beacons.mean() < 0.5, (paths, beacons)


@pytest.mark.night
@pytest.mark.optimized  # much to compute
def test_victoria_park_beside_the_batch_answer():
    """20 seeds, 100 particles: at most 7 m from the most likely way of all, none lost."""
    file = str(recorded("robot/victoria_park.txt"))
    job, graph, reference = load(Settings(data=file), 0), reading.read_graph(file), None
    off = []
    for seed in range(SEEDS):
        history = mo.run(seed, mo.LandmarkFilter(n=100, on_collapse="predict"), job.model, job.ys, job.inputs, keep=mo.keep.paths)
        if reference is None:
            mean = np.asarray(history.mean, np.float64)
            reference, _ = solved(graph, mean[:, :3], job.landmarks(history), mean[-1, 3:])
        off.append(rms(reference, job.path(history)))
    assert max(off) < 20 and np.mean(off) < 7, off


@pytest.mark.night
def test_the_batch_answer_is_the_most_likely():
    world = made_up(4, 60.0)
    job = load(Settings(seconds=60.0, sights="places"), 4)
    history = mo.run(4, mo.LandmarkFilter(n=100), job.model, job.ys, job.inputs)
    mean = np.asarray(history.mean, np.float64)
    path, places = solved(world.graph, mean[:, :3], job.landmarks(history), mean[-1, 3:])
    again, _ = solved(world.graph, mean[:, :3] + 0.01, job.landmarks(history), mean[-1, 3:])
    assert rms(path, again) < 1e-6 and rms(world.truth, path) < 0.6
    assert jax.tree.leaves(history.state.landmarks())[0].shape == places.shape
