"""The range-only robot: reading a recording, its line of time, the model's structure, and the runs on real and made-up data."""


import jax
import jax.numpy as jnp
import numpy as np
import pytest
import recordings
import scipy.io

import motes as mo
from data import recorded, refused
from motes.applications.robot import scenario as job
from motes.applications.robot.model import DriveNoise, Step
from motes.applications.robot.pictures import robot_figure
from motes.core.record import replace
from motes.io.matlab import read_matrices
from motes.io.recordings import RangeOnlyRecording, read_plaza
from tiers import each

BEACONS = np.array([[0, -15.0, 5.0], [1, 12.0, -9.0], [6, 16.0, 14.0], [5, -8.0, 20.0]])
LINEAR = ("scale", "offset")


def made_up(steps=400):
    """Variables of a recording: a robot stands for 5 s, then drives a wavy circle; its ranges are 7 percent too long."""
    rng = np.random.default_rng(3)
    times = 3856.9 + np.cumsum(np.concatenate([[0], rng.uniform(0.18, 0.22, steps)]))
    forward = np.where(np.arange(steps) < 25, 0.0, 0.2)
    turns = np.where(forward > 0, 0.02 + 0.04 * np.sin(np.arange(steps) / 15), 0.0)
    place = job.dead_reckoning(np.array([0, 0, 4.2]), forward, turns)
    heading = 4.2 + np.concatenate([[0], np.cumsum(turns)])
    drifting = job.dead_reckoning(np.array([0, 0, 4.2]), forward, turns + 0.0008 * (forward > 0))
    at = np.sort(rng.uniform(times[0], times[-1], steps))
    which = rng.integers(0, 4, steps)
    seen = np.stack([np.interp(at, times, axis) for axis in place.T], axis=1)
    ranges = 1.07 * np.hypot(*(seen - BEACONS[which, 1:]).T) + rng.normal(0, 0.5, steps)
    log = np.stack([at, np.full(steps, 2.0), BEACONS[which, 0], ranges], axis=1)
    return {
        "GT": np.column_stack([times, place, heading]),
        "DR": np.column_stack([times[1:], forward, turns]),
        "DRp": np.column_stack([times, drifting, heading]),
        "TD": np.concatenate([log[:150], log[200:], log[150:200]]),
        "TL": BEACONS.copy(),
    }


def written(folder, **changes):
    """Write the made-up recording with some variables changed; None leaves one out."""
    path = folder / "robot.mat"
    scipy.io.savemat(path, {name: value for name, value in (made_up() | changes).items() if value is not None})
    return path


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    return written(tmp_path_factory.mktemp("robot"))


@pytest.fixture(scope="module")
def run_of_file(file):
    scenario = job.loaded(file, "drifting")
    filter = mo.MarginalizedParticleFilter(n=300, linear=LINEAR)
    return scenario, mo.run(1, filter, scenario.model, scenario.ys, scenario.inputs)


def test_reader(file):
    recording, raw = read_plaza(file), made_up()
    assert recording.truth.shape == (401, 4) and recording.odometry.shape == (400, 3)
    assert recording.truth[0, 0] == 0 and recording.truth.dtype == np.float64
    assert np.array_equal(recording.odometry[:, 0], recording.truth[1:, 0])
    assert np.array_equal(recording.drifting_path, raw["DRp"][:, 1:3])
    assert np.array_equal(recording.beacons, BEACONS)
    assert (np.diff(raw["TD"][:, 0]) < 0).any() and (np.diff(recording.ranges[:, 0]) >= 0).all()
    order = np.argsort(raw["TD"][:, 0])
    assert np.array_equal(recording.ranges[:, 1:], raw["TD"][order][:, [2, 3]])
    assert np.allclose(recording.ranges[:, 0], raw["TD"][order, 0] - raw["GT"][0, 0], atol=1e-9)


def spoiled(name, row, column, value):
    changed = made_up()[name]
    changed[row, column] = value
    return {name: changed}


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"TD": None}, ("TD", "variable")),
        ({"TL": np.zeros((4, 2))}, ("TL", "3 columns", "(4, 2)")),
        ({"GT": np.zeros((2, 4, 2))}, ("GT", "4 columns")),
        ({"DR": np.zeros((0, 3))}, ("DR", "(0, 3)")),
        ({"DR": np.array(["abc", "abd"])}, ("DR", "char")),
        ({"GT": np.array([[1, "a", "b", 2]], dtype=object)}, ("GT", "cell")),
        ({"TL": BEACONS + 1j}, ("TL", "complex")),
        (spoiled("TD", 7, 3, np.nan), ("TD", "row 8, column 4")),
        (spoiled("GT", 3, 1, np.inf), ("GT", "row 4, column 2")),
        (spoiled("TD", 9, 2, 17), ("TD", "17.0", "row 10")),
        (spoiled("TD", 9, 3, -1), ("TD", "-1.0", "row 10")),
        (spoiled("TD", 9, 0, 1.0), ("TD", "GT", "row 10")),
        (spoiled("TL", 1, 0, 6), ("TL", "different")),
        (spoiled("DR", 4, 0, 1.0), ("DR", "row 5")),
        (spoiled("GT", 4, 0, 1.0), ("GT", "row 5")),
        ({"DRp": made_up()["DRp"][:-1]}, ("DRp", "401 and 400 rows")),
    ],
)
def test_reader_refuses_contents(tmp_path, changes, words):
    path = written(tmp_path, **changes)
    with pytest.raises(mo.FileError) as error:
        read_plaza(path)
    refused(error, "robot.mat", *words)


