"""What a filter is given of a picture: worked out once, in NumPy, so that no particle costs more for a larger picture.

A measurement is a dictionary of `bins`, the colour of every so-many-th pixel as one of `BINS` numbers, uint8 `(h, w)`, and `sums`, integral
images of its channels, int32 `(4, h + 1, w + 1)`: sums over all pixels above and to the left. They may wrap around: so do differences.
"""

from collections.abc import Iterable, Iterator, Sequence
from functools import cache
from typing import Any

import numpy as np

from motes.laws.observed import Observed

HUES, VALUES = 10, 10
"""Bins of hue (and as many of saturation), and of brightness for what has no colour."""
BINS = HUES * HUES + VALUES
FADED, DARK = 0.1, 0.2
"""Saturation and brightness below which a pixel has no hue."""
BRIGHTNESS, RED_GREEN, BLUE_YELLOW, MOTION = range(4)
"""The channels: I = (R + G + B) / 3, R - G, B - (R + G) / 2, and |I - I of the picture before|."""


def looked_at(pictures: Iterable[np.ndarray | None], strides: Sequence[int]) -> Iterator[Any]:
    """Give the measurements of pictures, one by one.

    Args:
        pictures: RGB, uint8 `(height, width, 3)`, one after the other; None where there is none.
        strides: of the pixels that are looked at. For one stride the measurement itself is given, for several a dictionary of theirs.
    """
    before: dict[int, np.ndarray | None] = dict.fromkeys(strides)
    for picture in pictures:
        if picture is None:
            yield None
            continue
        found = {}
        for stride in strides:
            found[str(stride)], before[stride] = _one_measured(picture[::stride, ::stride], before[stride])
        yield of_stride(found, strides[0]) if len(strides) == 1 else found


def of_stride(y: Any, stride: int) -> Any:
    """Return what was measured with a stride."""
    return y.get(str(stride), y)


def steps_alone(ys: Sequence[Any], stride: int) -> Iterator[Any]:
    """Give what was measured with a stride, `Observed` as runs of one step; where nothing was, in the form of the others."""
    form = next(of_stride(y, stride) for y in ys if y is not None)
    for y in ys:
        value = form if y is None else of_stride(y, stride)
        yield Observed({name: array[None] for name, array in value.items()}, np.array([y is not None]))


def _one_measured(picture: np.ndarray, before: np.ndarray | None) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """Return the measurement of a picture, and its brightness for the next one."""
    planes = np.ascontiguousarray(np.moveaxis(picture, 2, 0)).astype(np.int16)
    grey, *opponent = still_channels(planes)
    moved = np.zeros_like(grey) if before is None else np.abs(grey - before)
    channels = np.stack([grey, *opponent, moved])
    sums = np.zeros((len(channels), grey.shape[0] + 1, grey.shape[1] + 1), np.int32)
    np.cumsum(channels, axis=2, dtype=np.int32, out=sums[:, 1:, 1:])
    np.cumsum(sums, axis=1, out=sums)
    return {"bins": colour_table().take(colour_place(planes)), "sums": sums}, grey


def still_channels(planes: Any) -> tuple[Any, Any, Any]:
    """Return the channels that one picture has alone, of its planes red, green and blue, whole numbers of 16 bits or more."""
    red, green, blue = planes
    return (red + green + blue) // 3, red - green, blue - (red + green) // 2


def colour_place(planes: Any) -> Any:
    """Return the places of pixels in `colour_table`; see `still_channels`."""
    red, green, blue = planes
    return (red >> 3 << 10) | (green >> 3 << 5) | (blue >> 3)


@cache
def colour_table() -> np.ndarray:
    """Return the bin of each of 32^3 colours, red slowest, uint8 `(32768,)`."""
    red, green, blue = (np.indices((32, 32, 32)).reshape(3, -1) + 0.5) / 32
    value, low = np.maximum(np.maximum(red, green), blue), np.minimum(np.minimum(red, green), blue)
    spread = value - low
    safe = np.where(spread > 0, spread, 1)
    sector = np.select([value == red, value == green], [((green - blue) / safe) % 6, (blue - red) / safe + 2], (red - green) / safe + 4)
    saturation = spread / value
    shares = (sector / 6, HUES), (saturation, HUES), (value, VALUES)
    place = [np.minimum((share * count).astype(int), count - 1) for share, count in shares]
    coloured = (saturation > FADED) & (value > DARK)
    return np.where(coloured, place[0] * HUES + place[1], HUES * HUES + place[2]).astype(np.uint8)
