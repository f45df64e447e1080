"""Small bags, written by the writers of `rosbags`; whoever imports this is skipped where that is missing."""

import re
import sqlite3
from keyword import iskeyword

import numpy as np
import pytest

rosbags = pytest.importorskip("rosbags", reason="rosbags is not installed (pip install 'motes[io]')")

from rosbags.rosbag1 import Writer as Writer1  # noqa: E402
from rosbags.rosbag2 import StoragePlugin  # noqa: E402
from rosbags.rosbag2 import Writer as Writer2  # noqa: E402
from rosbags.typesys import Stores, get_types_from_msg, get_typestore  # noqa: E402

SECOND = 10**9
VERSIONS = ("bag", "db3", "mcap")
STORES = {"bag": Stores.ROS1_NOETIC, "db3": Stores.ROS2_JAZZY, "mcap": Stores.ROS2_JAZZY}
POSE = ("position.x", "position.y", "orientation.z", "orientation.w")


def write_bag(path, version, topics, store=None):
    """Write a bag.

    Args:
        path: of it.
        version: "bag" (rosbag 1), "db3" or "mcap" (rosbag 2).
        topics: for each topic the type of its messages and a list of messages: seconds at which it was received, and fields by their paths;
            `stamp` is the seconds of its header.
        store: of types; that of a release if not given.
    """
    store = store or get_typestore(STORES[version])
    plugin = StoragePlugin.MCAP if version == "mcap" else StoragePlugin.SQLITE3
    with Writer1(path) if version == "bag" else Writer2(path, version=9, storage_plugin=plugin) as writer:
        for topic, (kind, messages) in topics.items():
            kind = kind.replace("/", "/msg/")
            connection = writer.add_connection(topic, kind, typestore=store)
            for received, fields in messages:
                message = filled(store, kind, fields)
                data = store.serialize_ros1(message, kind) if version == "bag" else store.serialize_cdr(message, kind)
                writer.write(connection, round(received * SECOND), data)
    return path


def filled(store, kind, fields):
    """Return a message of zeros with some fields, by their paths."""
    found = _zeros(store, kind)
    for path, value in fields.items():
        if path == "stamp":
            found.header.stamp.sec, found.header.stamp.nanosec = divmod(round(value * SECOND), SECOND)
            continue
        *outer, last = path.split(".")
        inner = found
        for name in outer:
            inner = getattr(inner, name)
        old = getattr(inner, last)
        setattr(inner, last, np.asarray(value, old.dtype) if isinstance(old, np.ndarray) else value)
    return found


def _zeros(store, kind):
    def zero(form):
        node, inner = int(form[0]), form[1]
        if node == 2:
            return _zeros(store, inner)
        if node == 1:
            return "" if inner[0] == "string" else inner[0].startswith("float") * 0.0 or 0
        one, size = zero(inner[0]), inner[1] if node == 3 else 0
        plain = {"bool": "bool", "byte": "uint8", "char": "uint8"}
        base = inner[0][1][0]
        return [] if isinstance(one, str) or int(inner[0][0]) == 2 else np.zeros(size, plain.get(base, base))

    return store.types[kind](**{name + "_" * iskeyword(name): zero(form) for name, form in store.fielddefs[kind][1]})


def pose(x, y, yaw, before=""):
    """Fields of a pose in the plane."""
    return dict(zip([before + name for name in POSE], (float(x), float(y), float(np.sin(yaw / 2)), float(np.cos(yaw / 2))), strict=True))


def odometry(times, poses):
    """A topic of odometry."""
    return ("nav_msgs/Odometry", [(time, {"stamp": time, **pose(*one, "pose.pose.")}) for time, one in zip(times, poses, strict=True)])


def own_store(version, kind, text):
    """Return types with one of your own."""
    store = get_typestore(STORES[version])
    store.register(get_types_from_msg(text, kind.replace("/", "/msg/")))
    return store


def changed(path, *orders):
    """Change the database of a bag of SQLite."""
    with sqlite3.connect(next(path.glob("*.db3"))) as base:
        for order in orders:
            base.execute(order)
    return path


def without_definitions(path):
    """Take the definitions out of a bag of SQLite, as releases before Iron wrote none."""
    changed(path, "DROP TABLE message_definitions", "UPDATE schema SET schema_version = 3")
    metadata = path / "metadata.yaml"
    metadata.write_text(re.sub("version: 9", "version: 5", metadata.read_text(), count=1))
    return path
