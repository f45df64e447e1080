"""Bags of both versions: topics as arrays over time, each kind of message, and what is refused."""

import io
import shutil
from pathlib import Path

import numpy as np
import pytest

import motes as mo
from bags import VERSIONS, Stores, Writer1, changed, filled, get_typestore, odometry, own_store, pose, without_definitions, write_bag
from data import refused
from motes.io.bags import is_bag, read_bag, read_topic_clip

TIMES = np.array([100.25, 100.5, 101.0])
POSES = np.array([[0.0, 1.0, 3.0], [0.5, 1.5, -3.0], [1.0, 2.0, -2.5]])


def stamped(rows, **fields):
    """Messages with a time in their header, and received 0.01 s later; values of fields by message."""
    return [(time + 0.01, {"stamp": time, **{name: value[row] for name, value in fields.items()}}) for row, time in enumerate(rows)]


def every_kind():
    """Topics of each type that is known, and what is read of each."""
    steps = np.arange(3)[:, None]
    scans = np.array([[1.0, np.inf, 9.0], [0.05, 2.0, 3.0], [4.0, np.nan, 5.0]], np.float32)
    limits = {"range_min": [0.1] * 3, "range_max": [8.0] * 3, "angle_increment": [0.5] * 3}
    gray, color = np.arange(18, dtype=np.uint8).reshape(3, 2, 3), np.arange(54, dtype=np.uint8).reshape(3, 2, 3, 3)
    size = {"height": [2] * 3, "width": [3] * 3}
    poses = [pose(*one) for one in POSES]
    prefixed = lambda before: {f"{before}{name}": [one[name] for one in poses] for name in poses[0]}  # noqa: E731
    axes = {f"angular_velocity.{axis}": [0.1 * i, 0.2 * i, 0.3 * i] for i, axis in enumerate("xyz")}
    axes |= {f"linear_acceleration.{axis}": [1.0 * i, 2.0 * i, 3.0 * i] for i, axis in enumerate("xyz")}
    fixes = {"latitude": [48.0, 49.0, 50.0], "longitude": [7.0, 8.0, 9.0], "altitude": [1.0, 2.0, 3.0], "status.status": [0, -1, 2]}
    padded = np.concatenate([color.reshape(3, 2, 9), np.zeros((3, 2, 1), np.uint8)], axis=2).reshape(3, -1)
    return {
        "/odom": ("nav_msgs/Odometry", prefixed("pose.pose."), POSES),
        "/pose": ("geometry_msgs/PoseStamped", prefixed("pose."), POSES),
        "/amcl": ("geometry_msgs/PoseWithCovarianceStamped", prefixed("pose.pose."), POSES),
        "/cmd": ("geometry_msgs/TwistStamped", {"twist.linear.x": [1.0, 2.0, 3.0], "twist.angular.z": [0.1, 0.2, 0.3]},
                 np.array([[1.0, 0, 0.1], [2.0, 0, 0.2], [3.0, 0, 0.3]])),
        "/sonar": ("sensor_msgs/Range", {"range": [0.5, 7.0, np.inf], "min_range": [0.1] * 3, "max_range": [4.0] * 3},
                   np.array([0.5, np.nan, np.nan])),
        "/scan": ("sensor_msgs/LaserScan", {"ranges": scans, **limits},
                  np.where(np.isfinite(scans) & (scans >= np.float32(0.1)) & (scans <= 8), scans.astype(float), np.nan)),
        "/imu": ("sensor_msgs/Imu", axes, steps.T.repeat(2, 0).reshape(-1) * np.array([0.1] * 3 + [1.0] * 3) * (steps + 1)),
        "/fix": ("sensor_msgs/NavSatFix", fixes, np.array([[48.0, 7, 1], [np.nan] * 3, [50.0, 9, 3]])),
        "/gray": ("sensor_msgs/Image", {**size, "encoding": ["mono8"] * 3, "step": [3] * 3, "data": gray.reshape(3, -1)}, gray),
        "/rgb": ("sensor_msgs/Image", {**size, "encoding": ["rgb8"] * 3, "step": [10] * 3, "data": padded}, color),
        "/bgr": ("sensor_msgs/Image", {**size, "encoding": ["bgr8"] * 3, "step": [9] * 3, "data": color.reshape(3, -1)}, color[..., ::-1]),
        "/png": ("sensor_msgs/CompressedImage", {"format": ["png"] * 3, "data": [packed(one) for one in color]}, color),
    }  # fmt: skip