@pytest.mark.parametrize("share", [0, 0.001, 0.004, 0.01, 0.3, 0.6, 0.9, 0.999])
@pytest.mark.parametrize("compressed", [False, True])
def test_reader_refuses_what_is_cut_short(tmp_path, share, compressed):
    path = tmp_path / "cut.mat"
    scipy.io.savemat(path, made_up(), do_compression=compressed)
    data = path.read_bytes()
    path.write_bytes(data[: int(share * len(data))])
    with pytest.raises(mo.FileError) as error:
        read_plaza(path)
    refused(error, "cut.mat")


def test_reader_refuses_other_files(tmp_path):
    other = tmp_path / "other.mat"
    other.write_bytes(b"\x89HDF\r\n" + bytes(600))
    for path, word in ((other, "MATLAB 5"), (tmp_path / "none.mat", "No such file"), (tmp_path, "folder")):
        with pytest.raises(mo.FileError) as error:
            read_plaza(path)
        refused(error, word)


@pytest.mark.parametrize("compressed", [False, True])
@pytest.mark.parametrize("kind", ["f8", "f4", "i1", "u2", "i4", "u8"])
def test_matrices_are_those_of_another_reader(tmp_path, kind, compressed):
    path = tmp_path / "numbers.mat"
    written = {"one": np.array([[3]]), "A": np.arange(-6, 6).reshape(4, 3), "text": np.array(["abc"]), "cells": np.array([1, "a"], object)}
    scipy.io.savemat(path, {n: v.astype(kind) if v.dtype == int else v for n, v in written.items()}, do_compression=compressed)
    found, other = read_matrices(path, {"one": 1, "A": 3}), scipy.io.loadmat(path)
    assert all(np.array_equal(found[name], other[name]) for name in found) and found["A"].dtype == np.float64


def test_damaged_files_are_refused_or_read(tmp_path):
    rng = np.random.default_rng(4)
    for compressed in (False, True):
        path = tmp_path / "damaged.mat"
        scipy.io.savemat(path, made_up(40), do_compression=compressed)
        good = np.frombuffer(path.read_bytes(), np.uint8)
        for _ in range(150):
            data = good.copy()
            places = rng.integers(0, rng.choice([256, len(data)]), rng.integers(1, 20))
            data[places] = rng.integers(0, 256, len(places))
            path.write_bytes(data.tobytes())
            try:
                assert read_plaza(path).truth.shape == (41, 4)
            except mo.FileError as error:
                assert str(error).isprintable() and len(str(error)) <= 500


def tiny():
    """Three rows of truth; ranges between them, at one of them, and two to the same beacon at one instant."""
    truth = np.array([[0.0, 0, 0, 0], [1, 1, 0, 0], [2, 2, 0, 0.5]])
    odometry = np.array([[1, 1.0, 0], [2, 1.0, 0.5]])
    ranges = np.array([[0.25, 7, 10.0], [1, 3, 20], [1, 7, 30], [1, 7, 40], [1.5, 3, 50]])
    return RangeOnlyRecording(truth, odometry, truth[:, 1:3], ranges, np.array([[7, 0, 9.0], [3, 9, 0]]))


def test_line_of_time_by_hand():
    times, scored, ys = job.time_line(tiny())
    nan = np.nan
    assert times.tolist() == [0, 0.25, 1, 1, 1.5, 2]
    assert scored.tolist() == [0, 2, 5]
    assert np.array_equal(ys, [[nan, nan], [10, nan], [30, 20], [40, nan], [nan, 50], [nan, nan]], equal_nan=True)
    made = job.scenario(tiny(), tiny().odometry[:, 2])
    assert np.allclose(made.inputs.dt, [0, 0.25, 0.75, 0, 0.5, 0.5])
    assert np.allclose(made.inputs.forward, [0, 0.25, 0.75, 0, 0.5, 0.5])
    assert np.allclose(made.inputs.turn, [0, 0, 0, 0, 0.25, 0.25])


