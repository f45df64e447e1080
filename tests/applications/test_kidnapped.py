"""A robot that does not know where it starts, and is carried away: found again by augmented recovery, on made-up and recorded ways."""

import json
from pathlib import Path

import numpy as np
import pytest

import motes as mo
from data import recorded, refused
from motes.applications.robot import scenario as scoring
from motes.applications.robot.job import load
from motes.applications.robot.settings import Settings
from motes.cli.main import main

AT = 471.21
"""Seconds of the recording (its step 3 198) after which the robot is carried."""


def seeds_of(settings, seeds, world=1):
    """Errors before the kidnapping, seconds until the robot is found again, and errors from then on, `(seeds, 3)`."""
    job = load(settings, world)
    found = []
    for seed in seeds:
        history = mo.run(seed, job.filters["recovering"], job.model, job.ys, job.inputs)
        found.append([float(scoring.score(history, job.scenario).rms), *scoring.found_again(history, job.scenario)])
    return np.array(found)


@pytest.mark.optimized
def test_a_kidnapping_is_noticed_and_the_robot_found_again():
    job = load(Settings(seconds=400.0, kidnap=200.0), 1)
    history = mo.run(0, job.filters["recovering"], job.model, job.ys, job.inputs)
    drawn, begin = np.asarray(history.info.recovered), job.scenario.scored[job.scenario.kidnapped]
    assert drawn[:begin].max() < 0.2 < drawn[begin : begin + 200].max()
    assert scoring.score(history, job.scenario).rms < 1.0
    seconds, rms = scoring.found_again(history, job.scenario)
    # one seed, which rounding of another machine makes another draw: what 19 of 20 reach is asked by night
    assert seconds <= 100 and rms <= 1.5


@pytest.mark.optimized
@pytest.mark.night
def test_a_made_up_robot_is_found_again():
    """Of 20 worlds 19, as on the recording."""
    found = np.concatenate([seeds_of(Settings(seconds=700.0, start="unknown", kidnap=471.0), [seed], seed) for seed in range(20)])
    assert (found[:, 0] <= 1.0).sum() >= 19, found
    assert ((found[:, 1] <= 60) & (found[:, 2] <= 0.8)).sum() >= 19, found


@pytest.mark.optimized
@pytest.mark.night
def test_the_robot_of_plaza_is_found_again():
    """Of 20 seeds 19 are within 1 m before, found again within 60 s, and are then within 0.8 m (root mean square)."""
    found = seeds_of(Settings(data=str(recorded("robot/Plaza1_.mat")), start="unknown", kidnap=AT), range(20))
    assert (found[:, 0] <= 1.0).sum() >= 19, found
    assert ((found[:, 1] <= 60) & (found[:, 2] <= 0.8)).sum() >= 19, found


def test_what_is_cut_out_takes_no_time_and_no_turn_of_a_wheel():
    whole = load(Settings(seconds=200.0), 1).scenario
    made = load(Settings(seconds=200.0, kidnap=50.0), 1).scenario
    at = made.kidnapped
    assert np.hypot(*(made.truth[at] - made.truth[at - 1])[:2]) > 5 and np.array_equal(made.truth[:at], whole.truth[:at])
    assert np.allclose(np.diff(made.times[made.scored]), 0.2) and len(made.truth) < len(whole.truth)
    step = slice(made.scored[at - 1] + 1, made.scored[at] + 1)
    assert np.allclose(made.inputs.forward[step], 0, atol=1e-5) and np.allclose(made.inputs.turn[step], 0, atol=1e-5)


@pytest.mark.night
def test_it_is_shown_and_runs_again_from_its_files(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(["demo", "robot", "--seconds", "100", "--kidnap", "60", "--n", "200"]) == 0
    assert "found_again_after_s" in json.loads(Path("out/summary.json").read_text())["results"]["recovering"]
    assert main(["run", "out/robot.toml", "--out", "again"]) == 0
    one, other = (mo.History.load(f"{folder}/recovering.npz").mean for folder in ("out", "again"))
    assert np.array_equal(one, other)


@pytest.mark.parametrize("kidnap", [-1.0, 500.0, float("nan")])
def test_a_kidnapping_outside_the_recording_is_refused(kidnap):
    with pytest.raises(mo.MotesError) as error:
        load(Settings(seconds=100.0, kidnap=kidnap), 0)
    refused(error, "kidnap", "100", kidnap)
