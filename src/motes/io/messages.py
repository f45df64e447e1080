"""What messages of robots say, as numbers and pictures: fields by their paths, and what is usually wanted of the common types."""

import dataclasses
import difflib
import io
import keyword
from collections.abc import Sequence
from functools import lru_cache
from typing import Any, NamedTuple, NoReturn

import numpy as np

from motes.core.checks import need
from motes.io.clips import LARGEST
from motes.io.files import reject

POSE = ("position.x", "position.y", "orientation.yaw")
USUAL = {
    "nav_msgs/Odometry": tuple(f"pose.pose.{one}" for one in POSE),
    "geometry_msgs/PoseStamped": tuple(f"pose.{one}" for one in POSE),
    "geometry_msgs/PoseWithCovarianceStamped": tuple(f"pose.pose.{one}" for one in POSE),
    "geometry_msgs/TwistStamped": ("twist.linear.x", "twist.linear.y", "twist.angular.z"),
    "sensor_msgs/Range": ("range",),
    "sensor_msgs/LaserScan": ("ranges",),
    "sensor_msgs/Imu": tuple(f"{what}.{axis}" for what in ("angular_velocity", "linear_acceleration") for axis in "xyz"),
    "sensor_msgs/NavSatFix": ("latitude", "longitude", "altitude"),
}
"""Fields of types that need not be named."""
POSES = ("nav_msgs/Odometry", "geometry_msgs/PoseStamped", "geometry_msgs/PoseWithCovarianceStamped")
"""Types that have x, y and yaw."""
LIMITS = {"sensor_msgs/Range": ("min_range", "max_range"), "sensor_msgs/LaserScan": ("range_min", "range_max")}
PACKED = "sensor_msgs/CompressedImage"
PICTURES = ("sensor_msgs/Image", PACKED)
CHANNELS = {"mono8": 1, "rgb8": 3, "bgr8": 3}
"""Bytes of a pixel, by encoding."""
FORMATS = ("JPEG", "PNG")
"""Of compressed pictures."""
YAW = "yaw"


class Place(NamedTuple):
    """Where a message is.

    Attributes:
        path: of the bag.
        topic: such as "/odom".
        kind: type of its messages, such as "nav_msgs/Odometry".
        number: which of the topic, from 1.
    """

    path: str
    topic: str
    kind: str
    number: int

    def refuse(self, expected: str, given: object, hint: str = "") -> NoReturn:
        """Refuse what it says."""
        reject(self.path, f"{expected} in message {self.number} of {self.topic} ({self.kind})", given, hint)


def said(place: Place, message: Any, fields: Sequence[str]) -> Any:
    """Return what a message says.

    Args:
        place: where it is.
        message: the message.
        fields: paths of fields, such as "pose.pose.position.x"; what is usual of its type if there is none.

    Returns:
        A number, numbers `(k,)`, or a picture as `picture` gives it.

    Raises:
        FileError: a field is not there, or is no number.
        MissingExtraError: pillow is not installed, and the picture is compressed.
    """
    if not fields and place.kind in PICTURES:
        return picture(place, message)
    found = [_at_path(place, message, path) for path in fields or _usual(place, message)]
    values = found[0] if len(found) == 1 else np.concatenate([np.atleast_1d(one) for one in found])
    return values if fields else _within_limits(place.kind, message, values)


def angles(place: Place, message: Any, fields: Sequence[str]) -> tuple[int, ...]:
    """Return which of the numbers that `said` gives are angles."""
    paths = fields or (() if place.kind in PICTURES else _usual(place, message))
    ends = np.cumsum([np.size(_at_path(place, message, path)) for path in paths])
    return tuple(int(end) - 1 for path, end in zip(paths, ends, strict=True) if _is_yaw(message, path))


def _is_yaw(message: Any, path: str) -> bool:
    """Tell whether a path ends with the yaw of a quaternion, not with a field of that name."""
    *way, last = path.split(".")
    for part in way:
        message = _inner(message, part)
    return _inner(message, last) is _yaw


def picture(place: Place, message: Any) -> np.ndarray:
    """Return a picture: uint8 `(height, width)` where it is gray, RGB `(height, width, 3)` otherwise.

    Raises:
        FileError: it is of another encoding, damaged, or too large.
        MissingExtraError: pillow is not installed, and the picture is compressed.
    """
    if place.kind == PACKED:
        return _unpacked(place, bytes(message.data))
    height, width, step, data = message.height, message.width, message.step, np.asarray(message.data, np.uint8)
    channels = CHANNELS.get(message.encoding)
    if channels is None:
        place.refuse(f"one of the encodings {', '.join(CHANNELS)}", repr(message.encoding)[:60])
    if not (0 < height <= LARGEST and 0 < width <= LARGEST):
        place.refuse(f"a picture of 1 to {LARGEST} pixels a side", f"{width} x {height}")
    if step < width * channels or data.size != height * step:
        place.refuse(f"{height} rows of at least {width * channels} bytes", f"{data.size} bytes in rows of {step}")
    pixels = data.reshape(height, step)[:, : width * channels]
    if channels == 1:
        return pixels
    pixels = pixels.reshape(height, width, channels)
    return pixels[:, :, ::-1] if message.encoding == "bgr8" else pixels


