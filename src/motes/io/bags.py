"""Recordings of robots, rosbag 1 and 2 (package `rosbags`, extra `io`): the messages of topics as arrays over time.

Of a bag only the topics that are named are read, and of its message definitions only theirs. Bags of rosbag 2 that have no definitions are
those of before the release Iron: standard types are then those of Humble, the last of them.
"""

import os
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from fractions import Fraction
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from motes.core.checks import FileError, need
from motes.io.clips import USUAL_RATE, Clip
from motes.io.files import foreign, label, look, reject
from motes.io.instants import SAME, times
from motes.io.messages import PICTURES, Place, angles, meant, picture, said

STARTS = (b"#ROSBAG V", b"SQLite format 3\x00", b"\x89MCAP0\r\n")
RAW = (".db3", ".mcap")
"""Endings of files in a folder of rosbag 2."""
NANO = 10**9
APART = 86_400 * NANO
"""Nanoseconds by which the times of two topics miss each other where they are of different clocks."""
JUDGED = 30
"""Pictures by which their rate is judged."""


class Topic(NamedTuple):
    """What the messages of a topic say.

    Attributes:
        name: of the topic, such as "/odom".
        kind: type of its messages, such as "nav_msgs/Odometry".
        seconds: of each message since the start of the recording, float64 `(t,)`, never decreasing.
        values: `(t,)`, `(t, k)`, or pictures as `motes.io.messages.picture` gives them, `(t, height, width)` or `(t, height, width, 3)`.
        angles: which of the k numbers are angles.
    """

    name: str
    kind: str
    seconds: np.ndarray
    values: np.ndarray
    angles: tuple[int, ...] = ()

    def at(self, seconds: np.ndarray) -> np.ndarray:
        """Return the values at other times `(s,)`: on the line between two messages, NaN before the first and after the last one."""
        outside = (seconds < self.seconds[0] - SAME) | (seconds > self.seconds[-1] + SAME)
        columns = self.values.reshape(len(self.values), -1).T.copy()
        columns[list(self.angles)] = np.unwrap(columns[list(self.angles)], axis=1)
        found = [np.where(outside, np.nan, np.interp(seconds, self.seconds, column)) for column in columns]
        return np.stack(found, axis=1).reshape(len(seconds), *self.values.shape[1:])

    def held(self, seconds: np.ndarray) -> np.ndarray:
        """Return the values of the last message until other times `(s,)`, none of which is before the first message."""
        return self.values[np.searchsorted(self.seconds, seconds + SAME, "right") - 1]


class Recording(NamedTuple):
    """Topics of a bag.

    Attributes:
        start: Unix seconds of the first message that was read.
        topics: by the names that they were asked for by.
    """

    start: float
    topics: dict[str, Topic]


class Bag(NamedTuple):
    """A bag that is open.

    Attributes:
        path: of the bag.
        reader: of `rosbags`.
        topics: what the reader knows of each topic, by name.
        deserialize: name of the method that reads messages of its version.
    """

    path: str
    reader: Any
    topics: Mapping[str, Any]
    deserialize: str

    def kind(self, topic: str) -> str:
        """Return the type of the messages of a topic, such as "nav_msgs/Odometry".

        Raises:
            FileError: there is no such topic, it is empty, or its messages are of several types.
        """
        if topic not in self.topics:
            reject(self.path, f"the topic {topic!r:.80}", f"the topics {self.told():.240}", meant(topic, list(self.topics)))
        if self.topics[topic].msgtype is None:
            reject(self.path, f"messages of one type in {topic}", "several types")
        if not self.topics[topic].msgcount:
            reject(self.path, f"at least one message in {topic}", "none")
        return _plain(self.topics[topic].msgtype)

    def told(self) -> str:
        """Return the topics with their types, as a line."""
        return ", ".join(f"{name} ({_plain(info.msgtype)})" for name, info in sorted(self.topics.items())) or "none"

    def messages(self, topics: Sequence[str]) -> Iterator[tuple[str, int, Callable[[], Any]]]:
        """Give the messages of topics as they were received: topic, time in nanoseconds, and what reads the message."""
        kinds = {topic: self.topics[topic].msgtype for topic in topics}
        reads = {topic: getattr(self._store(topic), self.deserialize) for topic in topics}
        connections = [one for topic in topics for one in self.topics[topic].connections]
        for connection, received, data in self.reader.messages(connections):
            yield connection.topic, received, partial(reads[connection.topic], data, kinds[connection.topic])

    def _store(self, topic: str) -> Any:
        """Return what knows the type of a topic."""
        typesys = need("rosbags.typesys", "io")
        connection = self.topics[topic].connections[0]
        (form, text), kind = connection.msgdef, connection.msgtype
        if form.name == "NONE":
            store = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
            if kind not in store.types:
                reject(self.path, f"a definition of {_plain(kind)}, the type of {topic}, since it is none of the standard types", "none",
                       "Releases from Iron on record definitions: convert the bag by one of them.")  # fmt: skip
            return store
        store = typesys.get_typestore(typesys.Stores.EMPTY)
        if form.name == "MSG":
            store.register(typesys.get_types_from_msg(text, kind))
        else:
            parts = [part for part in re.split(r"^=+\nIDL: .*\n", text, flags=re.MULTILINE) if part.strip()]
            store.register({name: one for part in parts for name, one in typesys.get_types_from_idl(part).items()})
        return store


