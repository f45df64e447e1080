"""Bags as the data of applications: the same numbers as from their own files."""

from pathlib import Path

import numpy as np
import pytest

import motes as mo
from bags import VERSIONS, odometry, pose, write_bag
from data import refused
from motes.applications.laser.scans import all_around, read_scan_topics
from motes.applications.laser.settings import Topics
from motes.applications.laser.world import driven
from motes.applications.robot.bag import read_recording
from motes.applications.robot.scenario import dead_reckoning, moves
from motes.applications.robot.settings import Topics as RobotTopics
from motes.applications.robot.world import simulated
from motes.applications.slam.job import load
from motes.applications.slam.settings import Settings
from motes.cli.main import main

TURN = 2 * np.pi


def scanned(times, ranges, least=0.0, step=None):
    """A topic of scans; what did not come back is infinite."""
    fields = {"angle_min": least, "angle_increment": TURN / ranges.shape[1] if step is None else step, "range_max": 300.0}
    return ("sensor_msgs/LaserScan", [(time, {"stamp": time, **fields, "ranges": np.where(np.isnan(one), np.inf, one)})
                                      for time, one in zip(times, ranges, strict=True)])  # fmt: skip


def laser_bag(path, scans, version="mcap"):
    """A bag of made-up scans, with the way by odometry alone from a place far off."""
    heading = 2.0 + np.cumsum(scans.turn)
    way = np.column_stack([dead_reckoning(np.array([30.0, -20.0, 2.0]), scans.forward[1:], scans.turn[1:]), heading])
    times = 1.6e9 + scans.times
    topics = {"/odom": odometry(times, way), "/scan": scanned(times, scans.ranges), "/truth": odometry(times, scans.poses)}
    return write_bag(path, version, topics)


def test_moves_are_what_dead_reckoning_undoes():
    rng = np.random.default_rng(0)
    forward, turns = rng.normal(size=50), rng.uniform(-3, 3, 50)
    way = np.column_stack([dead_reckoning(np.array([1.0, 2.0, 3.0]), forward, turns), 3.0 + np.concatenate([[0.0], np.cumsum(turns)])])
    np.testing.assert_allclose(np.stack(moves(way)), [forward, turns], atol=1e-12)


@pytest.mark.parametrize("version", VERSIONS)
def test_a_bag_of_the_laser_is_its_table(tmp_path, version):
    """As numbers of 32 bits, which filters compute with; a robot that turns on the spot goes forward by the rounding of 64."""
    made = driven(0, 60.0, 0.0, 0.0)[1]
    found = read_scan_topics(laser_bag(tmp_path / "drive", made, version), Topics(truth="/truth"))
    for name in ("times", "turn", "ranges", "bearings"):
        np.testing.assert_array_equal(getattr(found, name).astype(np.float32), getattr(made, name).astype(np.float32), err_msg=name)
    np.testing.assert_allclose(found.forward, made.forward, rtol=1e-12, atol=1e-13)
    assert found.poses is not None
    np.testing.assert_allclose(found.poses[:, :2], made.poses[:, :2], rtol=1e-12)


