"""What a user can set of the tracker of clips, as records without arrays."""

from dataclasses import dataclass, field


@dataclass(frozen=True)
class Settings:
    """Follow a target through a clip, or several.

    Attributes:
        data: a clip, in any format that FFmpeg reads, or a bag (rosbag 1 or 2); one is rendered where no file is named.
        topic: the pictures of a bag, sensor_msgs/Image (mono8, rgb8, bgr8) or sensor_msgs/CompressedImage.
        frame: number of the picture, from 0, in which the target is first seen.
        box: where it is in that picture, as x,y,w,h: left, top, width and height in pixels. Given several times, each is a target of its
            own, called 1, 2, ... in this order.
        frames: how many pictures it is followed through; 0 for all to the end.
        truth: true boxes for scoring, a file with the columns frame, x, y, w, h, and target where there are several; none if empty.
        cues: what the target is told by, any of colour, learned (a look that is learned) and motion (of a camera that stands still).
        learning: whether what is learned is learned anew on the way, and not from the first picture alone.
    """

    data: str = field(default="", metadata={"path": True})
    topic: str = ""
    frame: int = 0
    box: tuple[str, ...] = ()
    frames: int = 0
    truth: str = field(default="", metadata={"path": True})
    cues: tuple[str, ...] = ("colour", "learned")
    learning: bool = True