def is_bag(path: str | os.PathLike[str]) -> bool:
    """Whether a path is a folder, or a file that begins as those of rosbag do; what cannot be read is none, and its reader says why."""
    try:
        return Path(path).is_dir() or look(path, 16)[1].startswith(STARTS)
    except FileError:
        return False


@contextmanager
def opened(path: str | os.PathLike[str]) -> Iterator[Bag]:
    """Open a bag.

    Args:
        path: a file of rosbag 1; the folder of rosbag 2, or a `.db3` or `.mcap` file of it.

    Raises:
        FileError: there is none, or it is damaged or cut short.
        MissingExtraError: `rosbags` is not installed.
    """
    place = Path(path)
    if place.is_dir() and not (place / "metadata.yaml").is_file():
        inside = sorted(one for one in place.iterdir() if one.suffix in RAW)
        if len(inside) != 1:
            reject(path, f"a bag: a folder with metadata.yaml or one {' or '.join(RAW)} file", f"{len(inside)} such files")
        place = inside[0]
    first = not place.is_dir() and look(place, 16)[1].startswith(STARTS[0])
    module = need("rosbags.rosbag1" if first else "rosbags.rosbag2", "io")
    with foreign(path, "an undamaged bag"), module.Reader(place) as reader:
        yield Bag(os.fspath(path), reader, reader.topics, "deserialize_ros1" if first else "deserialize_cdr")


def read_bag(
    path: str | os.PathLike[str], wanted: Mapping[str, str], kinds: Mapping[str, Sequence[str]] | None = None
) -> Recording:
    """Read topics of a bag.

    A message has the time of its header; all of a topic have the time at which they were received where a header has none.

    Args:
        path: a file of rosbag 1; the folder of rosbag 2, or a `.db3` or `.mcap` file of it.
        wanted: what to read, by names of your own: a topic, and after it the fields of its messages by their paths, with blanks between:
            `"/odom pose.pose.position.x pose.pose.position.y"`. Entries of lists are named by their numbers, and a quaternion has `yaw`,
            radians. Without fields it is what is usually wanted of odometry, poses (x, y, yaw, in the plane), velocities (x, y, yaw rate),
            ranges and scans (NaN where they are not within their limits), inertial units, satellite fixes (NaN where there is none),
            pictures.
        kinds: types of which the topics of some names must be, which then are read without fields.

    Raises:
        FileError: there is no bag, it is damaged, or a topic or a field is not there, empty, or of another type; times go back.
        MissingExtraError: `rosbags` is not installed, or pillow, for compressed pictures.
    """
    with opened(path) as bag:
        asked = {name: _asked(bag, name, text, (kinds or {}).get(name)) for name, text in wanted.items()}
        rows: dict[str, list[Any]] = {name: [] for name in asked}
        stamps: dict[str, list[tuple[int, int]]] = {topic: [] for topic, _ in asked.values()}
        angular: dict[str, tuple[int, ...]] = {}
        for topic, received, read in bag.messages(list(stamps)):
            message = read()
            stamps[topic].append((_stamp(message), received))
            place = Place(bag.path, topic, bag.kind(topic), len(stamps[topic]))
            for name, (where, fields) in asked.items():
                if where == topic:
                    rows[name].append(said(place, message, fields))
                    if name not in angular:
                        angular[name] = angles(place, message, fields)
        clocks = _clocks(bag, {topic: np.array(found) for topic, found in stamps.items()})
        start = min(int(clock[0]) for clock in clocks.values())
        found = {name: Topic(topic, bag.kind(topic), (clocks[topic] - start) / NANO, _in_one(bag, topic, rows[name]), angular[name])
                 for name, (topic, _) in asked.items()}  # fmt: skip
        return Recording(start / NANO, found)