@pytest.mark.night
def test_a_bag_of_the_laser_gives_the_bits_of_its_table(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("motes.applications.laser.pictures.PICTURES", 2)
    assert main(["demo", "laser", "--seconds", "60", "--n", "300"]) == 0
    laser_bag(tmp_path / "drive.bag", driven(0, 60.0, 0.0, 0.0)[1], "bag")
    Path("bag.toml").write_text('application = "laser"\nmap = "out/map.yaml"\ndata = "drive.bag"\nn = 300\nout = "bag"\n'
                                '[topics]\nscan = "/scan"\nodometry = "/odom"\ntruth = "/truth"\n')  # fmt: skip
    assert main(["run", "bag.toml"]) == 0
    one, other = (mo.History.load(f"{folder}/recovering.npz") for folder in ("out", "bag"))
    assert np.array_equal(one.mean, other.mean) and np.array_equal(one.cov, other.cov)


def test_scans_are_brought_to_the_odometry(tmp_path):
    """Odometry at another rate, a field of view of its own, few beams of many, and scans before the odometry begins."""
    times = np.arange(0.0, 5.0, 0.1)
    way = np.column_stack([times, np.zeros_like(times), np.full_like(times, 3.2)])
    at = np.arange(-0.25, 4.0, 0.5)
    ranges = np.tile(np.arange(1.0, 91.0), (len(at), 1)).astype(np.float32)
    path = write_bag(tmp_path / "a", "db3", {"/odom": odometry(100 + times, way), "/scan": scanned(100 + at, ranges, -1.5, 3 / 90)})
    found = read_scan_topics(path, Topics(beams=9))
    np.testing.assert_allclose(found.times, at[1:] + 0.25)
    np.testing.assert_allclose(found.forward, [0.0, *np.full(len(at) - 2, 0.5 * np.cos(3.2))], atol=1e-9)
    np.testing.assert_allclose(found.turn, 0, atol=1e-9)
    assert np.array_equal(found.ranges[0], np.arange(1.0, 91.0, 10)) and found.poses is None
    np.testing.assert_allclose(found.bearings, -1.5 + np.arange(0, 90, 10) * 3 / 90, rtol=1e-6)
    whole = write_bag(tmp_path / "b", "db3", {"/odom": odometry(100 + times, way), "/scan": scanned(100 + at, ranges, -1.5)})
    assert np.array_equal(read_scan_topics(whole, Topics(beams=500)).bearings, np.float32(-1.5) + all_around(90))
    late = write_bag(tmp_path / "c", "db3", {"/odom": odometry(times, way), "/scan": scanned(100 + at, ranges)})
    turned = scanned(times[:1], ranges[:1])[1] + scanned(times[1:2], ranges[:1], 1.0)[1]
    other = write_bag(tmp_path / "d", "db3", {"/odom": odometry(times, way), "/scan": ("sensor_msgs/LaserScan", turned)})
    for bag, topics, words in ((late, Topics(), ("/odom 0 to 4.9 s", "clocks")), (other, Topics(), ("the same bearings", "/scan")),
                               (late, Topics(scan="/odom"), ("sensor_msgs/LaserScan as scan", "/odom of nav_msgs/Odometry")),
                               (late, Topics(beams=0), ("topics.beams",)),
                               (late, Topics(odometry=""), ("topic as odometry",))):  # fmt: skip
        with pytest.raises(mo.MotesError) as error:
            read_scan_topics(bag, topics)
        refused(error, *words)


def beacons_bag(folder, recording, version="db3"):
    """A bag of a made-up recording, and the table of its beacons; ranges beyond the limit are none."""
    times, way = 50 + recording.truth[:, 0], recording.drifting_path
    heading = np.concatenate([[0.0], np.cumsum(recording.odometry[:, 2])])
    poses = [(time, {"stamp": time, **pose(*one, "pose.")}) for time, one in zip(times, recording.truth[:, 1:], strict=True)]
    topics = {"/odom": odometry(times, np.column_stack([way, heading])), "/ground_truth": ("geometry_msgs/PoseStamped", poses)}
    for number, _, _ in recording.beacons:
        heard = recording.ranges[recording.ranges[:, 1] == number]
        rows = [(50 + at, {"stamp": 50 + at, "range": z, "max_range": 500.0}) for at, _, z in heard]
        topics[f"/uwb/{number:g}"] = ("sensor_msgs/Range", rows)
    (folder / "beacons.csv").write_text("topic,x,y\n" + "".join(f"/uwb/{n:g},{x},{y}\n" for n, x, y in recording.beacons))
    return write_bag(folder / "drive", version, topics)


def test_a_bag_of_beacons_is_the_recording(tmp_path):
    made = simulated(3, 60.0)
    found = read_recording(beacons_bag(tmp_path, made), RobotTopics(beacons=str(tmp_path / "beacons.csv")))
    heading = np.angle(np.exp(1j * (found.truth[:, 3] - made.truth[:, 3])))
    np.testing.assert_allclose(found.truth[:, :3], made.truth[:, :3], atol=1e-6)
    np.testing.assert_allclose(heading, 0, atol=1e-9)
    np.testing.assert_allclose(found.ranges, made.ranges, atol=1e-5)
    np.testing.assert_allclose(found.odometry[:, 2], made.odometry[:, 2], atol=1e-9)
    assert np.array_equal(found.beacons, made.beacons) and found.odometry.shape == made.odometry.shape


@pytest.mark.parametrize(("topics", "words"), [
    ({}, ("topics.beacons", "none")),
    ({"beacons": "places.csv"}, ("places.csv", "column 'topic'")),
    ({"beacons": "holes.csv"}, ("holes.csv", "x and y of each beacon", "line 2")),
    ({"beacons": "wrong.csv"}, ("sensor_msgs/Range as beacon 1", "/odom of nav_msgs/Odometry")),
    ({"beacons": "beacons.csv", "truth": "/uwb/1"}, ("as truth", "/uwb/1 of sensor_msgs/Range")),
])  # fmt: skip
def test_bags_of_beacons_are_refused(tmp_path, monkeypatch, topics, words):
    monkeypatch.chdir(tmp_path)
    bag = beacons_bag(tmp_path, simulated(3, 60.0))
    Path("places.csv").write_text("x,y\n1,2\n")
    Path("holes.csv").write_text("topic,x,y\n/uwb/1,,2\n")
    Path("wrong.csv").write_text("topic,x,y\n/odom,1,2\n")
    with pytest.raises(mo.MotesError) as error:
        read_recording(bag, RobotTopics(**topics))
    refused(error, *words)


def test_a_robot_without_a_map_gets_the_beacons_of_a_bag(tmp_path):
    bag = beacons_bag(tmp_path, simulated(3, 60.0))
    found = load(Settings(data=str(bag), topics=RobotTopics(beacons=str(tmp_path / "beacons.csv"))), 0)
    assert found.way.landmarks == 4 and found.way.truth is not None and "4 landmarks" in found.about()


@pytest.mark.night
def test_a_bag_of_beacons_is_run(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    beacons_bag(tmp_path, simulated(3, 60.0))
    assert main(["run", "robot", "--data", "drive", "--topics.beacons", "beacons.csv", "--n", "50"]) == 0
    assert Path("out/summary.json").is_file()


@pytest.mark.night
def test_pictures_of_a_bag_are_followed_to_the_bits_of_the_clip(tmp_path, monkeypatch):
    pytest.importorskip("av", reason="PyAV is not installed (pip install 'motes[video]')")
    from motes.applications.video.world import RATE, World

    monkeypatch.chdir(tmp_path)
    assert main(["demo", "video", "--frames", "12", "--n", "50"]) == 0
    rows = [(1.0 + number / float(RATE), {"encoding": "rgb8", "height": one.shape[0], "width": one.shape[1], "step": 3 * one.shape[1],
                                         "data": one.reshape(-1)}) for number, one in enumerate(World(0, 12).pictures())]  # fmt: skip
    write_bag(tmp_path / "clip.bag", "bag", {"/camera/image_raw": ("sensor_msgs/Image", rows)})
    text = Path("out/video.toml").read_text().replace('data = "clip.mkv"', 'data = "../clip.bag"')
    Path("out/bag.toml").write_text(text.replace('topic = ""', 'topic = "/camera/image_raw"'))
    assert main(["run", "out/bag.toml", "--out", "again"]) == 0
    one, other = (mo.History.load(f"{folder}/particle.npz").mean for folder in ("out", "again"))
    assert np.array_equal(one, other)