def packed(picture):
    image, file = pytest.importorskip("PIL.Image", reason="pillow is not installed"), io.BytesIO()
    image.fromarray(picture).save(file, "png")
    return np.frombuffer(file.getvalue(), np.uint8)


@pytest.mark.parametrize("version", VERSIONS)
def test_each_kind_of_message_is_read(tmp_path, version):
    kinds = every_kind()
    path = write_bag(tmp_path / "drive.bag", version, {name: (kind, stamped(TIMES, **fields)) for name, (kind, fields, _) in kinds.items()})
    found = read_bag(path, {name: name for name in kinds} | {"x": "/odom pose.pose.position.x", "turned": "/odom pose.pose.orientation.yaw",
                                                             "two": "/odom pose.pose.position.y header.stamp.nanosec",
                                                             "many": "/amcl pose.covariance", "third": "/scan ranges.2"})  # fmt: skip
    assert is_bag(path) and found.start == TIMES[0]
    for name, (kind, _, wanted) in kinds.items():
        topic = found.topics[name]
        assert (topic.name, topic.kind) == (name, kind)
        np.testing.assert_array_equal(topic.seconds, TIMES - TIMES[0])
        np.testing.assert_allclose(topic.values, wanted, rtol=1e-6, err_msg=name)
        assert topic.values.shape == wanted.shape
        assert topic.angles == ((2,) if "Pose" in kind or "Odometry" in kind else ())
    values = {name: found.topics[name].values for name in ("x", "turned", "two", "many", "third")}
    assert np.array_equal(values["x"], POSES[:, 0]) and np.allclose(values["turned"], POSES[:, 2], atol=1e-12)
    assert np.array_equal(values["two"], np.stack([POSES[:, 1], TIMES % 1 * 1e9], axis=1))
    assert values["many"].shape == (3, 36) and np.array_equal(values["third"], [9.0, 3.0, 5.0])


def test_a_quaternion_may_have_any_length_and_a_topic_lies_between_its_messages(tmp_path):
    """Angles go the short way round; before the first and after the last message nothing is known."""
    rows = [(time, {"pose.orientation.z": 3 * np.sin(yaw / 2), "pose.orientation.w": 3 * np.cos(yaw / 2)})
            for time, yaw in zip(TIMES, POSES[:, 2], strict=True)]  # fmt: skip
    topic = read_bag(write_bag(tmp_path / "a", "db3", {"/pose": ("geometry_msgs/PoseStamped", rows)}), {"p": "/pose"}).topics["p"]
    np.testing.assert_allclose(topic.values[:, 2], POSES[:, 2])
    between = topic.at(np.array([-0.1, 0.125, 0.25, 0.8]))
    np.testing.assert_allclose(between[:, 2], [np.nan, np.pi, 2 * np.pi - 3, np.nan])
    assert np.array_equal(topic.held(np.array([0.0, 0.2, 0.25, 9.0])), topic.values[[0, 0, 1, 2]])
    # times of steps are rounded
    rounded = topic.seconds + np.array([-4e-7, -4e-7, 4e-7])
    assert np.array_equal(topic.held(rounded), topic.values) and np.allclose(topic.at(rounded)[[0, 2], :2], topic.values[[0, 2], :2])


def test_times_are_those_of_headers_or_of_arrival(tmp_path):
    """Of a topic in which a header has none, all are of arrival."""
    point = [(time, {"x": 1.0}) for time in TIMES]
    half = [(time, {"stamp": stamp}) for time, stamp in zip(TIMES, (0.0, 5.0, 6.0), strict=True)]
    path = write_bag(tmp_path / "a", "mcap", {"/point": ("geometry_msgs/Point", point), "/half": ("sensor_msgs/Range", half)})
    found = read_bag(path, {"point": "/point x", "half": "/half"})
    assert found.start == TIMES[0]
    for name in ("point", "half"):
        np.testing.assert_array_equal(found.topics[name].seconds, TIMES - TIMES[0])