def _asked(bag: Bag, name: str, text: str, kinds: Sequence[str] | None) -> tuple[str, list[str]]:
    """Return the topic and the fields that are asked for by a name."""
    topic, *fields = text.split() or [""]
    if kinds is not None and (fields or not topic):
        reject(bag.path, f"the name of a topic as {name}", repr(text)[:80], f"There are {bag.told():.240}.")
    if kinds is not None and bag.kind(topic) not in kinds:
        reject(bag.path, f"a topic of {' or '.join(kinds)} as {name}", f"{topic} of {bag.kind(topic)}", f"There are {bag.told():.200}.")
    bag.kind(topic)
    return topic, fields


def _stamp(message: Any) -> int:
    """Return the nanoseconds of a message's header; 0 where it has none."""
    stamp = getattr(getattr(message, "header", None), "stamp", None)
    return 0 if stamp is None else int(stamp.sec) * NANO + int(stamp.nanosec)


def _clocks(bag: Bag, stamps: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Return the times of topics in nanoseconds, from those of headers and of arrival `(t, 2)`."""
    # two clocks in one topic would make steps that nobody took
    by_header = {topic: bool(found[:, 0].all()) for topic, found in stamps.items()}
    clocks = {topic: found[:, 0 if by_header[topic] else 1] for topic, found in stamps.items()}
    for topic, chosen in clocks.items():
        times(chosen.astype("datetime64[ns]"), name=f"{label(bag.path)}: times of {topic}",
              rows=[f"message {number}" for number in range(1, len(chosen) + 1)])  # fmt: skip
    headed, bare = ([topic for topic in stamps if by_header[topic] is kind] for kind in (True, False))
    if headed and bare:
        # those of simulated time, say
        (begin, end), (first, last) = ((min(clocks[topic][0] for topic in some), max(clocks[topic][-1] for topic in some))
                                       for some in (headed, bare))  # fmt: skip
        if end + APART < first or last + APART < begin:
            reject(bag.path, f"one clock for {headed[0]}, whose messages have headers, and {bare[0]}, whose have none",
                   f"times that are {abs(begin - first) / NANO:.3g} s apart", "Record both with the same clock.")  # fmt: skip
    return clocks


def _in_one(bag: Bag, topic: str, rows: list[Any]) -> np.ndarray:
    forms = [np.shape(row) for row in rows]
    other = next((number for number, form in enumerate(forms) if form != forms[0]), 0)
    if other:
        reject(bag.path, f"as much in every message of {topic} as in the first, {forms[0]}", f"{forms[other]} in message {other + 1}")
    return np.stack(rows)


def _plain(kind: str | None) -> str:
    """Return the name of a type without the part in the middle that rosbag 2 adds."""
    return "several types" if kind is None else kind.replace("/msg/", "/")


@dataclass(frozen=True)
class TopicClip(Clip):
    """The pictures of a topic as a clip.

    Attributes:
        topic: its name.
    """

    topic: str

    def pictures(self, begin: int = 0) -> Iterator[np.ndarray | None]:
        """Give the pictures from a number on, RGB, uint8 `(height, width, 3)`; None for a damaged one or one of another size.

        Raises:
            FileError: the bag cannot be read any more.
        """
        with opened(self.path) as bag:
            for number, (topic, _, read) in enumerate(bag.messages([self.topic])):
                if number >= begin:
                    yield self._shown(Place(self.path, topic, bag.kind(topic), number + 1), read)

    def _shown(self, place: Place, read: Callable[[], Any]) -> np.ndarray | None:
        try:
            found = picture(place, read())
        except FileError:
            return None
        if found.shape[:2] != (self.height, self.width):
            return None
        return found if found.ndim == 3 else np.repeat(found[:, :, None], 3, axis=2)


def read_topic_clip(path: str | os.PathLike[str], topic: str) -> TopicClip:
    """Open the pictures of a topic, which are read one by one.

    Args:
        path: of a bag, as for `read_bag`.
        topic: of `sensor_msgs/Image` (mono8, rgb8 or bgr8) or `sensor_msgs/CompressedImage`.

    Raises:
        FileError: there is no bag, it is damaged, has no such topic, or its first picture cannot be read.
        MissingExtraError: `rosbags` is not installed, or pillow, for compressed pictures.
    """
    with opened(path) as bag:
        _asked(bag, "topic", topic, PICTURES)
        begun = list(islice(bag.messages([topic]), JUDGED))
        first = picture(Place(bag.path, topic, bag.kind(topic), 1), begun[0][2]())
        seconds, count = (begun[-1][1] - begun[0][1]) / NANO, bag.topics[topic].msgcount
        rate = Fraction((len(begun) - 1) / seconds).limit_denominator(1000) if seconds > 0 else USUAL_RATE
        stamp = (count, begun[0][1])
        return TopicClip(bag.path, first.shape[1], first.shape[0], rate or USUAL_RATE, count, stamp, topic)