def test_no_reading_is_lost(file):
    recording = read_plaza(file)
    times, scored, ys = job.time_line(recording)
    step, column = np.nonzero(~np.isnan(ys))
    found = np.stack([times[step], recording.beacons[column, 0], ys[step, column]], axis=1)
    assert np.array_equal(found[np.lexsort(found.T)], recording.ranges[np.lexsort(recording.ranges.T)])
    assert np.array_equal(times[scored], recording.truth[:, 0])


def test_ranges_before_the_first_motion_are_left_out(file):
    scenario = job.loaded(file)
    begins = scenario.times[scenario.scored[25]]
    assert np.isnan(scenario.ys[scenario.times <= begins]).all()
    recording = read_plaza(file)
    assert (~np.isnan(scenario.ys)).sum() == (recording.ranges[:, 0] > begins).sum()


def test_odometry(file):
    recording = read_plaza(file)
    recorded_turns, drifting = job.loaded(file), job.loaded(file, "drifting")
    assert np.allclose(recorded_turns.dead_reckoning, recorded_turns.truth[:, :2], atol=1e-6)
    assert np.hypot(*(drifting.dead_reckoning - recording.drifting_path).T).max() < 1
    assert np.hypot(*(drifting.dead_reckoning - drifting.truth[:, :2]).T).max() > 2
    assert np.isclose(np.sum(drifting.inputs.forward), recording.odometry[:, 1].sum())
    with pytest.raises(mo.MotesError) as error:
        job.loaded(file, "perfect")
    refused(error, "odometry", "perfect")


def test_noise_of_a_step_cut_in_two_is_the_same():
    whole = DriveNoise()(None, Step(0.2, 0.3, -0.1), 0)
    parts = [DriveNoise()(None, Step(0.2 * share, 0.3 * share, -0.1 * share), 0) for share in (0.3, 0.7)]
    assert np.allclose(whole, parts[0] + parts[1], rtol=1e-5)
    assert np.diag(whole)[4:].tolist() == [0, 0]


def test_structure_is_discovered(file):
    scenario = job.loaded(file)
    step = jax.tree.map(lambda leaf: leaf[1], scenario.inputs)
    found = mo.structure(scenario.model, step)
    assert [found.names[i] for i in found.linear] == ["gyro_bias", "scale", "offset"]
    assert found.covariance == "per-particle"
    with pytest.raises(mo.MotesError) as error:
        mo.run(0, mo.MarginalizedParticleFilter(n=10, linear=("px",)), scenario.model, scenario.ys, scenario.inputs)
    refused(error, "px")


def test_made_up_run(run_of_file):
    scenario, history = run_of_file
    score = job.score(history, scenario)
    alone = np.hypot(*(scenario.dead_reckoning - scenario.truth[:, :2]).T)
    assert score.rms < 0.4 < 0.5 * np.sqrt(np.mean(alone**2))
    assert abs(score.scale - 0.07) < 4 * 0.005 and 0.001 < score.scale_sd < 0.02
    assert np.isclose(score.worst, job.errors(history, scenario).max())
    with pytest.raises(mo.MotesError) as error:
        job.score(history, job.scenario(tiny(), np.zeros(2)))
    refused(error, "history", "6 steps")


@pytest.mark.night
def test_picture(run_of_file, tmp_path):
    scenario, history = run_of_file
    path = tmp_path / "robot.png"
    robot_figure(history, scenario).savefig(path)
    assert path.read_bytes()[:4] == b"\x89PNG" and path.stat().st_size > 20_000


@jax.jit
def _scores(keys, scenario):
    filter = mo.MarginalizedParticleFilter(n=300, linear=LINEAR)
    return jax.vmap(lambda key: job.score(mo.run(key, filter, scenario.model, scenario.ys, scenario.inputs), scenario))(keys)


@pytest.mark.optimized  # much to compute
@pytest.mark.parametrize(("odometry", "rms"), [("recorded", 0.45), ("drifting", 0.85)])
@pytest.mark.night
def test_recorded_run(odometry, rms):
    """With 300 particles; over 12 seeds the drifting run has a mean of 0.60 m and a spread of 0.13 m (benchmarks/accuracy.py: 1 000)."""
    scenario = job.loaded(recorded("robot/Plaza1_.mat"), odometry)
    assert scenario.ys.shape == (13186, 4) and (~np.isnan(scenario.ys)).sum() == 3458
    found = _scores(jax.random.split(jax.random.key(2), 3), scenario)
    assert jnp.mean(found.rms) < rms and jnp.max(found.rms) < 1.1
    assert jnp.abs(jnp.mean(found.scale) - 0.0695) < 0.01


# other people's recordings -------------------------------------------------------------------------------------------

