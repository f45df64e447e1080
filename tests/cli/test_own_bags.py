"""A bag as the data of a model of the user's own, as docs/command.md shows it."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
from test_cli import refused

import motes as mo
from bags import odometry, write_bag
from motes.cli.asked import Run, asked
from motes.cli.main import main
from test_documents import ROOT

BEGIN, PERIOD, END = 1.7e9, 0.1, 6.0
TRUE = 0.1 * np.arange(61)
"""Times of the true way: half a meter per second, and a turn of a tenth of a radian per second."""


def way(times):
    heading = 0.1 * times
    return np.stack([5 * np.sin(heading), 5 * (1 - np.cos(heading)), heading], axis=1)


@pytest.fixture(scope="module")
def drive(tmp_path_factory):
    """A drive with five topics at rates of their own: commands from 0.25 s on, two sensors, truth and pictures."""
    rng = np.random.default_rng(0)
    sonar, compass, command = np.arange(0, END, 0.1), np.arange(0.05, END, 0.35), np.arange(0.25, END, 0.5)
    walls, turns = 10 - way(sonar)[:, 0] + 0.2 * rng.normal(size=len(sonar)), way(compass)[:, 2] + 0.1 * rng.normal(size=len(compass))
    image = {"encoding": "mono8", "height": 1, "width": 2, "step": 2}
    topics = {
        "/sonar": ("sensor_msgs/Range", [(BEGIN + at, {"stamp": BEGIN + at, "range": z}) for at, z in zip(sonar, walls, strict=True)]),
        "/imu": ("sensor_msgs/Imu", [(BEGIN + at, {"stamp": BEGIN + at, "orientation.z": np.sin(z / 2), "orientation.w": np.cos(z / 2)})
                                     for at, z in zip(compass, turns, strict=True)]),
        "/cmd_vel": ("geometry_msgs/TwistStamped", [(BEGIN + at, {"stamp": BEGIN + at, "twist.linear.x": 0.5, "twist.angular.z": 0.1})
                                                    for at in command]),
        "/ground_truth": odometry(BEGIN + TRUE, way(TRUE)),
        "/image": ("sensor_msgs/Image", [(BEGIN + at, {"stamp": BEGIN + at, "data": [1, 2], **image}) for at in (1.0, 2.0)]),
        "/late": ("sensor_msgs/Range", [(BEGIN + 9.0, {"stamp": BEGIN + 9.0})]),
        "/other": odometry([5.0, 6.0], way(TRUE[:2])),
    }  # fmt: skip
    return write_bag(tmp_path_factory.mktemp("drive") / "drive.bag", "bag", topics)


@pytest.fixture
def folder(drive, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("drive.bag").symlink_to(drive)
    text = (ROOT / "docs" / "command.md").read_text()
    Path("robot.py").write_text(re.search(r"```python\n(# robot.py.*?)```", text, re.S)[1])
    Path("robot.toml").write_text(re.search(r"```\n(application = \"robot.py:make\".*?)```", text, re.S)[1])
    return tmp_path


def test_the_bag_of_the_documents_is_one_line_of_steps(folder):
    """Steps are the times of both sensors from the first command on; the truth lies between its messages."""
    wish = asked(Run, ["robot.toml"], "motes run")
    job = wish.job()
    both = np.union1d(np.round(np.arange(0, END, 0.1), 6), np.round(np.arange(0.05, END, 0.35), 6))
    times = job.start + job.times
    np.testing.assert_allclose(times, both[both >= 0.25], atol=1e-6)
    np.testing.assert_allclose(job.truth, way(times), atol=1e-3)
    wall, compass = job.ys["wall"], job.ys["compass"]
    assert np.isnan(wall).sum() > 5 and np.isnan(compass).sum() > 40 and not (np.isnan(wall) & np.isnan(compass)).any()
    assert np.nanmax(np.abs(wall - 10 + way(times)[:, 0])) < 0.8 and np.nanmax(np.abs(compass - way(times)[:, 2])) < 0.4
    np.testing.assert_allclose(job.inputs["speed"], np.tile([0.5, 0.0, 0.1], (len(times), 1)))
    np.testing.assert_allclose(job.inputs["dt"][1:], np.diff(times), rtol=1e-5)
    assert wish.chosen("filter", "filters") == {"particle": mo.ParticleFilter(n=500)}


@pytest.mark.night
def test_the_bag_of_the_documents_is_filtered(folder):
    assert main(["run", "robot.toml"]) == 0
    results = json.loads(Path("out/summary.json").read_text())["results"]["particle"]
    assert results["rms_x"] < 0.15 and results["rms_heading"] < 0.1


def test_a_function_takes_the_arrays_of_a_bag(folder):
    Path("taking.py").write_text(
        "import jax.numpy as jnp, numpy as np, motes as mo\n\n\ndef make(data):\n    np.savez('given.npz', **data)\n"
        "    model = mo.StateSpaceModel(mo.Gaussian(jnp.zeros(1), jnp.eye(1)), mo.LinearGaussian(jnp.eye(1), jnp.eye(1)),"
        " mo.LinearGaussian(jnp.eye(1), jnp.eye(1)))\n    return {'model': model, 'ys': data['wall'][:, None]}\n"
    )
    text = ('application = "taking.py:make"\ndata.file = "drive.bag"\ndata.inputs = ["speed"]\n[data.topics]\n'
            'wall = "/sonar"\npixels = "/image"\nspeed = "/cmd_vel twist.linear.x"\n')  # fmt: skip
    Path("taking.toml").write_text(text)
    assert asked(Run, ["taking.toml"], "motes run").job().ys.shape[1] == 1
    given = np.load("given.npz")
    assert set(given) == {"wall", "pixels", "speed", "time"} and given["pixels"].shape == (len(given["time"]), 1, 2)
    seen = ~np.isnan(given["pixels"]).any(axis=(1, 2))
    np.testing.assert_allclose(given["time"][seen], [1.0, 2.0])
    assert (given["pixels"][seen] == [1, 2]).all() and (given["speed"] == 0.5).all()


@pytest.mark.parametrize(("old", "new", "words"), [
    ("wall = ", "walls = ", ["names among the topics", "'wall'"]),
    ('wall = "/sonar"', 'wall = "/sonr"', ["the topic '/sonr'", "Perhaps you meant '/sonar'."]),
    ('wall = "/sonar"', 'wall = "/sonar distance"', ["'distance'", "min_range"]),
    ('wall = "/sonar"', "wall = 3", ["a table of texts"]),
    ('"drive.bag"', '"robot.py"', ["data topics: expected a bag", "robot.py"]),
    ("[data.topics]", 'time = "t"\n[data.topics]', ["data time: expected none", "'t'"]),
    ('pose = "/g', 'time = "/sonar"\npose = "/g', ["other names than 'time'"]),
    ('truth = ["pose"]', 'truth = ["wall"]', ["a column for each of the states"]),
    ('"/ground_truth"', '"/other"', ["data pose", "true states", "clocks"]),
    ('"/cmd_vel"', '"/late"', ["data wall: expected messages from 9", "the last at 5.9"]),
])  # fmt: skip
def test_what_cannot_be_used_is_told_in_a_line(folder, capsys, old, new, words):
    text = Path("robot.toml").read_text()
    assert old in text
    Path("robot.toml").write_text(text.replace(old, new))
    refused(capsys, ["run", "robot.toml"], *words)


def test_something_has_to_be_measured(folder, capsys):
    words = ["--data.columns", "--data.inputs", "speed", "wall", "compass"]
    refused(capsys, ["run", "robot.toml", *words], "data columns", "at least one topic that is measured")


def test_topics_have_to_be_named(folder, capsys):
    refused(capsys, ["run", "robot.py:make", "--data", "drive.bag", "--filter", "kalman"], "data topics", "/sonar (sensor_msgs/Range)")
