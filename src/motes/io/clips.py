"""Clips by PyAV (extra `video`): pictures one after the other, never all of them in memory; and clips written.

A clip is data: only containers that hold their own pictures are opened, no play lists, and nothing but the file itself.
"""

import os
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from fractions import Fraction
from typing import Any, BinaryIO

import numpy as np

from motes.core.checks import need
from motes.io.files import foreign, label, look, reject

CONTAINERS = "mov,mp4,m4a,3gp,3g2,mj2,matroska,webm,avi,mpegts,mpeg,ogg,flv,asf,gif,h264,hevc,m4v,mjpeg,ivf,nut,dv,mxf"
USUAL_RATE = Fraction(25)
"""Pictures per second of a clip that does not say."""
LARGEST = 8192
"""Most pixels of a side."""


@dataclass(frozen=True)
class Clip:
    """What a file says of its pictures.

    Attributes:
        path: the file.
        width: of the pictures as they are shown, pixels.
        height: likewise.
        rate: pictures per second.
        count: how many it says it has; 0 where it does not say.
        stamp: size and time of the file, by which a changed one is told.
    """

    path: str
    width: int
    height: int
    rate: Fraction
    count: int
    stamp: tuple[int, int]

    def pictures(self, begin: int = 0) -> Iterator[np.ndarray | None]:
        """Give the pictures from a number on, RGB, uint8 `(height, width, 3)`, turned as they are to be shown; None for a damaged one.

        Raises:
            FileError: the file cannot be read any more.
        """
        for number, frame in enumerate(_frames(self)):
            if number >= begin:
                yield None if frame is None else _shown(self, frame)


def read_clip(path: str | os.PathLike[str]) -> Clip:
    """Open a clip.

    Args:
        path: the file, in any container and codec that PyAV's FFmpeg reads, but for lists of other files.

    Raises:
        FileError: it is missing, holds no pictures or none that can be decoded.
        MissingExtraError: PyAV is not installed.
    """
    need("av", "video")
    size, _ = look(path, 16)
    with foreign(path, "a clip that FFmpeg reads"), _opened(path) as container:
        if not container.streams.video:
            reject(path, "a clip with pictures", "one without")
        stream = container.streams.video[0]
        first = next((frame for packet in container.demux(stream) for frame in _decoded(packet) if frame is not None), None)
        if first is None:
            reject(path, "a clip with pictures that can be decoded", "none")
        width, height = (first.height, first.width) if _turns(first) % 2 else (first.width, first.height)
        if max(width, height) > LARGEST:
            reject(path, f"pictures of at most {LARGEST} pixels a side", f"{width} x {height}")
        rate = stream.average_rate or stream.guessed_rate or USUAL_RATE
        return Clip(os.fspath(path), width, height, Fraction(rate), stream.frames, (size, os.stat(path).st_mtime_ns))


def write_clip(file: str | BinaryIO, pictures: Iterable[np.ndarray], rate: Fraction, exact: bool = False) -> None:
    """Write pictures, one after the other.

    Args:
        file: path, or a file open for bytes.
        pictures: RGB, uint8 `(height, width, 3)`, all of one size.
        rate: pictures per second.
        exact: whether every bit is kept (H.264 without loss, Matroska); otherwise an MP4 that browsers show, of even size.

    Raises:
        MissingExtraError: PyAV is not installed.
    """
    av = need("av", "video")
    with av.open(file, "w", format="matroska" if exact else "mp4") as container:
        stream = container.add_stream("libx264rgb" if exact else "libx264", rate=rate)
        stream.pix_fmt = "rgb24" if exact else "yuv420p"
        stream.options = {"qp": "0", "preset": "veryfast"} if exact else {"crf": "20", "preset": "veryfast"}
        for number, picture in enumerate(pictures):
            if not exact:
                picture = np.pad(picture, [(0, picture.shape[0] % 2), (0, picture.shape[1] % 2), (0, 0)], mode="edge")
            if number == 0:
                stream.height, stream.width = picture.shape[:2]
            container.mux(stream.encode(av.VideoFrame.from_ndarray(np.ascontiguousarray(picture), format="rgb24")))
        container.mux(stream.encode())


def _opened(path: str | os.PathLike[str]) -> Any:
    limits = {"protocol_whitelist": "file", "format_whitelist": CONTAINERS}
    return need("av", "video").open(os.path.abspath(path), options=limits, metadata_errors="ignore")


def _frames(clip: Clip) -> Iterator[Any]:
    """Give frames in the order in which they are shown, None in place of those that could not be decoded, as gaps in time tell."""
    with foreign(clip.path, "a clip that FFmpeg reads"), _opened(clip.path) as container:
        stream = container.streams.video[0]
        stream.thread_type = "AUTO"
        period = 1 / (clip.rate * stream.time_base) if stream.time_base else None
        lost, before = 0, None
        for packet in container.demux(stream):
            for frame in _decoded(packet):
                if frame is None:
                    lost += 1
                    continue
                if lost and period and before is not None and frame.pts is not None:
                    gap = min(lost, round((frame.pts - before) / period) - 1)
                    yield from [None] * gap
                    lost -= max(0, gap)
                before = frame.pts
                yield None if frame.is_corrupt else frame


def _decoded(packet: Any) -> list[Any]:
    """Return the frames that a packet completes; None for one that cannot be decoded."""
    try:
        return packet.decode()
    except need("av", "video").error.FFmpegError:
        return [None]


def _turns(frame: Any) -> int:
    """Return by how many quarters a picture is turned counterclockwise to be shown."""
    return round(getattr(frame, "rotation", 0) / 90) % 4


def _shown(clip: Clip, frame: Any) -> np.ndarray:
    turns = _turns(frame)
    width, height = (clip.height, clip.width) if turns % 2 else (clip.width, clip.height)
    with foreign(clip.path, f"pictures that {label(clip.path)} can be shown by"):
        picture = frame.to_ndarray(format="rgb24", width=width, height=height)
    return np.rot90(picture, turns) if turns else picture