def _unpacked(place: Place, data: bytes) -> np.ndarray:
    image = need("PIL.Image", "results")
    try:
        with image.open(io.BytesIO(data), formats=FORMATS) as found:
            if max(found.size) <= LARGEST:
                return np.asarray(found.convert("L" if found.mode in ("1", "L") else "RGB"))
            given = f"{found.width} x {found.height}"
    except Exception as reason:  # damaged pictures make the library raise nearly anything
        place.refuse(f"a picture as {' or '.join(FORMATS)}", " ".join(str(reason).split())[:120] or type(reason).__name__)
    place.refuse(f"a picture of at most {LARGEST} pixels a side", given)


def _usual(place: Place, message: Any) -> Sequence[str]:
    if place.kind not in USUAL:
        place.refuse(f"fields after the topic, such as '{place.topic} {next(iter(_fields(message)), 'data')}'", "none",
                     f"There are {_told(_fields(message))}.")  # fmt: skip
    return USUAL[place.kind]


def _within_limits(kind: str, message: Any, values: Any) -> Any:
    """Return values, NaN in place of those that a message says are none."""
    if kind in LIMITS:
        low, high = (getattr(message, name) for name in LIMITS[kind])
        # limits of zero are those that nobody set
        good = np.isfinite(values) & ((high <= low) | ((values >= low) & (values <= high)))
        return np.where(good, values, np.nan)
    if kind == "sensor_msgs/NavSatFix" and message.status.status < 0:
        return np.full_like(values, np.nan)
    return values


def _at_path(place: Place, message: Any, path: str) -> Any:
    """Return the number or the numbers of a field."""
    value = message
    for part in path.split("."):
        inner = _inner(value, part)
        if inner is None:
            known = _fields(value)
            place.refuse(f"the field {path!r:.80}", f"{_told(known)} in place of {part!r:.40}", meant(part, known))
        value = _yaw(place, value) if inner is _yaw else inner
    if isinstance(value, (bool, int, float, np.number, np.bool_)):
        return np.float64(value)
    if isinstance(value, np.ndarray) and value.dtype.kind in "biuf":
        return value.astype(np.float64)
    if _fields(value):
        place.refuse(f"a number or numbers as {path!r:.80}", _told(_fields(value)), f"Name one, such as {path}.{_fields(value)[0]}.")
    place.refuse(f"a number or numbers as {path!r:.80}", "a text" if isinstance(value, str) else f"a list of {len(value)}")


def _inner(value: Any, part: str) -> Any:
    """Return the field of a message or the entry of a list; None where there is none, `_yaw` in place of the yaw of a quaternion."""
    if part.isdecimal() and isinstance(value, (list, np.ndarray)):
        return value[int(part)] if int(part) < len(value) else None
    if part == YAW and set(_fields(value)) == set("xyzw"):
        return _yaw
    # fields with the name of a word of Python end in _
    return getattr(value, part + "_" * keyword.iskeyword(part)) if part in _fields(value) else None


def _fields(value: Any) -> list[str]:
    """Return the fields of a message, none of anything else."""
    return _fields_of(type(value))


@lru_cache(256)
def _fields_of(kind: type) -> list[str]:
    if not dataclasses.is_dataclass(kind):
        return []
    # the constants of a type have a value by default
    return [one.name.removesuffix("_") for one in dataclasses.fields(kind) if one.default is dataclasses.MISSING]


def meant(name: str, known: Sequence[str]) -> str:
    """Return a hint at the known name that is nearest to one that nobody knows; "" where none is near."""
    near = difflib.get_close_matches(name, known, 1)
    return f"Perhaps you meant {near[0]!r}." if near else ""


def _told(names: Sequence[str]) -> str:
    return f"the fields {', '.join(names):.160}" if names else "no fields"


def _yaw(place: Place, turn: Any) -> np.float64:
    """Return the angle about the vertical axis of a quaternion of any length, radians."""
    x, y, z, w = turn.x, turn.y, turn.z, turn.w
    if not x * x + y * y + z * z + w * w > 0:
        place.refuse("a quaternion that is a turn", f"x, y, z, w = {x}, {y}, {z}, {w}")
    return np.arctan2(2 * (w * z + x * y), w * w + x * x - y * y - z * z)