SECOND = {
    "backward": recordings.backward,
    "mirrored": lambda first: recordings.mirrored(recordings.backward(first)),
    "rotated": recordings.rotated,
    "cut": lambda first: recordings.cut(first, 20.0, 70.0),
    "resampled": lambda first: recordings.resampled(first, 5),
}


def run(scenario, n=300, seed=1):
    return mo.run(seed, mo.MarginalizedParticleFilter(n=n, linear=LINEAR), scenario.model, scenario.ys, scenario.inputs)


@pytest.mark.parametrize("name", SECOND)
def test_a_start_is_the_same_whatever_the_habits_of_the_recording(file, name):
    first = read_plaza(file)
    second = SECOND[name](first)
    for turns in (second.odometry[:, 2], job.drifting_turns(second)):
        made = job.scenario(second, turns)
        gone = np.hypot(*(made.dead_reckoning[40:60] - made.truth[40:60, :2]).T) if name != "resampled" else np.zeros(1)
        assert gone.max() < 0.5
        assert np.isfinite(np.asarray(made.inputs.turn)).all()


@pytest.mark.night
def test_a_backward_column_would_lose_the_track(file):
    """The planted twin: the heading taken from the file, as it once was."""
    second = recordings.backward(read_plaza(file))
    made = job.scenario(second, second.odometry[:, 2])
    assert abs(np.angle(np.exp(1j * (float(made.model.initial.mean()[2]) - second.truth[25, 3] - np.pi)))) < 0.1
    wrong = made.model.initial.mean().at[2].set(second.truth[0, 3])
    lost = replace(made, model=replace(made.model, initial=mo.Gaussian(wrong, made.model.initial.cov())))
    assert job.score(run(lost), lost).rms > 3


@pytest.mark.night
def test_a_second_recording_is_as_good_as_the_first(file):
    second = SECOND["mirrored"](read_plaza(file))
    made = job.scenario(second, job.drifting_turns(second))
    history = run(made)
    assert job.score(history, made).rms < 0.4
    assert "beyond the prior" not in job.diagnosed(history, made)


@pytest.mark.night
def test_outliers_are_a_setting(file):
    second = recordings.with_outliers(read_plaza(file))
    robust = job.scenario(second, job.drifting_turns(second), outliers=0.1)
    assert robust.model.names[-1] == "clutter" and job.score(run(robust), robust).rms < 0.6
    plain = job.scenario(second, job.drifting_turns(second))
    assert job.score(run(plain), plain).rms > 1.0
    for share in (-0.1, 0.6, np.nan):
        with pytest.raises(mo.MotesError) as error:
            job.loaded(file, outliers=share)
        refused(error, "outliers")


@pytest.mark.night
def test_an_unknown_start_is_a_setting(file):
    for recording in (read_plaza(file), recordings.rotated(read_plaza(file))):
        made = job.scenario(recording, job.drifting_turns(recording), start="unknown")
        assert not made.counted.all() and made.counted.any()
        place, sd = np.asarray(made.model.initial.mean())[:2], np.sqrt(np.diag(np.asarray(made.model.initial.cov())))[:2]
        assert (np.abs(place - recording.truth[0, 1:3]) < 3 * sd).all() and sd.max() < 10
    assert job.score(run(made, n=3000), made).rms < 0.6
    with pytest.raises(mo.MotesError) as error:
        job.loaded(file, start="somewhere")
    refused(error, "start", "'somewhere'")


def test_a_scale_that_the_prior_does_not_allow_is_a_finding(run_of_file):
    scenario, history = run_of_file
    assert "beyond the prior" not in job.diagnosed(history, scenario)
    escaped = replace(history, kept={**history.kept, "mean": history.mean.at[-20:, 4].set(-1.11)})
    found = job.diagnosed(escaped, scenario)
    assert "beyond the prior" in found and not found.trusted and "scale" in str(found)


@pytest.mark.optimized  # much to compute
@pytest.mark.parametrize("name", each([*SECOND, "with outliers"], {*SECOND, "with outliers"}))
def test_second_recordings_made_of_the_recorded_one(name):
    first = read_plaza(recorded("robot/Plaza1_.mat"))
    second = {**SECOND, "cut": lambda first: recordings.cut(first, 600.0, 1500.0), "with outliers": recordings.with_outliers}[name](first)
    made = job.scenario(second, job.drifting_turns(second), outliers=0.1 * (name == "with outliers"))
    history = run(made, n=300 if name != "with outliers" else 1000)
    assert job.score(history, made).rms < 1.2
    # ranges of the recording itself scatter more than their noise now and then, which the alarm tells
    assert {finding.name for finding in job.diagnosed(history, made).findings if finding.serious} <= {"alarm"}