@pytest.mark.parametrize("version", VERSIONS)
def test_types_of_your_own_are_read(tmp_path, version):
    store = own_store(version, "my_msgs/Depth", "std_msgs/Header header\nfloat32 depth\nstring from\ngeometry_msgs/Point[] points\n")
    rows = [(time, {"stamp": time, "depth": time, "from_": "here"}) for time in TIMES]
    path = write_bag(tmp_path / "a.bag", version, {"/depth": ("my_msgs/Depth", rows)}, store)
    np.testing.assert_array_equal(read_bag(path, {"d": "/depth depth"}).topics["d"].values, TIMES)
    for text, words in (("/depth", ("fields after the topic", "depth, from, points")), ("/depth from", ("'from'", "a text")),
                        ("/depth points.0.x", ("'points.0.x'", "'0'")), ("/depth points", ("'points'", "a list of 0")),
                        ("/depth dept", ("'dept'", "Perhaps you meant 'depth'"))):  # fmt: skip
        with pytest.raises(mo.FileError) as error:
            read_bag(path, {"d": text})
        refused(error, "a.bag", "/depth", "my_msgs/Depth", *words)


def test_bags_without_definitions_have_the_types_of_their_time(tmp_path):
    """A range got one more field after Humble; a type of your own is not known."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    rows = [(time, {"stamp": time, "range": 1.0}) for time in TIMES]
    path = without_definitions(write_bag(tmp_path / "a", "db3", {"/sonar": ("sensor_msgs/Range", rows)}, store))
    np.testing.assert_array_equal(read_bag(path, {"r": "/sonar"}).topics["r"].values, np.ones(3))
    own = own_store("db3", "my_msgs/Depth", "float32 depth\n")
    path = without_definitions(write_bag(tmp_path / "b", "db3", {"/depth": ("my_msgs/Depth", [(1.0, {})])}, own))
    with pytest.raises(mo.FileError) as error:
        read_bag(path, {"d": "/depth depth"})
    refused(error, "definition of my_msgs/Depth", "/depth", "Iron")


def test_definitions_may_be_idl(tmp_path):
    store = own_store("db3", "my_msgs/Depth", "my_msgs/Pair pair\nfloat32 depth\n" + "=" * 80 + "\nMSG: my_msgs/Pair\nint32 a\nint32 b\n")
    rows = [(time, {"pair.b": 3, "depth": time}) for time in TIMES]
    path = write_bag(tmp_path / "a", "db3", {"/depth": ("my_msgs/Depth", rows)}, store)
    told = {"Depth": "my_msgs::msg::Pair pair; float depth;", "Pair": "long a; long b;"}
    parts = [f"{'=' * 80}\nIDL: my_msgs/msg/{name}\nmodule my_msgs {{ module msg {{ struct {name} {{ {text} }}; }}; }};\n"
             for name, text in told.items()]  # fmt: skip
    for text in ("".join(parts), parts[0]):
        changed(path, f"UPDATE message_definitions SET encoding = 'ros2idl', encoded_message_definition = '{text}'")
        if text != parts[0]:
            assert np.array_equal(read_bag(path, {"b": "/depth pair.b depth"}).topics["b"].values, [[3, time] for time in TIMES])
            continue
        with pytest.raises(mo.FileError) as error:
            read_bag(path, {"b": "/depth pair.b"})
        refused(error, "an undamaged bag", "my_msgs/msg/Pair")


def test_a_definition_is_no_program(tmp_path):
    """What a bag says of its types is read by a grammar; a name that is more than a name is refused."""
    path, store = tmp_path / "a.bag", get_typestore(Stores.ROS1_NOETIC)
    with Writer1(path) as writer:
        name = "a/msg/X:\n    pass\nimport motes\nmotes.ran = True\nclass Y"
        connection = writer.add_connection("/p", name, msgdef="float64 x\nfloat64 y\nfloat64 z\n", md5sum="0" * 32)
        writer.write(connection, 1, store.serialize_ros1(filled(store, "geometry_msgs/msg/Point", {}), "geometry_msgs/msg/Point"))
    with pytest.raises(mo.FileError) as error:
        read_bag(path, {"p": "/p x"})
    refused(error, "a.bag")
    assert not hasattr(mo, "ran")


@pytest.fixture(scope="module")
def drive(tmp_path_factory):
    scan = [(time, {"stamp": time, "ranges": [1.0] * (3 + row)}) for row, time in enumerate(TIMES)]
    back = [(time, {"stamp": stamp}) for time, stamp in zip(TIMES, (1.0, 3.0, 2.0), strict=True)]
    image = [(time, {"encoding": "16UC1", "height": 2, "width": 2, "step": 4, "data": [0] * 8}) for time in TIMES]
    short = [(time, {"encoding": "rgb8", "height": 2, "width": 2, "step": 6, "data": [0] * 8}) for time in TIMES]
    topics = {"/odom": odometry(TIMES, POSES), "/scan": ("sensor_msgs/LaserScan", scan), "/back": ("sensor_msgs/Range", back),
              "/empty": ("sensor_msgs/Range", []), "/deep": ("sensor_msgs/Image", image), "/short": ("sensor_msgs/Image", short),
              "/zero": ("nav_msgs/Odometry", [(1.0, {})]),
              "/torn": ("sensor_msgs/CompressedImage", [(1.0, {"data": [1, 2, 3]})])}  # fmt: skip
    return write_bag(tmp_path_factory.mktemp("bags") / "drive", "db3", topics)


@pytest.mark.parametrize(("text", "kinds", "words"), [
    ("/odm", None, ("the topic '/odm'", "/odom (nav_msgs/Odometry)", "Perhaps you meant '/odom'.")),
    ("", None, ("the topic ''", "/scan")),
    ("/odom pose.x", None, ("field 'pose.x'", "message 1 of /odom (nav_msgs/Odometry)", "pose, covariance")),
    ("/odom pose.pose.posit.x", None, ("Perhaps you meant 'position'.",)),
    ("/odom pose.pose.position", None, ("a number", "the fields x, y, z", "Name one, such as pose.pose.position.x.")),
    ("/odom child_frame_id", None, ("a number", "a text")),
    ("/odom pose.covariance.36", None, ("'pose.covariance.36'", "no fields")),
    ("/odom __class__", None, ("'__class__'",)),
    ("/odom", ("sensor_msgs/Range",), ("a topic of sensor_msgs/Range as it", "/odom of nav_msgs/Odometry", "/back")),
    ("/odom pose", ("nav_msgs/Odometry",), ("the name of a topic as it", "'/odom pose'")),
    ("", ("nav_msgs/Odometry",), ("the name of a topic as it", "''")),
    ("/empty", None, ("at least one message in /empty", "none")),
    ("/scan", None, ("every message of /scan", "(3,)", "(4,) in message 2")),
    ("/back", None, ("times of /back", "never decrease", "message 3")),
    ("/deep", None, ("mono8, rgb8, bgr8", "'16UC1'")),
    ("/short", None, ("2 rows of at least 6 bytes", "8 bytes")),
    ("/zero", None, ("a quaternion that is a turn", "message 1 of /zero")),
    ("/torn", None, ("JPEG or PNG", "/torn")),
])  # fmt: skip
def test_topics_are_refused(drive, text, kinds, words):
    with pytest.raises(mo.MotesError) as error:
        read_bag(drive, {"it": text}, {"it": kinds} if kinds else None)
    refused(error, "drive", *words)


@pytest.mark.parametrize("version", VERSIONS)
@pytest.mark.parametrize("share", [0.3, 0.97])
def test_bags_that_are_cut_short_are_refused(tmp_path, version, share):
    whole = write_bag(tmp_path / "whole.bag", version, {"/odom": odometry(TIMES + np.arange(3), POSES)})
    file = whole if version == "bag" else next(whole.glob(f"*.{version}"))
    short = tmp_path / f"short.{version}"
    short.write_bytes(file.read_bytes()[: int(file.stat().st_size * share)])
    assert is_bag(short)
    with pytest.raises(mo.FileError) as error:
        read_bag(short, {"odometry": "/odom"})
    refused(error, f"short.{version}", "an undamaged bag")


def test_no_bag_is_refused_and_one_file_of_a_folder_is_enough(tmp_path, drive):
    (tmp_path / "text.txt").write_text("a,b\n1,2\n")
    (tmp_path / "folder").mkdir()
    (tmp_path / "empty.bag").touch()
    assert not any(is_bag(tmp_path / name) for name in ("text.txt", "empty.bag", "none.bag")) and is_bag(tmp_path / "folder")
    for path, words in ((tmp_path / "none.bag", ("No such file",)), (tmp_path / "empty.bag", ("an empty file",)),
                        (tmp_path / "text.txt", ("'.txt'",)), (tmp_path / "folder", ("metadata.yaml", "0 such files"))):  # fmt: skip
        with pytest.raises(mo.FileError) as error:
            read_bag(path, {"odometry": "/odom"})
        refused(error, *words)
    shutil.copy(next(drive.glob("*.db3")), tmp_path / "folder")
    assert read_bag(tmp_path / "folder", {"odometry": "/odom"}).topics["odometry"].values.shape == (3, 3)


def test_the_package_is_named_where_it_is_missing(drive, monkeypatch):
    import importlib

    there = importlib.import_module
    monkeypatch.setattr(importlib, "import_module", lambda name: exec_missing(name) if name.startswith("rosbags") else there(name))
    with pytest.raises(mo.MotesError) as error:
        read_bag(drive, {"odometry": "/odom"})
    refused(error, "rosbags", "pip install 'motes[io]'")


def exec_missing(name):
    raise ImportError(f"No module named {name!r}")


@pytest.mark.parametrize("version", ["bag", "mcap"])
def test_pictures_come_one_by_one(tmp_path, version):
    kinds, times = every_kind(), TIMES[0] + 0.1 * np.arange(3)
    path = write_bag(tmp_path / "a.bag", version, {name: (kind, stamped(times, **fields)) for name, (kind, fields, _) in kinds.items()})
    for name in ("/gray", "/rgb", "/bgr", "/png"):
        clip, wanted = read_topic_clip(path, name), kinds[name][2]
        wanted = wanted if wanted.ndim == 4 else wanted[..., None].repeat(3, -1)
        assert (clip.width, clip.height, clip.count, float(clip.rate)) == (3, 2, 3, 10.0)
        np.testing.assert_array_equal(list(clip.pictures()), wanted)
        np.testing.assert_array_equal(list(clip.pictures(2)), wanted[2:])
    with pytest.raises(mo.FileError) as error:
        read_topic_clip(path, "/odom")
    refused(error, "sensor_msgs/CompressedImage", "/odom of nav_msgs/Odometry")


def test_damaged_pictures_are_gaps(tmp_path):
    good = {"encoding": "mono8", "height": 2, "width": 2, "step": 2, "data": [1, 2, 3, 4]}
    rows = [(1.0, good), (1.1, {**good, "data": [1]}), (1.2, {**good, "height": 1, "data": [1, 2]}), (1.3, good)]
    clip = read_topic_clip(write_bag(tmp_path / "a", "db3", {"/image": ("sensor_msgs/Image", rows)}), "/image")
    assert [one is None for one in clip.pictures()] == [False, True, True, False]
    assert Path(clip.path).name == "a" and clip.topic in repr(clip)


def test_clocks_that_have_nothing_in_common_are_told(tmp_path):
    """Headers of simulated time beside messages without any, which have the time at which they arrived."""
    wall = 1.7e9
    path = write_bag(tmp_path / "clocks.bag", "bag", {"/odom": odometry([1.0, 2.0], np.zeros((2, 3))),
                                                      "/level": ("std_msgs/Float64", [(wall + 1, {"data": 3.0})])})  # fmt: skip
    with pytest.raises(mo.FileError, match="one clock for .*/odom.*have headers.*/level.*Record both with the same clock"):
        read_bag(path, {"way": "/odom", "level": "/level data"})
